"""A state z of a piecewise-linear machine, and the mode of a given state."""

from collections.abc import Sequence

from mpmath import mp

from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.machine import Vector
from tests.support.oracle.piecewise.mode_law import RESTS, ModeLaws, PiecewiseMode, named, side_of, value_of

SLACK = 1e6  # rounding errors, in units of the working precision, that count as zero
DOUBLE = 2.0**-46  # rounding of a given state on a stop or stuck


class PiecewiseState:
    """``z``: (x, v) and the part decided by time; see law.py."""

    def __init__(self, laws: ModeLaws, physical: Vector) -> None:
        self.laws = laws
        self.n = laws.machine.n
        self.z: list[Number] = [mp.mpf(value) for value in physical] + laws.drive(mp.zero)

    def physical(self) -> list[Number]:
        """(x, v)."""
        return self.z[: 2 * self.n]

    def move(self, z: Sequence[Number], time: Number) -> None:
        """Take the displacements and velocities of z at a time since the section."""
        self.z = [*z[: 2 * self.n], *self.laws.drive(time)]

    def position(self, row: Vector) -> Number:
        """row.x."""
        return value_of(self.laws.position(row), self.z)

    def velocity(self, row: Vector) -> Number:
        """row.v."""
        return value_of(self.laws.velocity(row), self.z)

    def acceleration(self, mode: PiecewiseMode, row: Vector) -> Number:
        """row.v' in a mode."""
        rates = self.laws.law(mode).system.derivative(self.z)
        return mp.fdot((mp.mpf(entry), rates[self.n + j]) for j, entry in enumerate(row))

    def kick(self, row: Vector, velocity: Number) -> None:
        """Set row.v by an impulse along the row."""
        self._shift(row, velocity - self.velocity(row), self.n)

    def at_rest(self, row: Vector, velocity: Number, rounding: float | Number) -> bool:
        """Whether row.v has this value to the relative rounding of a state of at least unit size."""
        sizes = (abs(mp.mpf(entry)) * max(abs(self.z[self.n + j]), mp.one) for j, entry in enumerate(row))
        return bool(abs(self.velocity(row) - velocity) <= rounding * mp.fsum(sizes))

    def constrain(self, mode: PiecewiseMode) -> None:
        """Put held contacts on their stops at rest, and let sticking elements move with their belts."""
        machine = self.laws.machines[mode.phase]
        for contact, state in zip(machine.contacts, mode.contacts, strict=True):
            if state[:-1] in RESTS:
                self.kick(contact.row, mp.zero)
                stop = mp.mpf(contact.stops[side_of(state)])
                self._shift(contact.row, stop - self.position(contact.row), 0)
        for friction, state in zip(machine.friction, mode.friction, strict=True):
            if state == "stick":
                self.kick(friction.row, mp.mpf(friction.belt))

    def mode(self) -> PiecewiseMode:
        """State of each element at a section, where zero means zero in double precision."""
        machine = self.laws.machines[0]
        mode = PiecewiseMode(0, ("open",) * len(machine.contacts), ("slip+",) * len(machine.friction))
        for i, friction in enumerate(machine.friction):
            belt = mp.mpf(friction.belt)
            mode = mode.rub(i, "slip+" if self.velocity(friction.row) > belt else "slip-")
            if self.at_rest(friction.row, belt, DOUBLE):
                mode = mode.rub(i, self.laws.rubbing(mode, i, self.z))
        for i, contact in enumerate(machine.contacts):
            for side in contact.stops:
                mode = self._touching(mode, i, side)
        return mode

    def _touching(self, mode: PiecewiseMode, i: int, side: int) -> PiecewiseMode:
        """The mode with the state of contact i at the stop of a side."""
        contact = self.laws.machines[0].contacts[i]
        stop = mp.mpf(contact.stops[side])
        terms = (abs(mp.mpf(entry) * x) for entry, x in zip(contact.row, self.z, strict=False))
        room = DOUBLE * (mp.fsum(terms) + abs(stop))
        depth = side * (self.position(contact.row) - stop)
        speed = mp.zero if self.at_rest(contact.row, mp.zero, DOUBLE) else side * self.velocity(contact.row)
        if depth < -room or (depth <= room and speed < 0):
            return mode
        if depth <= room and speed == 0:
            return self.laws.resting(mode, i, side, self.z) or mode
        if contact.restitution is None:
            pulls = contact.release == "force" and value_of(self.laws.push(contact, side), self.z) < 0
            return mode.contact(i, named("detached" if pulls else "engaged", side))
        if depth > room:
            raise ValueError(f"contact {i} is {mp.nstr(depth, 8)} beyond its stop")
        return mode

    def _shift(self, row: Vector, change: Number, first: int) -> None:
        for j, entry in enumerate(self.laws.kick(row)):
            self.z[first + j] += change * entry


__all__ = ["SLACK", "PiecewiseState"]
