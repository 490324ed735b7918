"""What a system's motion is made of, as expressions of its parameters, and the machines that values make of them."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from workers.model.expression import Expression
from workers.model.free import ULPS
from workers.model.oscillator import Array, Machines
from workers.model.parameter import OMEGA, TAU

Row = tuple[Expression, ...]
Matrix = tuple[Row, ...]
MATRICES = ("mass", "damping", "stiffness")
OF_FORCE = ("force_sin", "force_cos")
NO_STOP = {"upper": math.inf, "lower": -math.inf}


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
    not exist; so does one at an infinite position. Tables have the order of these fields, which digests of curves
    depend on.
    """

    coordinates: tuple[str, ...]
    velocities: tuple[str, ...]
    mass: Matrix
    damping: Matrix
    stiffness: Matrix
    harmonics: tuple[Harmonic, ...]
    load: Row
    gap: Row
    restitution: Expression
    upper: Expression | None
    lower: Expression | None
    let: tuple[tuple[str, Expression], ...]

    def machines(self, values: Mapping[str, Array]) -> Machines:
        """The machines of many values (N,) of each parameter."""
        return Machines(**self.fields(values, Machines._fields))

    @np.errstate(all="ignore")
    def fields(self, values: Mapping[str, Array], wanted: Collection[str]) -> dict[str, Array]:
        """These fields of the machines of many values (N,) of each parameter, by name."""
        if values[OMEGA].size == 1:
            # Of a lone number numpy computes a power by other means: its last bits would depend on the others' absence.
            pair = self.fields({name: value.repeat(2) for name, value in values.items()}, wanted)
            return {name: field[:1] for name, field in pair.items()}
        named = dict(values)
        for name, expression in self.let:
            named[name] = expression(named)
        found = {name: evaluated(entries, named) for name, entries in self._entries.items() if name in wanted}
        found |= {name: symmetrised(found[name]) for name in MATRICES if name in wanted}
        if not set(OF_FORCE).isdisjoint(wanted):
            found |= zip(OF_FORCE, self._force(named), strict=True)
        return {name: np.ascontiguousarray(field) for name, field in found.items()}

    def depending(self, names: Collection[str]) -> frozenset[str]:
        """The fields of machines that depend on parameters of these names."""
        changing = set(names)
        for name, expression in self.let:
            if not expression.names.isdisjoint(changing):
                changing.add(name)
        entries = self._entries | dict.fromkeys(OF_FORCE, tuple((each.force, each.phase) for each in self.harmonics))
        return frozenset(field for field, of in entries.items() if not _names(of).isdisjoint(changing))

    @property
    def _entries(self) -> dict[str, Any]:
        """The expressions, or numbers, that each field of machines but those of the force is made of."""
        stops = {"upper": self.upper, "lower": self.lower}
        return {
            **{name: getattr(self, name) for name in (*MATRICES, "load")},
            **{name: NO_STOP[name] if stop is None else stop for name, stop in stops.items()},
            "gap_row": self.gap, "omega": Expression(OMEGA), "tau": Expression(TAU), "R": self.restitution,
        }  # fmt: skip

    def _force(self, named: Mapping[str, Array]) -> tuple[Array, Array]:
        """The force (N, H, n) as amplitudes of the sines and of the cosines."""
        count, n = named[OMEGA].size, len(self.coordinates)
        force_sin = np.zeros((count, max(each.order for each in self.harmonics), n))
        force_cos = np.zeros_like(force_sin)
        for order, force, phase in self.harmonics:
            size, angle = evaluated(force, named), evaluated(phase, named)
            force_sin[:, order - 1], force_cos[:, order - 1] = size * np.cos(angle), size * np.sin(angle) + 0.0
        return force_sin, force_cos

    def table(self) -> dict[str, Any]:
        """The definition as a TOML file has it, in one spelling of its own: equal definitions make equal tables."""
        found = {field.name: _written(getattr(self, field.name)) for field in dataclasses.fields(self)}
        found["let"] = {name: _written(each) for name, each in self.let}
        return {key: entry for key, entry in found.items() if entry not in (None, {})}


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


def evaluated(entries: Any, named: Mapping[str, Array]) -> Array:
    """An expression (N,), a row (N, n) or a matrix (N, n, n) of them; a number stands for itself."""
    if isinstance(entries, Expression):
        return entries(named)
    grid = np.array(entries, dtype=object)
    found = np.empty((named[OMEGA].size, *grid.shape))
    for index, entry in np.ndenumerate(grid):
        found[:, *index] = entry(named) if isinstance(entry, Expression) else entry
    return found


def _names(entries: Any) -> set[str]:
    """The names that these expressions use."""
    if isinstance(entries, tuple):
        return set().union(*map(_names, entries))
    return entries.names if isinstance(entries, Expression) else set()


def _written(entries: Any) -> Any:
    if isinstance(entries, Harmonic):
        return {key: _written(of) for key, of in entries._asdict().items()}
    if isinstance(entries, tuple):
        return [_written(entry) for entry in entries]
    if not isinstance(entries, Expression):
        return entries
    return entries.text if entries.constant is None else entries.constant
