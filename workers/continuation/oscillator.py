"""The linear oscillators of orbits, and families of them over free parameters.

Every field has an axis of oscillators in front, N of them: a step of Newton's method asks for several at once.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.family import FreeMotions
from workers.model.oscillator import NUMBER, Mode, Oscillator
from workers.model.system import System
from workers.results import NO_REASON, REASONS

Array = NDArray[np.float64]


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


class NoOscillatorError(ValueError):
    """Parameters at which there is no oscillator."""


class Family(NamedTuple):
    """Oscillators over some free parameters, by name: ``model`` makes N of them of rows of values (N, free).

    ``certified``: whether orbits have to be admissible, by certified crossings of the gap signals.
    """

    free: tuple[str, ...]
    model: Callable[[Array], ModalOscillator]
    certified: bool = True


def modal(oscillators: Oscillator) -> ModalOscillator:
    """What orbits of impacts take of many oscillators."""
    own = oscillators
    return ModalOscillator(own.gap, *map(np.asarray, (own.b_upper, own.b_lower, own.tau, own.R)))


def family_of(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Family:
    """A system over some of its parameters, the others fixed at ``values`` or at their defaults.

    Raises KeyError for unknown names; its model raises NoOscillatorError where there is none.
    """
    for name in (*values, *free):
        system.parameter(name)
    motions = FreeMotions(system, values, free)

    def model(rows: Array) -> ModalOscillator:
        found, reasons = motions(rows)
        if np.any(reasons != NO_REASON):
            bad = int(np.flatnonzero(reasons != NO_REASON)[0])
            where = ", ".join(f"{name} = {rows[bad, i]:g}" for i, name in enumerate(free))
            raise NoOscillatorError(f"no oscillator at {where}: {REASONS[reasons[bad]].text}")
        return ModalOscillator(*found)

    return Family(free, model)
