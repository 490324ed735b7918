"""One orbit by the definition of the motion: fly, hit, rebound, rest while pressed, leave; in multiprecision."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from mpmath import mp

from tests.support.oracle.crossing import first_upward_zero
from tests.support.oracle.linear import REACH, Number, TaylorSeries
from tests.support.oracle.model import Cell, OracleModel, Y, machine_of, model

MAX_IMPACTS = 50_000  # per period; far beyond any chatter that the rule for rest lets continue
DOUBLE = 2.0**-52


@dataclass(frozen=True)
class Impact:
    """One impact: time since t = 0, side (+1 or -1), speed before it."""

    t: Number
    side: int
    speed: Number


@dataclass(frozen=True)
class RestInterval:
    """An interval of rest on one stop."""

    start: Number
    end: Number
    side: int


@dataclass
class SimulatedMotion:
    """Section states (displacements, velocities) at t = 0, T, 2T, ..., and the events between them."""

    sections: list[list[Number]] = field(default_factory=list)
    impacts: list[Impact] = field(default_factory=list)
    stuck: list[RestInterval] = field(default_factory=list)


@dataclass(frozen=True)
class GapContact:
    """State of the gap coordinate at the start of a flight, on the stop of this side.

    ``order`` derivatives of its distance vanish there exactly: 1 with a velocity, 2 with an acceleration,
    3 with only a jerk away from the stop. ``side`` 0 and order 0: between the stops.
    """

    side: int = 0
    order: int = 0


def simulate(cell: Cell, periods: int, digits: int = 40, rest: float = 1e-10) -> SimulatedMotion:
    """The orbit over this many forcing periods from the cell's initial state.

    A sequence of impacts that must end at rest is followed hop by hop until its remainder lasts less than ``rest``
    times the system's fastest time scale; the state's error is then of the order of the cube of that. Raises ValueError
    for a state beyond a stop and for fewer digits than the last hops need, whose height is about rest^2;
    ArithmeticError after MAX_IMPACTS impacts in one period.
    """
    if rest < 10.0 ** (2 - digits / 2):
        raise ValueError(
            f"{digits} digits do not resolve hops of {rest:.0e} of a time scale: more digits, or more rest"
        )
    with mp.workdps(digits):
        machine = model(cell)
        motion = _OracleMotion(machine, machine.start, mp.mpf(rest))
        for _ in range(periods):
            motion.one_period()
        return motion.orbit


def section_jacobian(cell: Cell, periods: int, digits: int = 50) -> list[list[Number]]:
    """d(displacements and velocities after these periods) / d(initial ones), by central differences of orbits.

    The differences are 10^-(digits/3) wide, with an error far below double precision unless the orbit has a kink there.
    """
    with mp.workdps(digits):
        machine, start = machine_of(cell), model(cell).start
        width = mp.mpf(10) ** (-digits // 3)
        columns = []
        for i in range(len(start)):
            ends = []
            for sign in (1, -1):
                moved = replace(machine, start=[value + sign * width * (i == j) for j, value in enumerate(start)])
                ends.append(simulate(moved, periods, digits, rest=1e-14).sections[-1])
            columns.append([(a - b) / (2 * width) for a, b in zip(*ends, strict=True)])
        return [list(row) for row in zip(*columns, strict=True)]


def first_hit(cell: Cell, state: Sequence[float], start: float, span: float) -> Impact | None:
    """The first impact of the free flight from a state at a time since the section, within a span; times from start.

    A state that lies on a stop to within a double's rounding is a contact: the flight leaves it.
    """
    with mp.workdps(40):
        motion = _OracleMotion(model(cell), state, mp.mpf("1e-10"), start=mp.mpf(start), settle=False)
        contact = motion.contact_of_state(DOUBLE)
        motion.fly(motion.time + mp.mpf(span), contact)
        if motion.hit is None:
            return None
        return Impact(motion.time - mp.mpf(start), motion.hit, abs(motion.velocity))


class _OracleMotion:
    """An orbit in progress: its present state, see Model, and its history."""

    def __init__(
        self, machine: OracleModel, state: Sequence[Number], rest: Number, start: Number = mp.zero, settle: bool = True
    ) -> None:
        self.model = machine
        self.state = machine.state(state, start)
        self.rest = rest
        self.time = start  # since the last section
        self.offset = mp.zero  # of that section
        self.orbit = SimulatedMotion([list(state)])
        self.hit: int | None = None
        self.held = 0  # side of rest of the gap coordinate, 0 if it moves
        self.contact = GapContact()
        if settle:
            self.contact = self.contact_of_state(mp.eps)
            self._settle()

    @property
    def velocity(self) -> Number:
        """Of the gap coordinate."""
        return self.state[self.model.n + Y]

    @velocity.setter
    def velocity(self, value: Number) -> None:
        self.state[self.model.n + Y] = value

    def contact_of_state(self, rounding: float | Number) -> GapContact:
        """The contact of a state of this relative rounding; ValueError beyond a stop."""
        terms = zip(self.model.gap_row, self.model.physical(self.state), strict=False)
        size = sum(abs(entry * x) for entry, x in terms)
        for side, stop in self.model.stops.items():
            beyond = side * (self.state[Y] - stop)
            if abs(beyond) <= 8 * rounding * (size + abs(stop)):
                self.state[Y] = stop
                return GapContact(side, 1 if self.velocity != 0 else 2)
            if beyond > 0:
                raise ValueError(f"y = {mp.nstr(self.state[Y], 8)} lies beyond the stop at {mp.nstr(stop, 8)}")
        return GapContact()

    def _settle(self) -> None:
        """Turn the contact of an initial state into its consequence: impact, rest or flight."""
        side = self.contact.side
        if side and side * self.velocity > 0:
            self._impact(side)
        elif side and self.velocity == 0:
            self._after_stop(side)

    def _acceleration(self) -> Number:
        return self.model.free.derivative(self.state)[self.model.n + Y]

    def one_period(self) -> None:
        """Advance to the next section and record the state."""
        end = self.model.period
        count = len(self.orbit.impacts)
        while self.time < end:
            if self.held:
                self._stay(end)
                continue
            self.fly(end, self.contact)
            self.contact = GapContact()
            if self.hit is not None:
                self._impact(self.hit)
            if len(self.orbit.impacts) - count > MAX_IMPACTS:
                raise ArithmeticError(f"more than {MAX_IMPACTS} impacts in one period")
        self.orbit.sections.append(self.model.physical(self.state))
        self.offset += end
        self.time = mp.zero
        self.state[2 * self.model.n :] = self.model.drive(mp.zero)

    def fly(self, end: Number, contact: GapContact) -> None:
        """Free flight until the first impact (self.hit is its side) or the end (self.hit is None)."""
        self.hit = None
        reach = REACH / self.model.free.rate
        if contact.order == 1:
            # A hop under a pressing acceleration lasts about 2 v / a: searched first.
            hop = 3 * abs(self.velocity) / (abs(self._acceleration()) + mp.mpf(10) ** -mp.dps)
            reach = min(reach, hop) if hop > 0 else reach
        while self.time < end:
            step = min(reach, end - self.time)
            series = self.model.free.series(self.state, step)
            found = self._first_of_all(series, contact)
            if found is not None:
                u, side = found
                self._move(series, u, step, end)
                self.state[Y] = self.model.stops[side]
                self.hit = side
                return
            self._move(series, mp.one, step, end)
            contact = GapContact()
            reach = min(8 * reach, REACH / self.model.free.rate)

    def _first_of_all(self, series: TaylorSeries, contact: GapContact) -> tuple[Number, int] | None:
        """The earliest of the stops' first crossings within a step, as (u, side)."""
        found = []
        position, error = series.of({Y: mp.one})
        for side, stop in self.model.stops.items():
            beyond = [side * value for value in position]
            beyond[0] -= side * stop
            order = contact.order if side == contact.side else 0
            u = first_upward_zero(beyond[order:], error)
            if u is not None:
                found.append((u, side))
        return min(found) if found else None

    def _move(self, series: TaylorSeries, u: Number, step: Number, end: Number) -> None:
        """Go to u within a step; a step to the end lands there exactly."""
        self.state = series.at(u)
        last = u == 1 and step == end - self.time
        self.time = end if last else self.time + u * step

    def _impact(self, side: int) -> None:
        """Newton's law; then flight, or rest if the remaining chatter is negligibly short."""
        velocity = self.velocity
        self.orbit.impacts.append(Impact(self.offset + self.time, side, abs(velocity)))
        self.velocity = -self.model.R * velocity
        self.contact = GapContact(side, 1)
        rebound = abs(self.velocity)
        if rebound == 0:
            self._after_stop(side)
            return
        rates = self.model.free.derivative(self.state)
        pressing = side * rates[self.model.n + Y]
        if self.model.R == 1 or pressing <= 0:
            return
        remaining = 2 * rebound / (pressing * (1 - self.model.R))
        jerk = self.model.free.derivative(rates)[self.model.n + Y]
        if remaining * self.model.free.rate <= self.rest and abs(jerk) * remaining <= pressing / 1000:
            self.velocity = mp.zero
            self._after_stop(side)

    def _after_stop(self, side: int) -> None:
        """The gap coordinate is at rest on a stop: it stays if pressed, else it leaves."""
        pressing = side * self._acceleration()
        if pressing > 0:
            self.held = side
            self.orbit.stuck.append(RestInterval(self.offset + self.time, self.offset + self.time, side))
        else:
            self.contact = GapContact(side, 2 if pressing < 0 else 3)

    def _stay(self, end: Number) -> None:
        """Rest on the stop until the free acceleration turns away from it, or the end."""
        side = self.held
        system = self.model.held()
        let_go = {index: -side * value for index, value in self.model.acceleration.items()}
        released = False
        while self.time < end and not released:
            step = min(REACH / max(system.rate, self.model.omega), end - self.time)
            series = system.series(self.state, step)
            u = first_upward_zero(*series.of(let_go))
            released = u is not None
            self._move(series, u if released else mp.one, step, end)
        begun = self.orbit.stuck.pop()
        self.orbit.stuck.append(RestInterval(begun.start, self.offset + self.time, side))
        if released:
            self.held = 0
            self.contact = GapContact(side, 3)
