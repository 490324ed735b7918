"""The free motion of a system's machines over a few of its parameters: what the others decide is worked out once.

It is what ``System.build_many`` makes of the same values, to the bit, without the motion on a stop.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from workers.model.free import Frame, centred, finite, frame_of, free_motion, phase_of
from workers.model.oscillator import Array, Machines, Mode
from workers.model.system import System
from workers.results import NO_REASON, OUT_OF_DOUBLES

OF_FRAME = ("mass", "damping", "stiffness", "gap_row", "force_sin", "force_cos", "load")
"""The fields of machines that decide their frame and their loading."""


class FreeMotions:
    """The free motion of a system's machines over some of its parameters, the others fixed."""

    def __init__(self, system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> None:
        self.system, self.free = system, free
        self.fixed = {p.name: float(fixed.get(p.name, p.default)) for p in system.parameters if p.name not in free}
        self._last: dict[int, tuple[bytes, Frame, NDArray[np.bool_]]] = {}

    @np.errstate(all="ignore")
    def __call__(self, rows: Array) -> tuple[tuple[Mode, Array, Array, Array, Array], NDArray[np.int8]]:
        """The motions of rows of values (N, free): mode, stops seen from rest, forcing phase at a section, restitution.

        Beside them the reason of each why there is none, or NO_REASON.
        """
        given = {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(self.free)}
        fixed = {name: np.full(len(rows), value) for name, value in self.fixed.items()}
        machines = self.system.definition.machines(fixed | given)
        frame, known = self._frame(machines)
        at_rest = centred(frame, machines)
        gap, against = free_motion(frame, at_rest, machines.omega)
        known = known & finite((gap.numbers,)) & ~np.isnan(at_rest.b_upper) & ~np.isnan(at_rest.b_lower)
        reasons = np.where(known, NO_REASON, OUT_OF_DOUBLES).astype(np.int8)
        for reason, holds in against.items():
            reasons[holds] = reason
        motions = gap, at_rest.b_upper, at_rest.b_lower, phase_of(machines.tau), machines.R
        return motions, self.system.refused(machines, self.fixed | given, reasons)

    def _frame(self, machines: Machines) -> tuple[Frame, NDArray[np.bool_]]:
        """Their frames, of as many machines before where these had the same matrices and force; which are finite."""
        key = b"".join(getattr(machines, name).tobytes() for name in OF_FRAME)
        count = len(machines.omega)
        if count not in self._last or self._last[count][0] != key:
            frame = frame_of(machines)
            self._last[count] = key, frame, finite(frame)
        return self._last[count][1:]
