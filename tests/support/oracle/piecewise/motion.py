"""One motion of a piecewise-linear machine: fly to the first guard, change the state and the mode, fly on."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

from mpmath import mp

from tests.support.oracle.crossing import first_upward_zero
from tests.support.oracle.linear import REACH, Number, TaylorSeries
from tests.support.oracle.piecewise.machine import PiecewiseContact, PiecewiseFriction, PiecewiseMachine, Vector
from tests.support.oracle.piecewise.mode_law import RESTS, Guard, ModeLaw, ModeLaws, PiecewiseMode, named
from tests.support.oracle.piecewise.state import SLACK, PiecewiseState

MAX_EVENTS = 20_000  # per period; far beyond any chatter that the rule for rest lets continue
MAX_AT_ONCE = 1000  # events at one time: coupled contacts pressed together hit in turn, ever more gently

Observer = Callable[[ModeLaws, PiecewiseMode, ModeLaw, TaylorSeries, Number, Number], None]
"""Called for each leg with the laws, mode, law, series, the flown share of its step (0 to 1) and the step."""


@dataclass(frozen=True)
class PiecewiseEvent:
    """An event at time ``t`` of contact or friction element ``index``.

    | kind | value |
    |---|---|
    | "impact" (rigid), "hit", "open" (soft) | row.v before |
    | "detach", "engage" (soft) | row.x |
    | "rest" (rigid), "leave", "sink" (an edge becomes a contact) | row.x |
    | "turn" (v_r changes sign), "stick", "slip+", "slip-" | row.x |
    """

    t: Number
    kind: str
    index: int
    value: Number


@dataclass
class PiecewiseRun:
    """States (x, v) and modes at each section, and the events between them."""

    sections: list[list[Number]] = field(default_factory=list)
    modes: list[PiecewiseMode] = field(default_factory=list)
    events: list[PiecewiseEvent] = field(default_factory=list)


def simulate(
    machine: PiecewiseMachine, state: Vector, periods: int = 1, *, mode: PiecewiseMode | None = None,
    span: Number | None = None,
    digits: int = 40, rest: float = 1e-10, observe: Observer | None = None,
) -> PiecewiseRun:  # fmt: skip
    """The motion from (x, v) at a section over this many periods, or over a ``span`` of time that ends in a section.

    Without a ``mode`` the state decides, to double precision, what each element does; with one the state is brought
    onto the constraints of that mode. A chatter that must end is followed hop by hop until its remainder lasts less
    than ``rest`` times the mode's fastest time scale. Raises ValueError for a state beyond a rigid stop,
    ArithmeticError if events accumulate: in practice on the edge of a preload, where hops slow down but never end.
    """
    if rest < 10.0 ** (2 - digits / 2):
        raise ValueError(f"{digits} digits do not resolve hops of {rest:.0e} of a time scale")
    with mp.workdps(digits):
        motion = _PiecewiseMotion(ModeLaws(machine), state, mode, mp.mpf(rest), observe)
        if span is not None:
            motion.until(mp.mpf(span))
            motion.close(mp.mpf(span))
        else:
            for _ in range(periods):
                motion.until(motion.laws.period)
                motion.close(motion.laws.period)
        return motion.run


class _PiecewiseMotion:
    """A motion in progress: ``state`` and ``mode`` at ``time`` since the last section, which was at ``offset``."""

    def __init__(
        self, laws: ModeLaws, state: Vector, mode: PiecewiseMode | None, rest: Number, observe: Observer | None
    ) -> None:
        self.laws = laws
        self.rest = rest
        self.observe = observe
        self.time = mp.zero
        self.offset = mp.zero
        self.at_once = 0
        self.hop: Number | None = None  # duration of the current flight if it is a hop of a chatter
        self.state = PiecewiseState(laws, state)
        self.mode = self.state.mode() if mode is None else mode
        self.state.constrain(self.mode)
        self.run = PiecewiseRun([self.state.physical()], [self.mode])

    def close(self, span: Number) -> None:
        """Record the section that has been reached."""
        self.run.sections.append(self.state.physical())
        self.run.modes.append(self.mode)
        self.offset += span
        self.time = mp.zero

    def until(self, end: Number) -> None:
        """Advance from a section to a later time, phase by phase."""
        begun = len(self.run.events)
        starts = [mp.mpf(phase.start) * self.laws.period for phase in self.laws.machine.phases]
        for index, (start, switch) in enumerate(pairwise([*starts, end])):
            if start < end:
                self.mode = replace(self.mode, phase=index)
                self._fly(min(switch, end), begun)

    def _fly(self, end: Number, begun: int) -> None:
        """Advance within one phase."""
        self.at_once = 0
        while self.time < end:
            law = self.laws.law(self.mode)
            longest = REACH / law.system.rate
            step = min(longest, end - self.time, longest if self.hop is None else self.hop)
            series = law.system.series(self.state.z, step)
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

    def _move(self, law: ModeLaw, series: TaylorSeries, u: Number, step: Number, end: Number) -> None:
        """Go to u within a step; a step to the end lands there exactly."""
        if self.observe is not None:
            self.observe(self.laws, self.mode, law, series, u, step)
        last = u == 1 and step == end - self.time
        self.time = end if last else self.time + u * step
        self.state.move(series.at(u), self.time)

    def _first(self, law: ModeLaw, series: TaylorSeries) -> tuple[Number, Guard] | None:
        """The first guard that rises through zero within a step, and its time; of simultaneous ones the first in order.

        If a guard is zero at the start, its first nonzero derivative decides: it rises now, or it may rise later.
        """
        first: tuple[Number, Guard] | None = None
        for guard in law.guards:
            polynomial, error = series.of(guard.functional)
            order = 0
            while order < len(polynomial) and abs(polynomial[order]) <= _rounding(guard, series, order):
                order += 1
            if order >= len(polynomial) - 1:
                continue
            if polynomial[order] > 0:
                return mp.zero, guard
            u = first_upward_zero(polynomial[order:], error)
            if u is not None and (first is None or u < first[0] * (1 - SLACK * mp.eps)):
                first = u, guard
        return first

    # Events at a guard

    def _happen(self, guard: Guard) -> None:
        i, machine = guard.index, self.laws.machines[self.mode.phase]
        if guard.kind in ("slip+", "slip-"):
            self._note(guard.kind, i, self.state.position(machine.friction[i].row))
            self.mode = self.mode.rub(i, guard.kind)
        elif guard.kind == "stop":
            self._stop(i, machine.friction[i])
        else:
            self._touch(guard, machine.contacts[i])

    def _touch(self, guard: Guard, contact: PiecewiseContact) -> None:
        """The event of a contact."""
        i, side, kind = guard.index, guard.side, guard.kind
        place, speed = self.state.position(contact.row), self.state.velocity(contact.row)
        if kind == "reach" and contact.restitution is not None:
            self._impact(i, side, contact)
        elif kind == "reach":
            self._note("hit", i, speed)
            self.mode = self.mode.contact(i, named("engaged", side))
            if contact.preload:
                self._expect_hop(contact.row, speed)
        elif kind == "open":
            self._note("open", i, speed)
            self.mode = self.mode.contact(i, "open")
        elif kind == "leave":
            self._note("leave", i, place)
            self.mode = self.laws.moving(self.mode, i, side, -side)
        else:
            self._note(kind, i, place)
            self.mode = self.mode.contact(i, named("detached" if kind == "detach" else "engaged", side))

    def _impact(self, i: int, side: int, contact: PiecewiseContact) -> None:
        """Newton's law; then flight, or rest if the remaining chatter is negligibly short."""
        before = self.state.velocity(contact.row)
        self._note("impact", i, before)
        R = mp.mpf(contact.restitution)
        self.state.kick(contact.row, -R * before)
        self._after_kick()
        if R * before != 0 and not self._chatter_ends(i, side, R * abs(before), R):
            self._expect_hop(contact.row, R * before)
            return
        self.state.kick(contact.row, mp.zero)
        rests = self.laws.resting(self.mode, i, side, self.state.z)
        if rests is None:
            self.mode = self.laws.moving(self.mode, i, side, -side)
        else:
            self._note("rest", i, self.state.position(contact.row))
            self.mode = rests

    def _expect_hop(self, row: Vector, velocity: Number) -> None:
        acceleration = abs(self.state.acceleration(self.mode, row))
        if acceleration > 0 and velocity != 0:
            self.hop = 3 * abs(velocity) / acceleration

    def _after_kick(self) -> None:
        """Velocities have jumped: friction slips in the new direction, held contacts part."""
        rounding, machine = SLACK * mp.eps, self.laws.machines[self.mode.phase]
        for k, friction in enumerate(machine.friction):
            belt = mp.mpf(friction.belt)
            if not self.state.at_rest(friction.row, belt, rounding):
                self.mode = self.mode.rub(k, "slip+" if self.state.velocity(friction.row) > belt else "slip-")
        for k, contact in enumerate(machine.contacts):
            if self.mode.contacts[k][:-1] in RESTS and not self.state.at_rest(contact.row, mp.zero, rounding):
                self.mode = self.mode.contact(k, "open")

    def _chatter_ends(self, i: int, side: int, rebound: Number, R: Number) -> bool:
        """Whether hops under the present accelerations, against and with friction, end within ``rest`` time scales."""
        row = self.laws.machine.contacts[i].row
        away, toward = (
            side * self.state.acceleration(self.laws.moving(self.mode, i, side, direction), row)
            for direction in (-side, side)
        )
        if toward <= 0 or away <= 0 or R * mp.sqrt(toward / away) >= 1:
            return False
        remaining = rebound * (1 / away + 1 / mp.sqrt(away * toward)) / (1 - R * mp.sqrt(toward / away))
        return bool(remaining * self.laws.law(self.mode).system.rate <= self.rest)

    def _stop(self, i: int, friction: PiecewiseFriction) -> None:
        """The relative velocity of a friction element is zero: it sticks, or turns."""
        does = self.laws.rubbing(self.mode, i, self.state.z)
        self._note("stick" if does == "stick" else "turn", i, self.state.position(friction.row))
        if does == "stick":
            self.state.kick(friction.row, mp.mpf(friction.belt))
        self.mode = self.mode.rub(i, does)

    def _note(self, kind: str, index: int, value: Number) -> None:
        self.run.events.append(PiecewiseEvent(self.offset + self.time, kind, index, value))


def _rounding(guard: Guard, series: TaylorSeries, order: int) -> Number:
    """Rounding of a Taylor coefficient: in proportion to the largest of all components, in their norm."""
    largest = max(map(abs, series.terms[order]))
    return SLACK * mp.eps * largest * mp.fsum(abs(f) * series.units[j] for j, f in guard.functional.items())


__all__ = ["PiecewiseEvent", "PiecewiseRun", "simulate"]
