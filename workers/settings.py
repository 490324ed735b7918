"""The settings of a cell: one record, validated once."""

import sys
from dataclasses import dataclass

EXPONENTS = ("none", "largest", "spectrum")
METHODS = ("adaptive", "fixed")
MAX_PERIODS = 500_000_000
"""Most periods of each kind: the cost of a cell must fit the 32 bits of ``periods_used``."""
MAX_ORBIT_PERIOD = 10_000
"""Most forcing periods of an orbit: a cell keeps a section state of each while it is solved."""
MAX_SAMPLES = 100_000
"""Most section states of a cell, 3 MB, and most values of an observable."""
VALID_WORDS = {"exponents": EXPONENTS, "method": METHODS}
"""Settings that are words, and their valid words."""
INTEGER_BOUNDS = {
    "max_periods": (1, MAX_PERIODS), "survival": (0, MAX_PERIODS), "transient_periods": (0, MAX_PERIODS),
    "periods": (1, MAX_PERIODS), "max_period": (1, MAX_ORBIT_PERIOD), "section_samples": (0, MAX_SAMPLES),
    "observe_values": (1, MAX_SAMPLES),
}  # fmt: skip
"""Settings that are integers, with the least and the greatest value."""


@dataclass(frozen=True)
class Settings:
    """What to compute of a cell, how accurately, and at what cost.

    exponents          "none", "largest" or "spectrum"
    tolerance          target standard error of the largest exponent, per forcing period; > 0
    max_periods        most forcing periods for deciding a cell's class, and averaging; 1 to 500 million (method
                       "adaptive")
    survival           most further forcing periods for watching motion that looks chaotic; 0 to 500 million (method
                       "adaptive"). Motion is watched for all of them if a stable orbit is known, else for at least a
                       32nd
    method             "adaptive", or "fixed": the schedule of Li & Tan (2011), transient then average
    transient_periods  periods dropped before the average (method "fixed"); 0 to 500 million
    periods            periods averaged (method "fixed"); 1 to 500 million
    max_period         longest orbit searched for, in forcing periods; 1 to 10,000. Where the exponent is clearly
                       negative, orbits of up to 1000 periods are searched for in any case (method "adaptive")
    section_samples    K: keep the last K section states of each cell; 0 to 100,000
    observe            observables of each cell, with commas between, such as "impact_phase:stop,maximum:gap": see
                       model/observables.py; "" for none. A system's machines have to have them
    observe_values     keep the first K values of each observable; 1 to 100,000

    Raises ValueError, in one line that names the setting, for anything else.

    >>> from workers import Settings
    >>> Settings(tolerance=0.05).max_periods
    20000
    """

    exponents: str = "largest"
    tolerance: float = 0.01
    max_periods: int = 20000
    survival: int = 48000
    method: str = "adaptive"
    transient_periods: int = 2000
    periods: int = 6000
    max_period: int = 64
    section_samples: int = 0
    observe: str = ""
    observe_values: int = 64

    def __post_init__(self) -> None:
        for name, known in VALID_WORDS.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name}: found {getattr(self, name)!r}, must be one of {', '.join(known)}")
        if not isinstance(self.observe, str):
            raise ValueError(f"observe: found {self.observe!r}, must be text, observables with commas between")
        if isinstance(self.tolerance, bool) or not isinstance(self.tolerance, int | float):
            raise ValueError(f"tolerance: found {self.tolerance!r}, must be a number > 0")
        if not 0 < self.tolerance <= sys.float_info.max:
            raise ValueError(f"tolerance: found {self.tolerance!r}, must be a finite number > 0")
        for name, (low, high) in INTEGER_BOUNDS.items():
            check_whole(name, getattr(self, name), low, high)

    @property
    def deciding_periods(self) -> int:
        """Forcing periods within which a cell is decided; the remaining tenth of ``max_periods`` is for proofs."""
        return self.max_periods - self.max_periods // 10


def check_whole(name: str, value: object, low: int, high: int) -> None:
    """ValueError in one line unless the value is an integer from low to high."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name}: found {value!r}, must be a whole number, {low} to {high}")
