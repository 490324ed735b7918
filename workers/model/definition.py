"""What a system's motion is made of, as expressions of its parameters, and the machines that values make of them."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.expression import Expression
from workers.model.free import ULPS, finite
from workers.model.oscillator import Array, Machines
from workers.model.parameter import OMEGA, TAU
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

Row = tuple[Expression, ...]
Matrix = tuple[Row, ...]
NO_STOP = {"upper": math.inf, "lower": -math.inf}
MATRICES = frozenset(("mass", "damping", "stiffness"))
_KEYS = (
    "coordinates", "velocities", "mass", "damping", "stiffness", "harmonics", "load", "gap", "restitution", "upper",
    "lower", "let",
)  # fmt: skip
"""The order of a table's entries, which digests of curves depend on."""


class Harmonic(NamedTuple):
    """A part of the force: force sin(order (omega t + tau) + phase), with one amplitude and phase per coordinate."""

    order: int
    force: Row
    phase: Row


@dataclass(frozen=True)
class Definition:
    """A linear oscillator with stops on one output, every entry an expression of parameters:

        M x'' + C x' + K x = load + sum over harmonics of force sin(order (omega t + tau) + phase)
        lower <= y <= upper,  y = gap . x;  at a stop y' -> -R y'

    ``let`` are names for expressions that others may use, each after those it uses itself. A stop that is None does
    not exist; so does one at an infinite position.
    """

    coordinates: tuple[str, ...]
    velocities: tuple[str, ...]
    let: tuple[tuple[str, Expression], ...]
    mass: Matrix
    damping: Matrix
    stiffness: Matrix
    harmonics: tuple[Harmonic, ...]
    load: Row
    gap: Row
    upper: Expression | None
    lower: Expression | None
    restitution: Expression

    def machines(self, values: Mapping[str, Array]) -> Machines:
        """The machines of many values (N,) of each parameter."""
        return Machines(**self.fields(values, Machines._fields))

    def fields(self, values: Mapping[str, Array], wanted: Collection[str]) -> dict[str, Array]:
        """Some fields of the machines of many values (N,) of each parameter, by name."""
        if values[OMEGA].size != 1:
            return self._fields(values, wanted)
        # Of a lone number numpy computes a power by other means, and its last bits would depend on the others' absence.
        pair = self._fields({name: np.repeat(value, 2) for name, value in values.items()}, wanted)
        return {name: field[:1] for name, field in pair.items()}

    def depending(self, names: Collection[str]) -> set[str]:
        """The fields of machines that depend on parameters of these names."""
        known = set(names)
        for name, expression in self.let:
            if expression.names & known:
                known.add(name)
        force = tuple((each.force, each.phase) for each in self.harmonics)
        entries = self._entries() | {"force_sin": force, "force_cos": force}
        return {name for name, each in entries.items() if _names(each) & known} | ({OMEGA, TAU} & known)

    def _entries(self) -> dict[str, Any]:
        """What each field of machines is made of, but for the force: an expression, a row or a matrix of them."""
        stops = {"upper": self.upper, "lower": self.lower}
        return {
            "mass": self.mass, "damping": self.damping, "stiffness": self.stiffness, "gap_row": self.gap,
            "load": self.load, "R": self.restitution,
        } | {name: stop for name, stop in stops.items() if stop is not None}  # fmt: skip

    def _fields(self, values: Mapping[str, Array], wanted: Collection[str]) -> dict[str, Array]:
        named = dict(values)
        for name, expression in self.let:
            named[name] = expression(named)
        count = named[OMEGA].size
        found = {name: np.full(count, end) for name, end in NO_STOP.items() if name in wanted}
        found |= {name: _evaluated(each, named) for name, each in self._entries().items() if name in wanted}
        found |= {name: symmetrised(found[name]) for name in MATRICES if name in wanted}
        found |= {name: named[name] for name in (OMEGA, TAU) if name in wanted}
        if "force_sin" in wanted or "force_cos" in wanted:
            found["force_sin"], found["force_cos"] = self._force(named)
        return found

    def _force(self, named: Mapping[str, Array]) -> tuple[Array, Array]:
        """The force (N, H, n) as amplitudes of the sines and of the cosines."""
        count, n = named[OMEGA].size, len(self.coordinates)
        force_sin = np.zeros((count, max(each.order for each in self.harmonics), n))
        force_cos = np.zeros_like(force_sin)
        for order, force, phases in self.harmonics:
            for i, (amplitude, phase) in enumerate(zip(force, phases, strict=True)):
                size = amplitude(named)
                if phase.constant == 0.0:
                    force_sin[:, order - 1, i] = size
                else:
                    angle = phase(named)
                    force_sin[:, order - 1, i], force_cos[:, order - 1, i] = size * np.cos(angle), size * np.sin(angle)
        return force_sin, force_cos

    def table(self) -> dict[str, Any]:
        """The definition as a TOML file has it, in one spelling of its own: equal definitions make equal tables."""
        found = {key: _written(getattr(self, key)) for key in _KEYS}
        found["harmonics"] = [{key: _written(of) for key, of in each._asdict().items()} for each in self.harmonics]
        found["let"] = {name: _written(each) for name, each in self.let}
        return {key: entry for key, entry in found.items() if entry not in (None, {})}


def faults(machines: Machines, of: Collection[str] = Machines._fields) -> NDArray[np.int8]:
    """The reason against each of N machines, or NO_REASON, as far as the numbers of some fields alone tell.

    Matrices have to be symmetric to rounding, the lower stop below the upper one, and 0 <= R <= 1.
    """
    reasons = np.full(machines.omega.size, NO_REASON, dtype=np.int8)
    for name in MATRICES & set(of):
        matrix = getattr(machines, name)
        reasons[np.any(matrix != matrix.swapaxes(1, 2), axis=(1, 2))] = NO_OSCILLATOR
    if not {"lower", "upper", "R"}.isdisjoint(of):
        ranges = (machines.lower < machines.upper) & (machines.R >= 0.0) & (machines.R <= 1.0)
        reasons[~ranges] = OUT_OF_RANGE
    for name in of:
        field = getattr(machines, name)
        known = ~np.isnan(field) if name in ("upper", "lower") else finite((field,))  # a stop may be infinitely far
        reasons[~known] = OUT_OF_DOUBLES
    return reasons


def symmetrised(matrices: Array) -> Array:
    """Matrices (N, n, n) with each pair of entries [i][k] and [k][i] made equal that differs by rounding alone.

    That is by at most ULPS of the larger one, or of sqrt([i][i] [k][k]), which bounds it in a matrix that is positive.
    """
    other = matrices.swapaxes(1, 2)
    if np.array_equal(matrices, other):
        return matrices
    root = np.sqrt(np.abs(np.diagonal(matrices, axis1=1, axis2=2)))
    size = np.maximum(np.maximum(np.abs(matrices), np.abs(other)), root[:, :, None] * root[:, None, :])
    near = np.abs(matrices - other) <= ULPS * np.finfo(np.float64).eps * size
    return np.where(near & (matrices != other), 0.5 * matrices + 0.5 * other, matrices)


def _names(entries: Any) -> set[str]:
    return entries.names if isinstance(entries, Expression) else set().union(*map(_names, entries))


def _evaluated(entries: Any, named: Mapping[str, Array]) -> Array:
    """An expression (N,), a row (N, n) or a matrix (N, n, n) of them."""
    if isinstance(entries, Expression):
        return entries(named)
    return np.stack([_evaluated(entry, named) for entry in entries], axis=1)


def _written(entries: Any) -> Any:
    if isinstance(entries, tuple):
        return [_written(entry) for entry in entries]
    if not isinstance(entries, Expression):
        return entries
    return entries.text if entries.constant is None else entries.constant
