"""The linear oscillators of orbits, and families of them over free parameters.

Every field has an axis of oscillators in front, N of them: a step of Newton's method asks for several at once.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.family import FreeMotions
from workers.model.hybrid_machines import HybridMachines, hybrid_faults
from workers.model.oscillator import NUMBER, Array, Mask, Mode, Oscillator
from workers.model.system import System
from workers.results import NO_REASON, REASONS


class ModalOscillator(NamedTuple):
    """N linear oscillators with stops at y = upper and y = -lower, y counted from where it rests under constant load.

    gap    their free flights, see Oscillator.gap; a rigid mode, lam = 0, has the row (c0, 0) and the kick (0, k1)
    upper, lower, tau, R  (N,)  an absent stop is at infinity; the forcing phase is omega t + tau
    """

    gap: Mode
    upper: Array
    lower: Array
    tau: Array
    R: Array

    @property
    def omega(self) -> Array:
        """The forcing frequency (N,)."""
        return self.gap.numbers[:, NUMBER.omega]

    @property
    def dimension(self) -> int:
        """How many numbers a state has: 2n."""
        return 2 * self.gap.blocks.shape[1]

    @property
    def mirrored(self) -> Mask:
        """Which of them (N,) are their own mirror images half a period later."""
        even = (self.gap.sin_part[:, 1::2], self.gap.cos_part[:, 1::2], self.gap.load)
        uneven = [np.any(each != 0.0, axis=tuple(range(1, each.ndim))) for each in even]
        return ~np.any([*uneven, self.upper != self.lower], axis=0)


Machine = ModalOscillator | HybridMachines
"""N machines with one rigid contact, or with modes."""


class NoOscillatorError(ValueError):
    """Parameters at which there is no oscillator."""


class Family(NamedTuple):
    """Oscillators over some free parameters, by name: ``model`` makes N of them of rows of values (N, free).

    ``certified``: whether orbits have to be admissible, by certified crossings of the guards.
    """

    free: tuple[str, ...]
    model: Callable[[Array], Machine]
    certified: bool = True


def modal(oscillators: Oscillator) -> ModalOscillator:
    """What orbits of impacts take of many oscillators."""
    own = oscillators
    return ModalOscillator(own.gap, *map(np.asarray, (own.b_upper, own.b_lower, own.tau, own.R)))


def family_of(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Family:
    """A system over some of its parameters, the others fixed at ``values`` or at their defaults.

    Raises KeyError for unknown names, ValueError where a coordinate drifts; its model raises NoOscillatorError where
    there is none.
    """
    for name in (*values, *free):
        system.parameter(name)
    system.refuse_drift("branches and curves")
    machines = _with_modes(system, values, free) if system.has_modes else _with_impacts(system, values, free)

    def model(rows: Array) -> Machine:
        found, reasons = machines(rows)
        if np.any(reasons != NO_REASON):
            bad = int(np.flatnonzero(reasons != NO_REASON)[0])
            where = ", ".join(f"{name} = {rows[bad, i]:g}" for i, name in enumerate(free))
            raise NoOscillatorError(f"no oscillator at {where}: {REASONS[reasons[bad]].text}")
        return found

    return Family(free, model)


def has_images(system: System, values: Mapping[str, float]) -> bool:
    """Whether the mirror image of each orbit of a machine, half a period later, is one of its orbits too."""
    if not system.has_modes:
        return bool(system.build(values).symmetric)
    given = {p.name: np.array([float(values.get(p.name, p.default))]) for p in system.parameters}
    return bool(system.definition.hybrid(given).mirrored[0])


Machines = Callable[[Array], tuple[Machine, NDArray[np.int8]]]
"""Makes machines of rows of values, with the reason against each."""


def _with_impacts(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Machines:
    motions = FreeMotions(system, values, free)

    def machines(rows: Array) -> tuple[Machine, NDArray[np.int8]]:
        found, reasons = motions(rows)
        return ModalOscillator(*found), reasons

    return machines


def _with_modes(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Machines:
    fixed = {p.name: float(values.get(p.name, p.default)) for p in system.parameters if p.name not in free}

    def machines(rows: Array) -> tuple[Machine, NDArray[np.int8]]:
        given = {name: np.full(len(rows), value) for name, value in fixed.items()}
        given |= {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(free)}
        found = system.definition.hybrid(given)
        return found, system.out_of_range(given, hybrid_faults(found))

    return machines
