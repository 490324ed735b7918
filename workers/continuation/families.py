"""Families of machines over free parameters.

Each field of a machine has an axis of N machines in front, since a step of Newton's method needs several machines at
once.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from workers.model.family import NoOscillatorError, OrbitMachines, machines_over
from workers.model.oscillator import Array
from workers.model.system import System
from workers.results import NO_REASON, REASONS


class Family(NamedTuple):
    """Machines over some free parameters.

    free       names of the free parameters
    model      function from parameters (N, free) to the N machines
    certified  True if orbits must be admissible: no other event may occur between their events
    """

    free: tuple[str, ...]
    model: Callable[[Array], OrbitMachines]
    certified: bool = True


def family_of(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Family:
    """Return the family of a system over some of its parameters.

    system  mechanical system
    values  fixed parameters by name; the others have their defaults
    free    names of the free parameters

    Raise KeyError for unknown names, and ValueError if a coordinate drifts. The model of the family raises
    NoOscillatorError at parameters without an oscillator.
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
    """Return the machine at these parameters, alone in a batch. Raise errors as ``family_of``."""
    return family_of(system, values, ()).model(np.zeros((1, 0)))


def has_images(system: System, values: Mapping[str, float]) -> bool:
    """Return True if the mirror image of each orbit of a machine, half a period later, is one of its orbits too."""
    return bool(machine_of(system, values).mirrored[0])
