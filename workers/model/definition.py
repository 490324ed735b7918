"""What a system's motion is made of, as expressions of its parameters, and the machines that values make of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.expression import Expression
from workers.model.oscillator import Machines
from workers.model.parameter import OMEGA, TAU
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

Array = NDArray[np.float64]
Row = tuple[Expression, ...]
Matrix = tuple[Row, ...]


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
        if values[OMEGA].size != 1:
            return self._machines(values)
        # Of a lone number numpy computes a power by other means, and its last bits would depend on the others' absence.
        pair = self._machines({name: np.repeat(value, 2) for name, value in values.items()})
        return Machines(*(field[:1] for field in pair))

    def _machines(self, values: Mapping[str, Array]) -> Machines:
        named = dict(values)
        for name, expression in self.let:
            named[name] = expression(named)

        def row(entries: Row) -> Array:
            return np.stack([entry(named) for entry in entries], axis=-1)

        def matrix(rows: Matrix) -> Array:
            return np.stack([row(entries) for entries in rows], axis=-2)

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
        return Machines(
            mass=matrix(self.mass),
            damping=matrix(self.damping),
            stiffness=matrix(self.stiffness),
            gap_row=row(self.gap),
            force_sin=force_sin,
            force_cos=force_cos,
            load=row(self.load),
            omega=named[OMEGA],
            tau=named[TAU],
            upper=np.full(count, np.inf) if self.upper is None else self.upper(named),
            lower=np.full(count, -np.inf) if self.lower is None else self.lower(named),
            R=self.restitution(named),
        )

    def table(self) -> dict[str, Any]:
        """The definition as a TOML file has it, in one spelling of its own: equal definitions make equal tables."""
        found: dict[str, Any] = {
            "coordinates": list(self.coordinates),
            "velocities": list(self.velocities),
            "mass": [_written(row) for row in self.mass],
            "damping": [_written(row) for row in self.damping],
            "stiffness": [_written(row) for row in self.stiffness],
            "harmonics": [
                {"order": each.order, "force": _written(each.force), "phase": _written(each.phase)}
                for each in self.harmonics
            ],
            "load": _written(self.load),
            "gap": _written(self.gap),
            "restitution": _entry(self.restitution),
        }
        stops = {"upper": self.upper, "lower": self.lower}
        found |= {name: _entry(stop) for name, stop in stops.items() if stop is not None}
        return found | ({"let": {name: _entry(each) for name, each in self.let}} if self.let else {})


def faults(machines: Machines) -> NDArray[np.int8]:
    """The reason why each of many machines is none, or NO_REASON, as far as its numbers alone tell.

    Matrices have to be symmetric, the lower stop below the upper one, and 0 <= R <= 1.
    """
    matrices = (machines.mass, machines.damping, machines.stiffness)
    reasons = np.full(machines.omega.size, NO_REASON, dtype=np.int8)
    for matrix in matrices:
        reasons[np.any(matrix != matrix.swapaxes(1, 2), axis=(1, 2))] = NO_OSCILLATOR
    ranges = (machines.lower < machines.upper) & (machines.R >= 0.0) & (machines.R <= 1.0)
    reasons[~ranges] = OUT_OF_RANGE
    unknown = np.isnan(machines.upper) | np.isnan(machines.lower)
    for field in machines._replace(upper=machines.omega, lower=machines.omega):  # a stop may be infinitely far away
        unknown |= ~np.isfinite(field).all(axis=tuple(range(1, field.ndim)))
    reasons[unknown] = OUT_OF_DOUBLES
    return reasons


def _entry(expression: Expression) -> float | str:
    number = expression.constant
    return expression.text if number is None else number


def _written(row: Row) -> list[float | str]:
    return [_entry(entry) for entry in row]
