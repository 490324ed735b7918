"""The free motion of a system's machines over a few of its parameters: what the others decide is worked out once.

It is what ``System.build_many`` makes of the same values, to the bit, without the motion on a stop.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.definition import faults
from workers.model.free import Frame, Free, Loading, complex_force, faults_of, finite, frame_of, free_motion, loading_of
from workers.model.oscillator import Array, Machines
from workers.model.system import System
from workers.results import NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

IN_FRAME = ("mass", "damping", "stiffness", "gap_row")
"""The fields of machines that decide their frame."""
IN_PUSH = (*IN_FRAME, "force_sin", "force_cos", "load")
"""The fields of machines that decide their push."""


class _Still(NamedTuple):
    """What N rows of values have in common: fixed parameters, machines, their frame and their push.

    All fields are those of a machine at one of the rows; what depends on free parameters is made anew. ``faults`` are
    the reasons against what does not.
    """

    fixed: dict[str, Array]
    machines: Machines
    frame: Frame
    push: Loading
    faults: NDArray[np.int8]


class Motions(NamedTuple):
    """N machines, their frames and their free motion; and the reason of each why there is none, or NO_REASON."""

    machines: Machines
    frame: Frame
    free: Free
    reasons: NDArray[np.int8]


class FreeMotions:
    """The free motion of a system's machines over some of its parameters, the others fixed."""

    def __init__(self, system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> None:
        self.system, self.free = system, free
        self.fixed = {p.name: float(fixed.get(p.name, p.default)) for p in system.parameters if p.name not in free}
        self._depending = system.definition.depending(free)
        self._new_frame = not self._depending.isdisjoint(IN_FRAME)
        self._new_push = not self._depending.isdisjoint(IN_PUSH)
        self._admitted = all(p.admits(self.fixed[p.name]) for p in system.parameters if p.name not in free)
        self._known: dict[int, _Still] = {}

    def __call__(self, rows: Array) -> Motions:
        """The motions of rows of values (N, free)."""
        given = {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(self.free)}
        with np.errstate(all="ignore"):
            still = self._still(given, len(rows))
            machines = still.machines
            if self._depending:
                changed = self.system.definition.fields(still.fixed | given, self._depending)
                machines = machines._replace(**{name: np.ascontiguousarray(field) for name, field in changed.items()})
            frame = _frame(machines) if self._new_frame else still.frame
            push = _push(frame, machines) if self._new_push else still.push
            free = free_motion(frame, push, machines)
            wrong = (still.faults, faults(machines, self._depending))
        reasons = np.full(len(rows), NO_REASON, dtype=np.int8)
        known = finite((free.gap.numbers,)) & ~np.isnan(free.b_upper) & ~np.isnan(free.b_lower)
        reasons[~(known & finite(frame) if self._new_frame else known)] = OUT_OF_DOUBLES
        for reason, holds in faults_of(free):
            reasons[holds] = reason
        for each in wrong:
            reasons[each != NO_REASON] = each[each != NO_REASON]
        for name, column in given.items():
            reasons[~self.system.parameter(name).admits(column)] = OUT_OF_RANGE
        if not self._admitted:
            reasons[:] = OUT_OF_RANGE
        return Motions(machines, frame, free, reasons)

    def _still(self, given: Mapping[str, Array], count: int) -> _Still:
        """What ``count`` rows have in common, made at the first row of the first such rows."""
        if count not in self._known:
            fixed = {name: np.full(count, value) for name, value in self.fixed.items()}
            first = {name: np.repeat(column[:1], count) for name, column in given.items()}
            machines = Machines(*map(np.ascontiguousarray, self.system.definition.machines(fixed | first)))
            frame = _frame(machines)
            wrong = faults(machines, {*Machines._fields} - self._depending)
            if not self._new_frame:
                wrong[~finite(frame)] = OUT_OF_DOUBLES
            self._known[count] = _Still(fixed, machines, frame, _push(frame, machines), wrong)
        return self._known[count]


def _frame(machines: Machines) -> Frame:
    return frame_of(machines.mass, machines.damping, machines.stiffness, machines.gap_row)


def _push(frame: Frame, machines: Machines) -> Loading:
    return loading_of(frame.modes, frame.inverse_mass, complex_force(machines), machines.load)
