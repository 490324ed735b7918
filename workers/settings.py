"""How a cell is solved: the one record of settings, validated once."""

import math
from dataclasses import dataclass

EXPONENTS = ("none", "largest", "spectrum")
METHODS = ("adaptive", "fixed")


@dataclass(frozen=True)
class Settings:
    """What to compute of a cell, how well and at what price.

    exponents          "none", "largest" or "spectrum"
    tolerance          target standard error of the largest exponent, per forcing period; > 0
    max_periods        forcing periods that a cell may cost; >= 1 (method "adaptive")
    method             "adaptive", or "fixed": the schedule of Li & Tan (2011), transient then average
    transient_periods  periods dropped before the average (method "fixed"); >= 0
    periods            periods averaged (method "fixed"); >= 1
    max_period         longest orbit looked for, in forcing periods; >= 1
    section_samples    K: keep the last K section states of each cell; >= 0

    Raises ValueError, in one line that names the setting, for anything else.
    """

    exponents: str = "largest"
    tolerance: float = 0.01
    max_periods: int = 20000
    method: str = "adaptive"
    transient_periods: int = 2000
    periods: int = 6000
    max_period: int = 64
    section_samples: int = 0

    def __post_init__(self) -> None:
        _one_of("exponents", self.exponents, EXPONENTS)
        _one_of("method", self.method, METHODS)
        if isinstance(self.tolerance, bool) or not isinstance(self.tolerance, int | float):
            raise ValueError(f"tolerance: found {self.tolerance!r}, must be a number > 0")
        if not (math.isfinite(self.tolerance) and self.tolerance > 0):
            raise ValueError(f"tolerance: found {self.tolerance!r}, must be a number > 0")
        _whole("max_periods", self.max_periods, 1)
        _whole("transient_periods", self.transient_periods, 0)
        _whole("periods", self.periods, 1)
        _whole("max_period", self.max_period, 1)
        _whole("section_samples", self.section_samples, 0)


def _one_of(name: str, value: object, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{name}: found {value!r}, must be one of {', '.join(known)}")


def _whole(name: str, value: object, low: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value < 2**31:
        raise ValueError(f"{name}: found {value!r}, must be a whole number, {low} or more")
