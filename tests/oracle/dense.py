"""First impacts and clearances of many free flights in double precision, by sampling far below the fastest time scale.

What double precision cannot decide, a peak within about 1e-9 of a stop, is handed to the multiprecision flight.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import factorial, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from tests.oracle.model import V1, X1, model
from tests.oracle.simulate import first_hit

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
    confirmed: int  # how many flights multiprecision had to decide


@dataclass(frozen=True)
class _Flights:
    """One parameter set's flow, and the extended states (x1, x2, v1, v2, sin, cos) of flights at their starts."""

    B: Array
    step: float
    b: float
    start: Array  # (6, n)

    @classmethod
    def of(cls, params: Mapping[str, float], states: ArrayLike, starts: ArrayLike) -> "_Flights":
        made = model(params)
        B = np.zeros((6, 6))
        for i, row in enumerate(made.free.rows):
            for j, entry in row.items():
                B[i, j] = float(entry)
        physical = np.atleast_2d(np.asarray(states, dtype=float)).T
        angle = params["omega"] * np.broadcast_to(np.asarray(starts, dtype=float), physical.shape[1:]) + params["tau"]
        start = np.vstack([physical, np.sin(angle), np.cos(angle)])
        return cls(B, 2 * pi / (float(made.free.rate) * SAMPLES), float(params["b"]), start)

    def blocks(self, horizon: float) -> Iterator[tuple[int, Array]]:
        """Index of the first sample and the samples (BLOCK + 1, 6, n) of each block; blocks share their ends."""
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
        """The state a time, at most one sample step, later."""
        return np.array([np.polyval(self.polynomial(state, unit), time) for unit in np.eye(6)])


_POSITION = np.eye(6)[X1]
_VELOCITY = np.eye(6)[V1]


def _bisect(rises: Callable[[float], bool], low: float, high: float) -> float:
    """Where a predicate that is false at low and true at high turns true."""
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (low, middle) if rises(middle) else (middle, high)
    return high


def _peak(flights: _Flights, state: Array, side: int, span: float) -> tuple[float, float]:
    """Time after a sample and height toward the stop of the maximum within the span, where the velocity turns."""
    velocity = flights.polynomial(state, side * _VELOCITY)
    time = _bisect(lambda t: bool(np.polyval(velocity, t) <= 0), 0.0, span)
    return time, float(np.polyval(flights.polynomial(state, side * _POSITION), time))


def _suspicious(samples: Array, side: int, step: float, level: Array | float) -> NDArray[np.bool_]:
    """Intervals (m, n) in which side * x1 may exceed the level: it does at the end, or it has a maximum that may."""
    position, velocity = side * samples[:, X1], side * samples[:, V1]
    higher = np.maximum(position[:-1], position[1:])
    bulge = step * np.abs(np.diff(velocity, axis=0)) / 4  # h^2 a / 8, with room for a to vary
    turns = (velocity[:-1] > 0) & (velocity[1:] <= 0)
    result: NDArray[np.bool_] = (position[1:] >= level) | (turns & (higher + bulge >= level))
    return result


def first_impact_dense(
    params: Mapping[str, float], states: ArrayLike, starts: ArrayLike, horizon: float
) -> FirstImpacts:
    """First impacts of free flights of one parameter set within a horizon after their starts.

    ``states`` (n, 4) physical states between the stops, or exactly on one with a velocity or an acceleration;
    ``starts`` (n) or a number: times since the section, which set the forcing's phase.
    """
    flights = _Flights.of(params, states, starts)
    count = flights.start.shape[1]
    begin = np.broadcast_to(np.asarray(starts, dtype=float), (count,))
    time, side = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    speed = np.full(count, np.nan)
    confirmed = 0
    doubt = DOUBTFUL * flights.b + 1e-12 * np.abs(flights.start).max(axis=0)
    open_ = np.ones(count, dtype=bool)

    def confirm(n: int, span: float) -> bool:
        """Let multiprecision fly until the span; true if it finds an impact."""
        nonlocal confirmed
        confirmed += 1
        hit = first_hit(params, flights.start[:4, n].tolist(), float(begin[n]), span)
        if hit is not None:
            time[n], side[n], speed[n], open_[n] = float(hit.t), hit.side, float(hit.speed), False
        return hit is not None

    on_stop = np.abs(flights.start[X1]) == flights.b
    for n in np.flatnonzero(on_stop):
        confirm(int(n), min(flights.step, horizon))
    for first, samples in flights.blocks(horizon):
        upper = _suspicious(samples, 1, flights.step, flights.b - doubt)
        lower = _suspicious(samples, -1, flights.step, flights.b - doubt)
        if first == 0:
            upper[0, on_stop] = lower[0, on_stop] = False
        for n in np.flatnonzero((upper | lower).any(axis=0) & open_):
            for j in np.flatnonzero(upper[:, n] | lower[:, n]):
                s = 1 if upper[j, n] else -1
                state = samples[j, :, n]
                span = flights.step
                ends_below = s * samples[j + 1, X1, n] < flights.b + doubt[n]
                turns = s * state[V1] > 0 >= s * samples[j + 1, V1, n]
                if turns:
                    span, height = _peak(flights, state, s, span)
                    if height < flights.b - doubt[n]:
                        continue
                    ends_below = height < flights.b + doubt[n]
                if ends_below or abs(state[X1]) > flights.b - doubt[n]:
                    if confirm(int(n), float(min((first + j + 2) * flights.step, horizon))):
                        break
                    continue
                position = flights.polynomial(state, s * _POSITION)
                root = _bisect(lambda t, p=position: bool(np.polyval(p, t) >= flights.b), 0.0, span)  # type: ignore[misc]
                open_[n] = False
                moment = (first + j) * flights.step + root
                if moment <= horizon:
                    time[n], side[n] = moment, s
                    speed[n] = np.polyval(flights.polynomial(state, s * _VELOCITY), root)
                break
        if not open_.any():
            break
    return FirstImpacts(time, side, speed, confirmed)


def dense_violation(params: Mapping[str, float], states: ArrayLike, starts: ArrayLike, durations: ArrayLike) -> Array:
    """Largest |x1| - b in each of many free flights: positive where an impact was missed.

    ``states`` (n, 4) at the flights' starts, ``starts`` (n) their times since the section, ``durations`` (n).
    """
    flights = _Flights.of(params, states, starts)
    lasts = np.broadcast_to(np.asarray(durations, dtype=float), flights.start.shape[1:])
    highest = np.abs(flights.start[X1])
    for first, samples in flights.blocks(float(lasts.max())):
        left = lasts - first * flights.step
        for n in np.flatnonzero(left > 0):
            whole = min(int(left[n] / flights.step), BLOCK)
            inside = samples[: whole + 1, :, n]
            if whole < BLOCK:  # the flight ends in this block: close it with a sample at its very end
                rest = left[n] - whole * flights.step
                inside = np.vstack([inside, flights.after(inside[-1], rest)])
            highest[n] = max(highest[n], np.abs(inside[:, X1]).max())
            for s in (1, -1):
                for j in np.flatnonzero(_suspicious(inside[:, :, None], s, flights.step, highest[n])[:, 0]):
                    if s * inside[j, V1] > 0 >= s * inside[j + 1, V1]:
                        highest[n] = max(highest[n], _peak(flights, inside[j], s, flights.step)[1])
    return highest - flights.b


__all__ = ["FirstImpacts", "dense_violation", "first_impact_dense"]
