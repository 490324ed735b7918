"""What a system's motion is made of, as expressions of its parameters, and the machines that values make of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from workers.model.expression import Expression
from workers.model.free import ULPS
from workers.model.oscillator import Array, Machines
from workers.model.parameter import OMEGA, TAU

Row = tuple[Expression, ...]
Matrix = tuple[Row, ...]
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

    @np.errstate(all="ignore")
    def machines(self, values: Mapping[str, Array]) -> Machines:
        """The machines of many values (N,) of each parameter."""
        if values[OMEGA].size == 1:
            # Of a lone number numpy computes a power by other means: its last bits would depend on the others' absence.
            pair = self.machines({name: np.repeat(value, 2) for name, value in values.items()})
            return Machines(*(field[:1] for field in pair))
        named = dict(values)
        for name, expression in self.let:
            named[name] = expression(named)
        count = named[OMEGA].size
        force_sin, force_cos = self._force(named)
        machines = Machines(
            mass=symmetrised(_evaluated(self.mass, named)),
            damping=symmetrised(_evaluated(self.damping, named)),
            stiffness=symmetrised(_evaluated(self.stiffness, named)),
            gap_row=_evaluated(self.gap, named),
            force_sin=force_sin,
            force_cos=force_cos,
            load=_evaluated(self.load, named),
            omega=named[OMEGA],
            tau=named[TAU],
            upper=np.full(count, NO_STOP["upper"]) if self.upper is None else self.upper(named),
            lower=np.full(count, NO_STOP["lower"]) if self.lower is None else self.lower(named),
            R=self.restitution(named),
        )
        return Machines(*map(np.ascontiguousarray, machines))

    def _force(self, named: Mapping[str, Array]) -> tuple[Array, Array]:
        """The force (N, H, n) as amplitudes of the sines and of the cosines."""
        count, n = named[OMEGA].size, len(self.coordinates)
        force_sin = np.zeros((count, max(each.order for each in self.harmonics), n))
        force_cos = np.zeros_like(force_sin)
        for order, force, phase in self.harmonics:
            size, angle = _evaluated(force, named), _evaluated(phase, named)
            force_sin[:, order - 1], force_cos[:, order - 1] = size * np.cos(angle), size * np.sin(angle) + 0.0
        return force_sin, force_cos

    def table(self) -> dict[str, Any]:
        """The definition as a TOML file has it, in one spelling of its own: equal definitions make equal tables."""
        found = {field.name: _written(getattr(self, field.name)) for field in fields(self)}
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


def _evaluated(entries: Row | Matrix, named: Mapping[str, Array]) -> Array:
    """A row (N, n) or a matrix (N, n, n) of expressions."""
    grid = np.array(entries, dtype=object)
    found = np.empty((named[OMEGA].size, *grid.shape))
    for index, entry in np.ndenumerate(grid):
        found[:, *index] = entry(named) if entry.constant is None else entry.constant
    return found


def _written(entries: Any) -> Any:
    if isinstance(entries, Harmonic):
        return {key: _written(of) for key, of in entries._asdict().items()}
    if isinstance(entries, tuple):
        return [_written(entry) for entry in entries]
    if not isinstance(entries, Expression):
        return entries
    return entries.text if entries.constant is None else entries.constant
