"""The systems that can be solved: each is one frozen record, and only this file names a parameter."""

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.model.build import build, build_one
from workers.model.oscillator import Machines, Oscillator
from workers.results import OUT_OF_RANGE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One number that a system takes: its name, symbol (mathtext), unit, meaning, default and valid range.

    The range is low <= value <= high; an open end excludes its bound.
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

    @property
    def range(self) -> str:
        """The valid range in words, such as ``0 < b`` or ``0 <= R <= 1``."""
        below = f"{self.low:g} {'<' if self.low_open else '<='} " if math.isfinite(self.low) else ""
        above = f" {'<' if self.high_open else '<='} {self.high:g}" if math.isfinite(self.high) else ""
        return f"{below}{self.name}{above}" if below or above else "any finite number"

    def admits(self, value: Any) -> Any:
        """Whether a value, or each of many, is finite and inside the valid range."""
        above_low = value > self.low if self.low_open else value >= self.low
        below_high = value < self.high if self.high_open else value <= self.high
        return np.isfinite(value) & above_low & below_high


@dataclass(frozen=True)
class System:
    """A vibro-impact system: its parameters, the names of its physical state and its factory.

    ``states`` names the components of the physical section state in order (displacements, then velocities);
    each is also a parameter, the initial value at t = 0. ``machines`` makes many of all parameters, each an array (N,).
    """

    name: str
    title: str
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    machines: Callable[[Mapping[str, Array]], Machines]

    def build(self, values: Mapping[str, float]) -> Oscillator:
        """The oscillator of one value of each parameter; InvalidError, a ValueError, where there is none."""
        with np.errstate(all="ignore"):
            machine = self.machines({name: np.array([value], dtype=np.float64) for name, value in values.items()})
        return build_one(machine)

    def build_many(self, values: Mapping[str, Array]) -> tuple[Oscillator, NDArray[np.int8]]:
        """The oscillators of many values (N,) of each parameter, and the reason of each why there is none."""
        with np.errstate(all="ignore"):
            machines = self.machines(values)
        oscillators, reasons = build(machines)
        admitted = np.logical_and.reduce([p.admits(values[p.name]) for p in self.parameters])
        reasons[~admitted] = OUT_OF_RANGE
        return oscillators, reasons

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError with the nearest known name otherwise."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = [parameter.name for parameter in self.parameters]
        raise KeyError(unknown_name("parameter", name, known))


def unknown_name(kind: str, name: str, known: list[str]) -> str:
    """One line for a name that does not exist: the nearest known one, or all of them."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
    return f"unknown {kind} {name!r}; {hint}"


def _two_mass(p: Mapping[str, Array]) -> Machines:
    """Li & Tan (2011): M x'' + 2 zeta K x' + K x = (1 - f2, f2) sin(omega t + tau), |x1| < b."""
    one, none = np.ones_like(p["omega"]), np.zeros_like(p["omega"])
    stiffness = _matrices([[one, -one], [-one, 1.0 + p["mu_k"]]])
    return Machines(
        mass=_matrices([[one, none], [none, p["mu_m"]]]),
        damping=2.0 * p["zeta"][:, None, None] * stiffness,
        stiffness=stiffness,
        gap_row=np.stack([one, none], axis=-1),
        force_sin=np.stack([1.0 - p["f2"], p["f2"]], axis=-1)[:, None],
        force_cos=np.zeros((len(one), 1, 2)),
        load=np.zeros((len(one), 2)),
        omega=p["omega"],
        tau=p["tau"],
        upper=p["b"],
        lower=-p["b"],
        R=p["R"],
    )


def _matrices(rows: list[list[Array]]) -> Array:
    """Matrices (N, n, n) of rows of entries (N,)."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


TWO_MASS = System(
    name="two-mass",
    title="two-mass oscillator with symmetric rigid stops (Li & Tan 2011)",
    parameters=(
        Parameter("omega", r"\omega", "1", "forcing frequency", 4.0, low=0.0, low_open=True),
        Parameter("b", "b", "1", "clearance: half the gap between the stops", 0.15, low=0.0, low_open=True),
        Parameter("R", "R", "1", "coefficient of restitution", 0.8, low=0.0, high=1.0),
        Parameter("zeta", r"\zeta", "1", "damping ratio", 0.05, low=0.0),
        Parameter("mu_m", r"\mu_m", "1", "mass ratio m2/m1", 2.0, low=0.0, low_open=True),
        Parameter("mu_k", r"\mu_k", "1", "stiffness ratio k2/k1", 5.0, low=0.0, low_open=True),
        Parameter("f2", "f_2", "1", "share of the force on mass 2", 0.0),
        Parameter("tau", r"\tau", "rad", "phase of the force at t = 0", math.pi),
        Parameter("x1", "x_1(0)", "1", "initial displacement of mass 1", 0.0),
        Parameter("x2", "x_2(0)", "1", "initial displacement of mass 2", 0.0),
        Parameter("v1", r"\dot x_1(0)", "1", "initial velocity of mass 1", 0.0),
        Parameter("v2", r"\dot x_2(0)", "1", "initial velocity of mass 2", 0.0),
    ),
    states=("x1", "x2", "v1", "v2"),
    machines=_two_mass,
)

SYSTEMS: dict[str, System] = {system.name: system for system in (TWO_MASS,)}


def find_system(name: str) -> System:
    """The system of that name; KeyError with the nearest known name otherwise."""
    if name in SYSTEMS:
        return SYSTEMS[name]
    raise KeyError(unknown_name("system", name, list(SYSTEMS)))
