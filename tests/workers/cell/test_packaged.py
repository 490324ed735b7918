"""What holds for every packaged system: cells solved over its usual axes."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from workers import Settings, solve_tile, trace
from workers.model.system import find_system, system_names
from workers.results import CHAOTIC, FAILED, INVALID, NO_IMPACT, PERIODIC

SPECTRUM = Settings(exponents="spectrum", survival=0, max_periods=3000, tolerance=0.05)
ONE_SIZE_IS_ENOUGH = [name for name in system_names() if name not in ("chain-4", "chain-6", "chain-7")]


def plane(name: str) -> dict[str, np.ndarray]:
    """A few values of its two usual parameters."""
    (x, x_low, x_high), (y, y_low, y_high) = find_system(name).axes[:2]
    return {x: np.linspace(x_low, x_high, 5)[None, :], y: np.linspace(y_low, y_high, 4)[:, None]}


@cache
def solved(name: str) -> dict[str, Any]:
    """The cells of its plane."""
    return solve_tile(name, plane(name), SPECTRUM)


@pytest.mark.parametrize("name", ONE_SIZE_IS_ENOUGH)
def test_no_cell_fails_and_some_have_impacts_or_stick_where_there_is_nothing_to_hit(name: str) -> None:
    found = solved(name)
    assert not np.isin(found["regime"], (FAILED, INVALID)).any()
    if find_system(name).definition.contacts:
        assert np.nanmax(found["impacts_per_period"]) > 0.0
    else:
        assert found["sticks"].any()


@pytest.mark.parametrize("name", ONE_SIZE_IS_ENOUGH)
def test_exponents_obey_the_sum_law(name: str) -> None:
    found = solved(name)
    size = np.sum(np.abs(found["spectrum"]), axis=-1)
    known = np.isfinite(found["sum_law_defect"])
    periods = np.where(np.isin(found["regime"], (PERIODIC, NO_IMPACT)), 1.0, found["periods_used"])
    sticking = np.isneginf(found["spectrum"]).any(axis=-1)  # for good: such an orbit has no finite sum
    assert known.any() or sticking[found["regime"] == PERIODIC].all()
    assert np.all(np.abs(found["sum_law_defect"][known]) <= 1e-11 * (1.0 + size[known]) * periods[known] ** 0.5)


@pytest.mark.parametrize("name", ONE_SIZE_IS_ENOUGH)
def test_a_proved_orbit_closes_when_it_is_followed(name: str) -> None:
    """From its stored state, by the history of one cell: the state after one turn, and the impacts of it."""
    system, axes, found = find_system(name), plane(name), solved(name)
    (x, xs), (y, ys) = axes.items()
    orbits = np.argwhere((found["regime"] == PERIODIC) & (found["period"] <= 8) & ~found["sticks"])
    for j, i in orbits[:4]:
        state, period = found["state"][j, i].copy(), int(found["period"][j, i])
        start = dict(zip(system.states, state.tolist(), strict=True))
        turn = trace(system, {x: float(xs[0, i]), y: float(ys[j, 0])} | start, period)
        if system.definition.drift:
            state[system.states.index(system.definition.drift)] += found["drift_per_period"][j, i] * period
        assert turn.states[-1] == pytest.approx(state, abs=1e-9 * (1.0 + np.abs(turn.states).max()))
        upper, lower = int(np.sum(turn.impacts[:, 1] > 0)), int(np.sum(turn.impacts[:, 1] < 0))
        assert (upper, lower) == (found["impacts_upper"][j, i], found["impacts_lower"][j, i])


@pytest.mark.parametrize("name", ["two-mass", "single-mass", "bouncing-ball", "impact-damper"])
def test_the_adaptive_schedule_agrees_with_the_fixed_one(name: str) -> None:
    """Largest exponents of the plane's cells within their errors, where both call the cell the same."""
    adaptive = solved(name)
    fixed = solve_tile(
        name, plane(name), Settings(method="fixed", exponents="largest", transient_periods=1000, periods=2000)
    )
    chaotic = (adaptive["regime"] == CHAOTIC) & (fixed["regime"] == CHAOTIC)
    periodic = (adaptive["regime"] == PERIODIC) & (fixed["regime"] == PERIODIC)
    same = periodic & (adaptive["period"] == fixed["period"])
    lost = np.isneginf(adaptive["largest"]) & np.isneginf(fixed["largest"])
    apart = np.abs(np.where(lost, 0.0, adaptive["largest"]) - np.where(lost, 0.0, fixed["largest"]))
    error = np.hypot(adaptive["error"], fixed["error"])
    assert np.all(apart[chaotic] <= 5.0 * error[chaotic])
    assert same.any()
    assert np.mean(apart[same] <= 1e-9) >= 0.9  # the others may have reached another attractor
