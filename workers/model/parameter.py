"""A parameter of a system, and the error for an unknown name."""

import difflib
import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

OMEGA, TAU = "omega", "tau"
"""Names of the forcing frequency and of the phase of the force at t = 0, parameters of every system with a force."""

PHASE = "phase"
"""Name of the phase of a period in smooth coefficients, 0 to 2 pi from a section to the next, see smooth.py."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a system.

    name       name in files, commands and data
    symbol     symbol in pictures, as mathtext
    unit       unit as text, "1" if there is none
    meaning    meaning in words
    default    value if none is given; of an expression of other parameters, its value at their defaults
    low        lower bound of the valid range low <= value <= high
    high       upper bound of the valid range
    low_open   True if the lower bound itself is invalid
    high_open  True if the upper bound itself is invalid
    formula    the expression of other parameters that is the default; empty for a number
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    default: float
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False
    formula: str = ""

    @property
    def range(self) -> str:
        """Valid range in words, such as ``0 < b`` or ``0 <= R <= 1``."""
        below = f"{self.low:g} {'<' if self.low_open else '<='} " if math.isfinite(self.low) else ""
        above = f" {'<' if self.high_open else '<='} {self.high:g}" if math.isfinite(self.high) else ""
        return f"{below}{self.name}{above}" if below or above else "any finite number"

    @cached_property
    def ends(self) -> tuple[float, float]:
        """The least and the greatest double inside the valid range."""
        low = math.nextafter(self.low, math.inf) if self.low_open else self.low
        high = math.nextafter(self.high, -math.inf) if self.high_open else self.high
        return max(low, -sys.float_info.max), min(high, sys.float_info.max)

    def admits(self, value: Any) -> Any:
        """Return True if a value is finite and inside the valid range; a mask for an array of values."""
        low, high = self.ends
        return (value >= low) & (value <= high)

    def table(self) -> dict[str, Any]:
        """Return all fields except the name, as in a TOML file."""
        entries = {
            "default": self.formula or self.default,
            "symbol": self.symbol,
            "unit": self.unit,
            "meaning": self.meaning,
        }
        for key, end, is_open in (("low", self.low, self.low_open), ("high", self.high, self.high_open)):
            if math.isfinite(end):
                entries |= {key: end} | ({f"{key}_open": True} if is_open else {})
        return entries


def near_name(name: str, valid: list[str]) -> str:
    """Return the known name nearest to an unknown one; empty if none is near."""
    return next(iter(difflib.get_close_matches(name, valid, n=1, cutoff=0.5)), "")


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> str:
    """Return the one-line error message for an unknown name, with the nearest known name or with all known names."""
    names = list(valid)
    near = near_name(name, names)
    hint = f"did you mean {near!r}?" if near else f"known: {', '.join(names)}"
    return f"unknown {kind} {name!r}; {hint}"


def usual_values(
    parameters: Iterable[Parameter], axes: Iterable[tuple[str, float, float]]
) -> dict[str, NDArray[np.float64]]:
    """Return values (N,) of each parameter: the defaults, and for each two axes their ends and middles.

    The axes are (name, low, high); ends that their parameter does not admit are left out.
    """
    known = {p.name: p for p in parameters}
    lines = {name: [x for x in (low, 0.5 * (low + high), high) if known[name].admits(x)] for name, low, high in axes}
    planes = [*combinations(lines, 2)] if len(lines) > 1 else [(name,) for name in lines]
    cells = [dict(zip(plane, at, strict=True)) for plane in planes for at in product(*(lines[name] for name in plane))]
    return {name: np.array([cell.get(name, p.default) for cell in ({}, *cells)]) for name, p in known.items()}
