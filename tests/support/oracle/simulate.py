"""Orbits of a linear machine with one gap, by the simulator of piecewise-linear machines."""

from collections.abc import Sequence
from dataclasses import dataclass

from mpmath import mp

from tests.support.oracle import piecewise
from tests.support.oracle.linear import Number
from tests.support.oracle.model import Cell, on_stop, pieces_of, start_of
from tests.support.oracle.piecewise.mode_law import ModeLaws, side_of


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


@dataclass(frozen=True)
class SimulatedMotion:
    """Section states (displacements, velocities) at t = 0, T, 2T, ..., and the events between them."""

    sections: list[list[Number]]
    impacts: list[Impact]
    stuck: list[RestInterval]


def simulate(cell: Cell, periods: int, digits: int = 40, rest: float = 1e-10) -> SimulatedMotion:
    """The orbit over this many forcing periods from the cell's initial state; see ``piecewise.simulate``.

    What a rest neglects of the chatter before it changes the state by the order of the cube of ``rest``.
    """
    with mp.workdps(digits):
        machine = pieces_of(cell)
        laws = ModeLaws(machine)
        run = piecewise.simulate(machine, on_stop(laws, start_of(cell)), periods, digits=digits, rest=rest)
        impacts = [
            Impact(event.t, 1 if event.value > 0 else -1, abs(event.value))
            for event in run.events
            if event.kind == "impact"
        ]
        begins = [(event.t, _side(machine, event.value)) for event in run.events if event.kind == "rest"]
        if run.modes[0].contacts != ("open",):
            begins.insert(0, (mp.zero, side_of(run.modes[0].contacts[0])))
        ends = [event.t for event in run.events if event.kind == "leave"]
        ends += [periods * laws.period] * (len(begins) - len(ends))
        stuck = [RestInterval(start, end, side) for (start, side), end in zip(begins, ends, strict=True)]
        return SimulatedMotion(run.sections, impacts, stuck)


def section_jacobian(cell: Cell, periods: int, digits: int = 50) -> list[list[Number]]:
    """d(displacements and velocities after these periods) / d(initial ones), by central differences of orbits."""
    with mp.workdps(digits):
        derivative = piecewise.monodromy(pieces_of(cell), start_of(cell), periods, digits=digits)
        return [list(row) for row in derivative.tolist()]


def first_hit(cell: Cell, state: Sequence[float], start: float, span: float) -> Impact | None:
    """The first impact of the free flight from a state at a time since the section, within a span; times from start.

    A state that lies on a stop to within a double's rounding is a contact: the flight leaves it.
    """
    with mp.workdps(40):
        flight = pieces_of(cell, mp.mpf(start), stops=False)
        hits = piecewise.simulate(flight, on_stop(ModeLaws(flight), state), span=span).events
        return Impact(hits[0].t, 1 if hits[0].value > 0 else -1, abs(hits[0].value)) if hits else None


def _side(machine: piecewise.PiecewiseMachine, y: Number) -> int:
    stops = machine.contacts[0].stops
    return min(stops, key=lambda side: abs(stops[side] - y))
