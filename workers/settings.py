"""The settings of the solver, which say how each cell (a machine at given parameters) is computed; validated once."""

import sys
from dataclasses import dataclass

EXPONENTS = ("none", "largest", "spectrum")
METHODS = ("adaptive", "fixed")
MAX_PERIODS = 500_000_000
"""Maximum number of periods of each kind. The cost of a cell must fit the 32 bits of ``periods_used``."""
MAX_ORBIT_PERIOD = 10_000
"""Maximum number of forcing periods of an orbit. A cell keeps a section state of each period while it is solved."""
MAX_SAMPLES = 100_000
"""Maximum number of section states of a cell (3 MB), and of values of an observable."""
VALID_WORDS = {"exponents": EXPONENTS, "method": METHODS}
"""Settings that are words, with their valid words."""
INTEGER_BOUNDS = {
    "max_periods": (1, MAX_PERIODS), "survival": (0, MAX_PERIODS), "transient_periods": (0, MAX_PERIODS),
    "periods": (1, MAX_PERIODS), "max_period": (1, MAX_ORBIT_PERIOD), "section_samples": (0, MAX_SAMPLES),
    "observe_values": (1, MAX_SAMPLES),
}  # fmt: skip
"""Settings that are integers, with their minimum and maximum."""


@dataclass(frozen=True)
class Settings:
    """The settings of the solver: what is computed for each cell, how accurately, and at what cost.

    exponents          "none", "largest" or "spectrum"
    tolerance          target standard error of the largest exponent, per forcing period; > 0
    max_periods        maximum number of forcing periods for deciding a cell's class, and for averaging; 1 to 500
                       million (method "adaptive")
    survival           maximum number of further forcing periods for watching motion that looks chaotic; 0 to 500
                       million (method "adaptive"). If a stable orbit is known, all of these periods are watched, else
                       at least a 32nd of their number
    method             "adaptive", or "fixed": the schedule of Li & Tan (2011), a transient and then an average
    transient_periods  forcing periods dropped before the average; 0 to 500 million (method "fixed")
    periods            forcing periods of the average; 1 to 500 million (method "fixed")
    max_period         longest orbit searched for, in forcing periods; 1 to 10,000. If the exponent is clearly negative,
                       orbits of up to 1000 periods are searched for in any case (method "adaptive")
    section_samples    K: the last K states of each cell at a fixed phase of the force are kept; 0 to 100,000
    observe            observables of each cell, separated by commas, such as "impact_phase:stop,maximum:gap"; "" for
                       none. The machines of the system must have them, see model/observables.py
    observe_values     the first K values of each observable are kept; 1 to 100,000

    Raise ValueError, in one line that names the setting, for any other value.

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
        """Maximum number of forcing periods for deciding a cell; a tenth of ``max_periods`` is reserved for proofs."""
        return self.max_periods - self.max_periods // 10


def check_whole(name: str, value: object, low: int, high: int) -> None:
    """Raise ValueError, in one line that begins with ``name``, unless ``value`` is an integer from low to high."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name}: found {value!r}, must be a whole number, {low} to {high}")
