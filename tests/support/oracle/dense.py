"""First impacts and clearances of many free flights in double precision, by samples far below the fastest time scale.

Cases that double precision cannot decide, peaks within about 1e-9 of a stop, go to the multiprecision flight.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import factorial, inf, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from tests.support.oracle.model import Cell, Y, model
from tests.support.oracle.simulate import DOUBLE, first_hit

Array = NDArray[np.float64]

SAMPLES = 2000  # per 2 pi / rate, the fastest time scale
BLOCK = 256
DOUBTFUL = 1e-9  # relative clearance below which multiprecision decides
DEGREE = 9  # of the Taylor polynomial between samples: (2 pi / SAMPLES)^9 / 9! is far below rounding


@dataclass(frozen=True)
class FirstImpacts:
    """Per flight: time from its start (infinity without impact), side (+1, -1, or 0 without) and speed (NaN)."""

    time: Array
    side: NDArray[np.int64]
    speed: Array
    confirmed: int  # flights decided by multiprecision


@dataclass(frozen=True)
class _Flights:
    """One machine's flow, and the states of flights at their starts: those of Model in double precision."""

    B: Array
    step: float
    n: int
    stops: dict[int, float]  # by side
    start: Array  # (states, flights)

    @classmethod
    def of(cls, cell: Cell, states: ArrayLike, starts: ArrayLike) -> "_Flights":
        machine = model(cell)
        B = np.zeros((len(machine.free.rows),) * 2)
        for i, row in enumerate(machine.free.rows):
            for j, entry in row.items():
                B[i, j] = float(entry)
        T, g = np.array(machine.to_gap.tolist(), dtype=float), np.array(machine.gap_row, dtype=float)
        x, v = np.split(np.atleast_2d(np.asarray(states, dtype=float)).T, 2)
        angle = float(machine.omega) * np.broadcast_to(np.asarray(starts, dtype=float), x.shape[1:]) + float(
            machine.tau
        )
        drive = [f(k * angle) for k in machine.harmonics for f in (np.sin, np.cos)]
        start = np.vstack([T @ x, T @ v, *drive, np.ones(x.shape[1])])
        stops = {side: float(stop) for side, stop in machine.stops.items()}
        for stop in stops.values():
            near = np.abs(start[Y] - stop) <= 8 * DOUBLE * (np.abs(g) @ np.abs(x) + abs(stop))
            start[Y, near] = stop
        return cls(B, 2 * pi / (float(machine.free.rate) * SAMPLES), machine.n, stops, start)

    @property
    def velocity(self) -> int:
        """Index of the gap coordinate's velocity."""
        return self.n + Y

    def limit(self, side: int) -> float:
        """Largest value of the gap coordinate toward a side."""
        return side * self.stops[side] if side in self.stops else inf

    def on_stop(self) -> NDArray[np.bool_]:
        """Mask of flights that start on a stop."""
        return np.isin(self.start[Y], list(self.stops.values()))

    def blocks(self, horizon: float) -> Iterator[tuple[int, Array]]:
        """Index of the first sample, and the samples (BLOCK + 1, states, flights) of a block; ends are shared."""
        fine = expm(self.B * self.step * np.arange(BLOCK + 1)[:, None, None])
        for first in range(0, int(np.ceil(horizon / self.step)), BLOCK):
            yield first, fine @ (expm(self.B * self.step * first) @ self.start)

    def polynomial(self, state: Array, functional: Array) -> Array:
        """Taylor coefficients in time, highest first, of a functional of the state between two samples."""
        coefficients = []
        for order in range(DEGREE + 1):
            coefficients.append(functional @ state / factorial(order))
            state = self.B @ state
        return np.array(coefficients[::-1])

    def after(self, state: Array, time: float) -> Array:
        """The state after a time of at most one sample step."""
        return np.array([np.polyval(self.polynomial(state, unit), time) for unit in np.eye(len(state))])

    def gap(self, state: Array, side: int, derivative: int = 0) -> Array:
        """The polynomial of the gap coordinate, or of its velocity, toward a side."""
        return self.polynomial(state, side * np.eye(len(state))[derivative * self.n + Y])


def _bisect(rises: Callable[[float], bool], low: float, high: float) -> float:
    """The point where a predicate, false at low and true at high, becomes true."""
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (low, middle) if rises(middle) else (middle, high)
    return high


def _peak(flights: _Flights, state: Array, side: int, span: float) -> tuple[float, float]:
    """Time after a sample and height toward the stop of the maximum within the span, where the velocity turns."""
    velocity = flights.gap(state, side, 1)
    time = _bisect(lambda t: bool(np.polyval(velocity, t) <= 0), 0.0, span)
    return time, float(np.polyval(flights.gap(state, side), time))


def _suspicious(flights: _Flights, samples: Array, side: int, level: Array | float) -> NDArray[np.bool_]:
    """Intervals (m, n) in which side * y may exceed the level: at the end, or at a maximum."""
    position, velocity = side * samples[:, Y], side * samples[:, flights.velocity]
    higher = np.maximum(position[:-1], position[1:])
    bulge = flights.step * np.abs(np.diff(velocity, axis=0)) / 4  # h^2 a / 8, with room for changes of a
    turns = (velocity[:-1] > 0) & (velocity[1:] <= 0)
    result: NDArray[np.bool_] = (position[1:] >= level) | (turns & (higher + bulge >= level))
    return result


def first_impact_dense(cell: Cell, states: ArrayLike, starts: ArrayLike, horizon: float) -> FirstImpacts:
    """First impacts of free flights of one machine within a horizon after their starts.

    ``states`` (N, 2n) displacements and velocities between the stops, or to within rounding on one with a velocity or
    an acceleration; ``starts`` (N) or a number: times since the section, which set the forcing's phase.
    """
    flights = _Flights.of(cell, states, starts)
    count = flights.start.shape[1]
    physical = np.atleast_2d(np.asarray(states, dtype=float))
    begin = np.broadcast_to(np.asarray(starts, dtype=float), (count,))
    time, side = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    speed = np.full(count, np.nan)
    confirmed = 0
    widest = max((abs(stop) for stop in flights.stops.values()), default=0.0)
    doubt = DOUBTFUL * widest + 1e-12 * np.abs(flights.start).max(axis=0)
    open_ = np.ones(count, dtype=bool)

    def confirm(n: int, span: float) -> bool:
        """Let multiprecision fly until the span; true if it finds an impact."""
        nonlocal confirmed
        confirmed += 1
        hit = first_hit(cell, physical[n].tolist(), float(begin[n]), span)
        if hit is not None:
            time[n], side[n], speed[n], open_[n] = float(hit.t), hit.side, float(hit.speed), False
        return hit is not None

    on_stop = flights.on_stop()
    for n in np.flatnonzero(on_stop):
        confirm(int(n), min(flights.step, horizon))
    for first, samples in flights.blocks(horizon):
        upper, lower = (_suspicious(flights, samples, s, flights.limit(s) - doubt) for s in (1, -1))
        if first == 0:
            upper[0, on_stop] = lower[0, on_stop] = False
        for n in np.flatnonzero((upper | lower).any(axis=0) & open_):
            for j in np.flatnonzero(upper[:, n] | lower[:, n]):
                s = 1 if upper[j, n] else -1
                state, limit = samples[j, :, n], flights.limit(s)
                span = flights.step
                ends_below = s * samples[j + 1, Y, n] < limit + doubt[n]
                turns = s * state[flights.velocity] > 0 >= s * samples[j + 1, flights.velocity, n]
                if turns:
                    span, height = _peak(flights, state, s, span)
                    if height < limit - doubt[n]:
                        continue
                    ends_below = height < limit + doubt[n]
                if ends_below or s * state[Y] > limit - doubt[n]:
                    if confirm(int(n), float(min((first + j + 2) * flights.step, horizon))):
                        break
                    continue
                position = flights.gap(state, s)
                root = _bisect(lambda t, p=position, y=limit: bool(np.polyval(p, t) >= y), 0.0, span)  # type: ignore[misc]
                open_[n] = False
                moment = (first + j) * flights.step + root
                if moment <= horizon:
                    time[n], side[n] = moment, s
                    speed[n] = np.polyval(flights.gap(state, s, 1), root)
                break
        if not open_.any():
            break
    return FirstImpacts(time, side, speed, confirmed)


def dense_violation(cell: Cell, states: ArrayLike, starts: ArrayLike, durations: ArrayLike) -> Array:
    """Largest distance of each free flight beyond a stop: positive for a missed impact.

    ``states`` (N, 2n) at the flights' starts, ``starts`` (N) their times since the section, ``durations`` (N).
    """
    flights = _Flights.of(cell, states, starts)
    lasts = np.broadcast_to(np.asarray(durations, dtype=float), flights.start.shape[1:])
    highest = {side: side * flights.start[Y] for side in flights.stops}
    for first, samples in flights.blocks(float(lasts.max())):
        left = lasts - first * flights.step
        for n in np.flatnonzero(left > 0):
            whole = min(int(left[n] / flights.step), BLOCK)
            inside = samples[: whole + 1, :, n]
            if whole < BLOCK:  # the flight ends in this block, with a sample at its very end
                rest = left[n] - whole * flights.step
                inside = np.vstack([inside, flights.after(inside[-1], rest)])
            for s, most in highest.items():
                most[n] = max(most[n], (s * inside[:, Y]).max())
                for j in np.flatnonzero(_suspicious(flights, inside[:, :, None], s, most[n])[:, 0]):
                    if s * inside[j, flights.velocity] > 0 >= s * inside[j + 1, flights.velocity]:
                        most[n] = max(most[n], _peak(flights, inside[j], s, flights.step)[1])
    return np.max([most - flights.limit(s) for s, most in highest.items()], axis=0)


__all__ = ["FirstImpacts", "dense_violation", "first_impact_dense"]
