"""One motion of a piecewise-linear machine: fly to the first guard, change the state and the mode, fly on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from mpmath import mp

from tests.oracle.crossing import first_upward_zero
from tests.oracle.linear import REACH, Number, Series
from tests.oracle.pieces.law import Guard, Law, Laws, Mode, side_of, value_of
from tests.oracle.pieces.machine import Machine, Vector

MAX_EVENTS = 20_000  # a period; far beyond any chatter that the rule for rest lets go on
MAX_AT_ONCE = 40  # events at one time
SLACK = 1e6  # rounding errors of a guard, in units of the working precision, that still count as zero
DOUBLE = 2.0**-46  # rounding of a given state that may stand on a stop or stick

Observer = Callable[[Laws, Mode, Law, Series, Number, Number], None]
"""Called for each leg with the laws, mode, law, series, its part of the step that is flown (0 to 1) and the step."""


@dataclass(frozen=True)
class Event:
    """What happened at time ``t`` to contact or friction element ``index``.

    | kind | value |
    |---|---|
    | "impact" (rigid), "hit", "open" (soft) | row.v before |
    | "detach", "engage" | row.x |
    | "rest", "leave" (rigid) | row.x |
    | "turn" (v_r changes sign), "stick", "slip+", "slip-" | row.x |
    """

    t: Number
    kind: str
    index: int
    value: Number


@dataclass
class Run:
    """States (x, v) and modes at each section, and the events between them."""

    sections: list[list[Number]] = field(default_factory=list)
    modes: list[Mode] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)


def simulate(
    machine: Machine, state: Vector, periods: int = 1, *, mode: Mode | None = None, span: Number | None = None,
    digits: int = 40, rest: float = 1e-10, observe: Observer | None = None,
) -> Run:  # fmt: skip
    """The motion from (x, v) at a section over that many periods, or over a ``span`` of time, which ends in a section.

    Without a ``mode`` the state decides, to double precision, what each element does; with one the state is brought
    onto the constraints of that mode. A chatter that is bound to end is followed hop by hop until what is left of it
    lasts less than ``rest`` times the mode's fastest time scale. Raises ValueError for a state beyond a rigid stop,
    ArithmeticError where events accumulate.
    """
    if rest < 10.0 ** (2 - digits / 2):
        raise ValueError(f"{digits} digits do not resolve hops of {rest:.0e} of a time scale")
    with mp.workdps(digits):
        motion = _Motion(Laws(machine), state, mode, mp.mpf(rest), observe)
        if span is not None:
            motion.until(mp.mpf(span))
            motion.close(mp.mpf(span))
        else:
            for _ in range(periods):
                motion.until(motion.laws.period)
                motion.close(motion.laws.period)
        return motion.run


class _Motion:
    """A motion under way: ``z`` at ``time`` since the last section, which was at ``offset``."""

    def __init__(self, laws: Laws, state: Vector, mode: Mode | None, rest: Number, observe: Observer | None) -> None:
        self.laws = laws
        self.machine = laws.machine
        self.rest = rest
        self.observe = observe
        self.time = mp.zero
        self.offset = mp.zero
        self.z: list[Number] = [mp.mpf(value) for value in state] + laws.drive(mp.zero)
        self.at_once = 0
        self.hop: Number | None = None  # how long the flight under way lasts if it is a hop of a chatter
        self.mode = self._mode_of_state() if mode is None else mode
        self._onto_constraints()
        self.run = Run([self.physical()], [self.mode])

    def physical(self) -> list[Number]:
        """(x, v)."""
        return self.z[: 2 * self.laws.n]

    def close(self, span: Number) -> None:
        """Note the section that has been reached."""
        self.run.sections.append(self.physical())
        self.run.modes.append(self.mode)
        self.offset += span
        self.time = mp.zero

    def until(self, end: Number) -> None:
        """Move on to a time since the last section."""
        begun = len(self.run.events)
        starts = [mp.mpf(phase.start) * self.laws.period for phase in self.machine.phases]
        if self.time == 0:
            self._switch(0)
        for index, switch in enumerate([*starts[1:], end], start=1):
            if self.time >= switch:
                continue
            self._fly(min(switch, end), begun)
            if self.time < end:
                self._switch(index)

    def _switch(self, phase: int) -> None:
        self.mode = Mode(phase, self.mode.contacts, self.mode.friction)
        self.at_once = 0

    def _fly(self, end: Number, begun: int) -> None:
        """Move on within one phase."""
        while self.time < end:
            law = self.laws.law(self.mode)
            longest = REACH / law.system.rate
            step = min(longest, end - self.time, longest if self.hop is None else self.hop)
            series = law.system.series(self.z, step)
            found = self._first(law, series)
            u = mp.one if found is None else found[0]
            if u > 0:
                self._move(law, series, u, step, end)
            if found is None:
                self.hop = None if self.hop is None or self.hop > longest else 8 * self.hop
                continue
            self.at_once = self.at_once + 1 if u * step <= 64 * mp.eps * self.laws.period else 0
            if self.at_once > MAX_AT_ONCE or len(self.run.events) - begun > MAX_EVENTS:
                raise ArithmeticError(f"events accumulate at t = {mp.nstr(self.offset + self.time, 12)}")
            self.hop = None
            self._happen(found[1])

    def _move(self, law: Law, series: Series, u: Number, step: Number, end: Number) -> None:
        if self.observe is not None:
            self.observe(self.laws, self.mode, law, series, u, step)
        last = u == 1 and step == end - self.time
        self.time = end if last else self.time + u * step
        self.z[: 2 * self.laws.n] = series.at(u)[: 2 * self.laws.n]
        self.z[2 * self.laws.n :] = self.laws.drive(self.time)

    def _first(self, law: Law, series: Series) -> tuple[Number, Guard] | None:
        """The first guard that rises through zero within a step, and when; of several at once the first in order."""
        first: tuple[Number, Guard] | None = None
        for guard in law.guards:
            polynomial, error = series.of(guard.functional)
            order = 0
            while order < len(polynomial) and abs(polynomial[order]) <= self._rounding(guard, series, order):
                order += 1
            if order >= len(polynomial) - 1:
                continue
            if polynomial[order] > 0:
                return mp.zero, guard
            u = first_upward_zero(polynomial[order:], error)
            if u is not None and (first is None or u < first[0]):
                first = u, guard
        return first

    def _rounding(self, guard: Guard, series: Series, order: int) -> Number:
        """Below what a Taylor coefficient is zero: in proportion to the largest of all components, in their norm."""
        largest = max(map(abs, series.terms[order]))
        return SLACK * mp.eps * largest * mp.fsum(abs(f) * series.units[j] for j, f in guard.functional.items())

    # What happens at a guard

    def _happen(self, guard: Guard) -> None:
        i = guard.index
        if guard.kind == "reach":
            rigid = self.machine.contacts[i].restitution is not None
            (self._impact if rigid else self._hit)(i, guard.side)
        elif guard.kind == "leave":
            self._note("leave", i, self._position(self.machine.contacts[i].row))
            self._leave(i, guard.side)
        elif guard.kind == "open":
            self._note("open", i, self._velocity(self.machine.contacts[i].row))
            self.mode = self.mode.contact(i, "open")
        elif guard.kind in ("detach", "engage"):
            self._note(guard.kind, i, self._position(self.machine.contacts[i].row))
            state = "detached" if guard.kind == "detach" else "engaged"
            self.mode = self.mode.contact(i, _named(state, guard.side))
        elif guard.kind == "stop":
            self._stop(i)
        else:
            self._note(guard.kind, i, self._position(self.machine.friction[i].row))
            self.mode = self.mode.rub(i, guard.kind)

    def _hit(self, i: int, side: int) -> None:
        contact = self.machine.contacts[i]
        speed = self._velocity(contact.row)
        self._note("hit", i, speed)
        self.mode = self.mode.contact(i, _named("engaged", side))
        if contact.preload:
            self._expect_hop(contact.row, abs(speed))

    def _impact(self, i: int, side: int) -> None:
        """Newton's law; then on, or rest if the remaining chatter is over in no time."""
        contact = self.machine.contacts[i]
        before = self._velocity(contact.row)
        self._note("impact", i, before)
        R = mp.mpf(contact.restitution)
        self._kick(contact.row, -R * before)
        self._after_kick()
        rebound = R * abs(before)
        if rebound == 0 or self._chatter_ends(i, side, rebound, R):
            self._kick(contact.row, mp.zero)
            self._rest(i, side)
        else:
            self._expect_hop(contact.row, rebound)

    def _expect_hop(self, row: Vector, speed: Number) -> None:
        acceleration = abs(self._acceleration(self.mode, row))
        if acceleration > 0:
            self.hop = 3 * speed / acceleration

    def _after_kick(self) -> None:
        """Relative velocities have jumped: friction slips in the new direction, held contacts part."""
        for k, friction in enumerate(self.machine.friction):
            speed = self._velocity(friction.row) - mp.mpf(friction.belt)
            if abs(speed) > self._noise(friction.row):
                self.mode = self.mode.rub(k, "slip+" if speed > 0 else "slip-")
        for k, contact in enumerate(self.machine.contacts):
            if self.mode.contacts[k][:-1] == "held" and abs(self._velocity(contact.row)) > self._noise(contact.row):
                self.mode = self.mode.contact(k, "open")

    def _chatter_ends(self, i: int, side: int, rebound: Number, R: Number) -> bool:
        """Whether hops under the pressing acceleration of now are over within ``rest`` time scales."""
        row = self.machine.contacts[i].row
        away = side * self._acceleration(self._sliding(i, -side), row)
        toward = side * self._acceleration(self._sliding(i, side), row)
        if toward <= 0 or away <= 0:
            return False
        ratio = R * mp.sqrt(toward / away)
        if ratio >= 1:
            return False
        remaining = rebound * (1 / away + 1 / mp.sqrt(away * toward)) / (1 - ratio)
        return bool(remaining * self.laws.law(self.mode).system.rate <= self.rest)

    def _sliding(self, i: int, direction: int) -> Mode:
        """The mode of now with contact i moving in a direction: friction on its row acts against that."""
        mode = self.mode
        held = mode.contact(i, "held+")
        for k, friction in enumerate(self.machine.friction):
            if self.laws.twin(held, k) == i and friction.belt == 0:
                forward = direction * self.laws.scale(k, i) > 0
                mode = mode.rub(k, "slip+" if forward else "slip-")
        return mode

    def _rest(self, i: int, side: int) -> None:
        """Row i is on a stop without velocity: it rests if pressed, else it leaves."""
        held = self.mode.contact(i, _named("held", side))
        for k, friction in enumerate(self.machine.friction):
            if self.laws.twin(held, k) == i and friction.belt == 0:
                held = held.rub(k, "stick")
        leave = next(g for g in self.laws.law(held).guards if g.kind == "leave" and g.index == i)
        if value_of(leave.functional, self.z) < 0:
            self._note("rest", i, self._position(self.machine.contacts[i].row))
            self.mode = held
        else:
            self._leave(i, side)

    def _leave(self, i: int, side: int) -> None:
        held = self.mode.contact(i, _named("held", side))
        for k, friction in enumerate(self.machine.friction):
            if self.laws.twin(held, k) == i and friction.belt == 0:
                forward = -side * self.laws.scale(k, i) > 0
                self.mode = self.mode.rub(k, "slip+" if forward else "slip-")
        self.mode = self.mode.contact(i, "open")

    def _stop(self, i: int) -> None:
        """The relative velocity of a friction element is zero: it sticks if static friction can hold it, else turns."""
        friction = self.machine.friction[i]
        needed = value_of(self._needed(i), self.z)
        place = self._position(friction.row)
        if abs(needed) <= mp.mpf(friction.static):
            self._note("stick", i, place)
            self._kick(friction.row, mp.mpf(friction.belt))
            self.mode = self.mode.rub(i, "stick")
        else:
            self._note("turn", i, place)
            self.mode = self.mode.rub(i, "slip-" if needed > 0 else "slip+")

    def _needed(self, i: int) -> dict[int, Number]:
        """The friction force that would keep element i from slipping."""
        return self.laws.law(self.mode.rub(i, "stick")).pressure["friction", i]

    # The state

    def _mode_of_state(self) -> Mode:
        mode = Mode(0, ("open",) * len(self.machine.contacts), ("slip+",) * len(self.machine.friction))
        for i, friction in enumerate(self.machine.friction):
            speed = self._velocity(friction.row) - mp.mpf(friction.belt)
            mode = mode.rub(i, "slip+" if speed > 0 else "slip-")
            self.mode = mode
            if abs(speed) <= DOUBLE * self._size(friction.row, self.laws.n):
                needed = value_of(self._needed(i), self.z)
                stuck = abs(needed) <= mp.mpf(friction.static)
                mode = mode.rub(i, "stick" if stuck else "slip-" if needed > 0 else "slip+")
        for i, contact in enumerate(self.machine.contacts):
            for side, stop in contact.stops.items():
                mode = self._beyond(mode, i, side, mp.mpf(stop))
        return mode

    def _beyond(self, mode: Mode, i: int, side: int, stop: Number) -> Mode:
        """The mode with what contact i does at the stop of a side."""
        contact = self.machine.contacts[i]
        depth = side * (self._position(contact.row) - stop)
        speed = side * self._velocity(contact.row)
        room = DOUBLE * (self._size(contact.row, 0) + abs(stop))
        if depth < -room or (depth <= room and speed < 0):
            return mode
        if contact.restitution is None:
            pulls = contact.release == "force" and value_of(self.laws.push(contact, side), self.z) < 0
            return mode.contact(i, _named("detached" if pulls else "engaged", side))
        if depth > room:
            raise ValueError(f"contact {i} at {mp.nstr(depth, 8)} beyond its stop")
        if speed > DOUBLE * self._size(contact.row, self.laws.n):
            return mode
        held = mode.contact(i, _named("held", side))
        leave = next(g for g in self.laws.law(held).guards if g.kind == "leave" and g.index == i)
        return held if value_of(leave.functional, self.z) < 0 else mode

    def _onto_constraints(self) -> None:
        """Put held contacts on their stops, without velocity, and let sticking elements move with their belts."""
        for contact, state in zip(self.machine.contacts, self.mode.contacts, strict=True):
            if state[:-1] == "held":
                self._kick(contact.row, mp.zero)
                stop = mp.mpf(contact.stops[side_of(state)])
                self._shift(contact.row, stop - self._position(contact.row), 0)
        for friction, state in zip(self.machine.friction, self.mode.friction, strict=True):
            if state == "stick":
                self._kick(friction.row, mp.mpf(friction.belt))

    def _kick(self, row: Vector, velocity: Number) -> None:
        """Give row.v a value, by an impulse along the row."""
        self._shift(row, velocity - self._velocity(row), self.laws.n)

    def _shift(self, row: Vector, change: Number, first: int) -> None:
        for j, entry in enumerate(self.laws.kick(row)):
            self.z[first + j] += change * entry

    def _position(self, row: Vector) -> Number:
        return value_of(self.laws.position(row), self.z)

    def _velocity(self, row: Vector) -> Number:
        return value_of(self.laws.velocity(row), self.z)

    def _acceleration(self, mode: Mode, row: Sequence[Number]) -> Number:
        rates = self.laws.law(mode).system.derivative(self.z)
        return mp.fdot((mp.mpf(entry), rates[self.laws.n + j]) for j, entry in enumerate(row))

    def _size(self, row: Vector, first: int) -> Number:
        """Sum of moduli of an output's terms, at least that of a unit state."""
        return mp.fsum(abs(mp.mpf(entry)) * max(abs(self.z[first + j]), mp.one) for j, entry in enumerate(row))

    def _noise(self, row: Vector) -> Number:
        return SLACK * mp.eps * self._size(row, self.laws.n)

    def _note(self, kind: str, index: int, value: Number) -> None:
        self.run.events.append(Event(self.offset + self.time, kind, index, value))


def _named(state: str, side: int) -> str:
    return state + ("+" if side > 0 else "-")


__all__ = ["Event", "Run", "simulate"]
