"""One orbit by the definition of the motion: fly, hit, rebound, rest while pressed, leave; in multiprecision."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mpmath import mp

from tests.oracle.crossing import first_upward_zero
from tests.oracle.linear import REACH, LinearSystem, Number, Series
from tests.oracle.model import COS, NAMES, SIN, STATES, V1, V2, X1, X2, Model, model

MAX_IMPACTS = 50_000  # a period; far beyond any chatter that the rule for rest lets go on


@dataclass(frozen=True)
class Impact:
    """One impact: time since t = 0, side (+1 or -1), speed before it."""

    t: Number
    side: int
    speed: Number


@dataclass(frozen=True)
class Stuck:
    """An interval of rest on one stop."""

    start: Number
    end: Number
    side: int


@dataclass
class Orbit:
    """Section states (x1, x2, v1, v2) at t = 0, T, 2T, ..., and what happened between them."""

    sections: list[list[Number]] = field(default_factory=list)
    impacts: list[Impact] = field(default_factory=list)
    stuck: list[Stuck] = field(default_factory=list)


@dataclass(frozen=True)
class Contact:
    """How mass 1 stands at the start of a flight, on the stop at side * b.

    ``order`` derivatives of its distance vanish there exactly: 1 with a velocity, 2 with an acceleration,
    3 with only a jerk away from the stop. ``side`` 0 and order 0: it is in between.
    """

    side: int = 0
    order: int = 0


def simulate(params: Mapping[str, float | Number], periods: int, digits: int = 40, rest: float = 1e-10) -> Orbit:
    """The orbit over that many forcing periods from the initial state in ``params`` (x1, x2, v1, v2; default 0).

    A sequence of impacts that is bound to end at rest is followed hop by hop until what is left of it lasts less than
    ``rest`` times the system's fastest time scale; the state's error is then of the order of the cube of that.
    Raises ValueError for a state beyond a stop, ArithmeticError after MAX_IMPACTS impacts in one period.
    """
    with mp.workdps(digits):
        motion = _Motion(model(params), [mp.mpf(params.get(name, 0)) for name in STATES], mp.mpf(rest))
        for _ in range(periods):
            motion.one_period()
        return motion.orbit


def section_jacobian(params: Mapping[str, float | Number], periods: int, digits: int = 50) -> list[list[Number]]:
    """d(x1, x2, v1, v2 after that many periods) / d(initial state), by central differences of orbits.

    The differences are 10^-(digits/3) wide, so that their error is far below double precision unless the orbit
    itself has a kink there.
    """
    with mp.workdps(digits):
        width = mp.mpf(10) ** (-digits // 3)
        columns = []
        for name in STATES:
            ends = []
            for sign in (1, -1):
                moved = {**params, name: mp.mpf(params.get(name, 0)) + sign * width}
                ends.append(simulate(moved, periods, digits, rest=1e-14).sections[-1])
            columns.append([(a - b) / (2 * width) for a, b in zip(*ends, strict=True)])
        return [list(row) for row in zip(*columns, strict=True)]


def first_hit(params: Mapping[str, float | Number], state: Sequence[float], start: float, span: float) -> Impact | None:
    """The first impact of the free flight from a state at a time since the section, within a span; times from start.

    A state that lies on a stop exactly is a contact: the flight leaves it.
    """
    with mp.workdps(40):
        motion = _Motion(model(params), [mp.mpf(value) for value in state], mp.mpf("1e-10"), settle=False)
        motion.enter(mp.mpf(start))
        contact = motion.contact_of_state()
        motion.fly(mp.mpf(start) + mp.mpf(span), contact)
        if motion.hit is None:
            return None
        return Impact(motion.time - mp.mpf(start), motion.hit, abs(motion.state[V1]))


class _Motion:
    """The orbit under way: its state now, as (x1, x2, v1, v2, sin, cos), and its history."""

    def __init__(self, made: Model, state: list[Number], rest: Number, settle: bool = True) -> None:
        self.model = made
        self.state = [*state, *made.phase(mp.zero)]
        self.rest = rest
        self.time = mp.zero  # since the last section
        self.offset = mp.zero  # of that section
        self.orbit = Orbit([list(state)])
        self.hit: int | None = None
        self.held = 0  # side on which mass 1 rests, 0 if it flies
        self.contact = Contact()
        if settle:
            self.contact = self.contact_of_state()
            self._settle()

    def enter(self, time: Number) -> None:
        """Put the forcing at its phase at a time since the section."""
        self.time = time
        self.state[SIN], self.state[COS] = self.model.phase(time)

    def contact_of_state(self) -> Contact:
        """What contact a given state is in; ValueError beyond a stop."""
        position, velocity = self.state[X1], self.state[V1]
        if abs(position) > self.model.b:
            raise ValueError(f"x1 = {mp.nstr(position, 8)} lies beyond the stop at {mp.nstr(self.model.b, 8)}")
        if abs(position) < self.model.b:
            return Contact()
        side = 1 if position > 0 else -1
        return Contact(side, 1 if velocity != 0 else 2)

    def _settle(self) -> None:
        """Turn the contact of an initial state into what follows from it: impact, rest or flight."""
        side = self.contact.side
        if side and side * self.state[V1] > 0:
            self._impact(side)
        elif side and self.state[V1] == 0:
            self._after_stop(side)

    def _acceleration(self) -> Number:
        return self.model.free.derivative(self.state)[V1]

    def one_period(self) -> None:
        """Advance to the next section and note the state there."""
        end = self.model.period
        count = len(self.orbit.impacts)
        while self.time < end:
            if self.held:
                self._stay(end)
                continue
            self.fly(end, self.contact)
            self.contact = Contact()
            if self.hit is not None:
                self._impact(self.hit)
            if len(self.orbit.impacts) - count > MAX_IMPACTS:
                raise ArithmeticError(f"more than {MAX_IMPACTS} impacts in one period")
        self.orbit.sections.append(self.state[:4])
        self.offset += end
        self.enter(mp.zero)

    def fly(self, end: Number, contact: Contact) -> None:
        """Free flight until the first impact (self.hit is its side) or the end (self.hit is None)."""
        self.hit = None
        reach = REACH / self.model.free.rate
        if contact.order == 1:
            # A hop under a pressing acceleration lasts about 2 v / a: look there first, then further.
            hop = 3 * abs(self.state[V1]) / (abs(self._acceleration()) + mp.mpf(10) ** -mp.dps)
            reach = min(reach, hop) if hop > 0 else reach
        while self.time < end:
            step = min(reach, end - self.time)
            series = self.model.free.series(self.state, step)
            found = self._first_of_both(series, contact)
            if found is not None:
                u, side = found
                self._move(series, u, step, end)
                self.state[X1] = side * self.model.b
                self.hit = side
                return
            self._move(series, mp.one, step, end)
            contact = Contact()
            reach = min(8 * reach, REACH / self.model.free.rate)

    def _first_of_both(self, series: Series, contact: Contact) -> tuple[Number, int] | None:
        """The earlier of the two stops' first crossings within a step, as (u, side)."""
        found = []
        position, error = series.of({X1: mp.one})
        for side in (1, -1):
            beyond = [side * value for value in position]
            beyond[0] -= self.model.b
            order = contact.order if side == contact.side else 0
            u = first_upward_zero(beyond[order:], error)
            if u is not None:
                found.append((u, side))
        return min(found) if found else None

    def _move(self, series: Series, u: Number, step: Number, end: Number) -> None:
        """Go to u within a step; a step to the end lands there exactly."""
        self.state = series.at(u)
        last = u == 1 and step == end - self.time
        self.time = end if last else self.time + u * step

    def _impact(self, side: int) -> None:
        """Newton's law; then fly on, or rest if the remaining chatter is over in no time."""
        velocity = self.state[V1]
        self.orbit.impacts.append(Impact(self.offset + self.time, side, abs(velocity)))
        self.state[V1] = -self.model.R * velocity
        self.contact = Contact(side, 1)
        rebound = abs(self.state[V1])
        if rebound == 0:
            self._after_stop(side)
            return
        rates = self.model.free.derivative(self.state)
        pressing = side * rates[V1]
        if self.model.R == 1 or pressing <= 0:
            return
        remaining = 2 * rebound / (pressing * (1 - self.model.R))
        jerk = self.model.free.derivative(rates)[V1]
        if remaining * self.model.free.rate <= self.rest and abs(jerk) * remaining <= pressing / 1000:
            self.state[V1] = mp.zero
            self._after_stop(side)

    def _after_stop(self, side: int) -> None:
        """Mass 1 is on a stop without velocity: it rests if pressed, else it leaves."""
        pressing = side * self._acceleration()
        if pressing > 0:
            self.held = side
            self.orbit.stuck.append(Stuck(self.offset + self.time, self.offset + self.time, side))
        else:
            self.contact = Contact(side, 2 if pressing < 0 else 3)

    def _stay(self, end: Number) -> None:
        """Rest on the stop until the free acceleration turns away from it, or the end."""
        side = self.held
        system: LinearSystem = self.model.held(side)
        let_go = {index: -side * value for index, value in self.model.held_acceleration(side).items()}
        mass_two = [self.state[X2], self.state[V2], self.state[SIN], self.state[COS], mp.one]
        released = False
        while self.time < end and not released:
            step = min(REACH / max(system.rate, self.model.omega), end - self.time)
            series = system.series(mass_two, step)
            u = first_upward_zero(*series.of(let_go))
            released = u is not None
            mass_two = series.at(u if released else mp.one)
            self.time = self.time + u * step if released else (end if step == end - self.time else self.time + step)
        self.state = [side * self.model.b, mass_two[0], mp.zero, mass_two[1], mass_two[2], mass_two[3]]
        begun = self.orbit.stuck.pop()
        self.orbit.stuck.append(Stuck(begun.start, self.offset + self.time, side))
        if released:
            self.held = 0
            self.contact = Contact(side, 3)


__all__ = ["NAMES", "Impact", "Orbit", "Stuck", "first_hit", "section_jacobian", "simulate"]
