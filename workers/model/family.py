"""The free motion of a system's machines over a few of its parameters: what the others decide is worked out once.

It is what ``System.build_many`` makes of the same values, to the bit, without the motion on a stop.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.free import OF_STRUCTURE, Structure, centred, finite, free_motion, phase_of, structure_of
from workers.model.oscillator import Array, Machines, Mode
from workers.model.system import System
from workers.results import NO_REASON, OUT_OF_DOUBLES


class _Kept(NamedTuple):
    """What any N rows of values that make machines have in common: fixed values, machines, their structure.

    Fields of the machines that free parameters decide are made anew, and the structure with them.
    """

    fixed: dict[str, Array]
    machines: Machines
    structure: Structure


class FreeMotions:
    """The free motion of a system's machines over some of its parameters, the others fixed."""

    def __init__(self, system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> None:
        self.system, self.free = system, free
        self.fixed = {p.name: float(fixed.get(p.name, p.default)) for p in system.parameters if p.name not in free}
        self._changing = system.definition.depending(free)
        self._kept: dict[int, _Kept] = {}

    @np.errstate(all="ignore")
    def __call__(self, rows: Array) -> tuple[tuple[Mode, Array, Array, Array, Array], NDArray[np.int8]]:
        """The motions of rows of values (N, free): mode, stops seen from rest, forcing phase at a section, restitution.

        Beside them the reason of each why there is none, or NO_REASON.
        """
        given = {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(self.free)}
        kept = self._kept.get(len(rows))
        if kept:
            values, fields = given, self._changing
            machines = kept.machines._replace(**self.system.definition.fields(kept.fixed | given, fields))
            structure = kept.structure if fields.isdisjoint(OF_STRUCTURE) else structure_of(machines)
        else:
            fixed = {name: np.full(len(rows), value) for name, value in self.fixed.items()}
            values, fields = fixed | given, frozenset(Machines._fields)
            machines = self.system.definition.machines(values)
            structure = structure_of(machines)
        at_rest = centred(structure, machines)
        gap, against = free_motion(structure, at_rest, machines.omega)
        known = finite((gap.numbers,)) & ~np.isnan(at_rest.b_upper) & ~np.isnan(at_rest.b_lower)
        if not fields.isdisjoint(OF_STRUCTURE):
            known &= finite(structure)
        reasons = np.where(known, NO_REASON, OUT_OF_DOUBLES).astype(np.int8)
        for reason, holds in against.items():
            reasons[holds] = reason
        reasons = self.system.refused(machines, values, reasons, fields)
        if not kept and np.all(reasons == NO_REASON):
            self._kept[len(rows)] = _Kept(fixed, machines, structure)
        return (gap, at_rest.b_upper, at_rest.b_lower, phase_of(machines.tau), machines.R), reasons
