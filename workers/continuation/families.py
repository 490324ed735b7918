"""Families of machines over free parameters.

Each field has an axis of N machines in front: a step of Newton's method asks for several machines at once.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from workers.model.family import NoOscillatorError, OrbitMachines, machines_over
from workers.model.oscillator import Array
from workers.model.system import System
from workers.results import NO_REASON, REASONS


class Family(NamedTuple):
    """Machines over some free parameters, by name: ``model`` makes N of them of rows of values (N, free).

    ``certified``: whether orbits have to be admissible, by certified crossings of the guards.
    """

    free: tuple[str, ...]
    model: Callable[[Array], OrbitMachines]
    certified: bool = True


def family_of(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Family:
    """A system over some of its parameters, the others fixed at ``values`` or at their defaults.

    Raises KeyError for unknown names, ValueError where a coordinate drifts; its model raises NoOscillatorError where
    there is none.
    """
    for name in (*values, *free):
        system.parameter(name)
    system.must_offer("branches and curves", unforced=True)
    machines = machines_over(system, values, free)

    def model(rows: Array) -> OrbitMachines:
        models, reasons = machines(rows)
        if np.any(reasons != NO_REASON):
            bad = int(np.flatnonzero(reasons != NO_REASON)[0])
            where = ", ".join(f"{name} = {rows[bad, i]:g}" for i, name in enumerate(free))
            raise NoOscillatorError(f"no oscillator at {where}: {REASONS[reasons[bad]].text}")
        return models

    return Family(free, model)


def machine_of(system: System, values: Mapping[str, float]) -> OrbitMachines:
    """The machine of values of parameters, as the only one of a record of many; raises as ``family_of``."""
    return family_of(system, values, ()).model(np.zeros((1, 0)))


def has_images(system: System, values: Mapping[str, float]) -> bool:
    """Whether the mirror image of each orbit of a machine, half a period later, is one of its orbits too."""
    return bool(machine_of(system, values).mirrored[0])
