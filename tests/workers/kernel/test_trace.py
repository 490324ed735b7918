"""The history of one orbit."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from tests import naive
from workers.history import trace
from workers.kernel.coordinates import motion_from
from workers.kernel.motion import LOWER, UPPER
from workers.kernel.period import propagate
from workers.model.system import find_system
from workers.settings import Settings
from workers.tile import solve_tile


def test_the_history_starts_at_the_given_state_and_ends_where_solving_ends() -> None:
    params = naive.FIGURES[5] | {"x1": 0.05, "v2": -0.1}
    history = trace("two-mass", params, 20, Settings(exponents="none"))
    assert history.times == pytest.approx(np.arange(21) * 2 * math.pi / params["omega"], rel=1e-15)
    assert history.states.shape == (21, 4)
    assert history.states[0].tolist() == [0.05, 0.0, 0.0, -0.1]
    settings = Settings(exponents="none", method="fixed", transient_periods=0, periods=20)
    assert history.states[-1].tolist() == solve_tile("two-mass", params, settings)["state"].tolist()


def test_every_impact_lies_on_its_stop() -> None:
    """Truth: a plain flight by matrix exponential from the section before it."""
    p = naive.FIGURES[5]
    history = trace("two-mass", p, 8)
    assert len(history.impacts) > 10
    assert np.all(np.diff(history.impacts[:, 0]) > 0)
    assert set(history.impacts[:, 1]) == {1.0, -1.0}
    B = naive.first_order(p)
    z = np.array([0.0, 0.0, 0.0, 0.0, math.sin(p["tau"]), math.cos(p["tau"])])
    last = 0.0
    for t, side, speed in history.impacts[:12]:
        z = expm(B * (t - last)) @ z
        assert z[0] == pytest.approx(side * p["b"], abs=1e-10)
        assert side * z[2] == pytest.approx(speed, abs=1e-8)
        z[2] *= -p["R"]
        last = t


def test_the_running_exponents_converge_to_the_floquet_exponents() -> None:
    """Truth: 40-digit Floquet exponents of Fig. 4; the running mean's error falls like one over the time."""
    history = trace("two-mass", naive.FIGURES[4], 1000, Settings(exponents="spectrum"))
    exact = np.array([-0.475914135412643, -2.614830482264854, -2.614830482264854, -7.598746373733903])
    error = np.abs(history.exponents - exact).max(axis=1)
    assert history.exponents.shape == (1000, 4)
    assert error[-1] < 0.01
    assert error[-1] < 0.3 * error[99]


@pytest.mark.parametrize(("exponents", "count"), [("none", 0), ("largest", 1), ("spectrum", 4)])
def test_so_many_exponents_run_along_as_asked(exponents: str, count: int) -> None:
    assert trace("two-mass", naive.FIGURES[3], 3, Settings(exponents=exponents)).exponents.shape == (3, count)


def test_the_history_of_a_sticking_cell_loses_two_directions() -> None:
    history = trace("two-mass", naive.STICKING, 5, Settings(exponents="spectrum"))
    assert np.all(np.isfinite(history.exponents[-1, :2]))
    assert np.all(history.exponents[-1, 2:] == -np.inf)


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"R": 1.2}, "R = 1.2"), ({"b": 0.0}, "0 < b"), ({"x1": 1.0}, "beyond a stop"), ({"omega": math.nan}, "omega")],
)
def test_a_cell_without_a_motion_is_refused_in_one_line(changes: dict[str, float], says: str) -> None:
    with pytest.raises(ValueError, match=says) as refused:
        trace("two-mass", naive.FIGURES[3] | changes, 3)
    assert "\n" not in str(refused.value)


def test_every_impact_of_a_period_of_thousands_is_kept() -> None:
    """Truth: the kernel's count of impacts at either stop, which needs no record; the last one before a rest and the
    beginning of the rest are written down and not counted."""
    many = naive.FIGURES[3] | {"omega": 0.05, "b": 0.002, "R": 0.999}
    system = find_system("two-mass")
    osc = system.build({p.name: many.get(p.name, p.default) for p in system.parameters})
    motion = motion_from(osc, np.zeros(4))
    propagate(osc, motion, osc.period)
    count = motion.tally[UPPER] + motion.tally[LOWER]
    history = trace(system, many, 1, Settings(exponents="none"))
    rests = int(np.sum(history.impacts[:, 2] == 0.0))
    assert count > 3 * 4096 and len(history.impacts) == count + 2 * rests
    assert np.all(np.diff(history.impacts[:, 0]) > 0.0)


def test_a_motion_of_too_many_impacts_is_refused_in_one_line() -> None:
    """Truth: 16,000 impacts a period cost an evaluation each at least; so few periods may cost two million."""
    many = naive.FIGURES[3] | {"omega": 0.05, "b": 0.002, "R": 0.999}
    with pytest.raises(ValueError, match=r"^period \d+: its budget of evaluations of the motion is spent$"):
        trace("two-mass", many, 1000, Settings(exponents="none"))


def test_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(KeyError, match="did you mean 'zeta'"):
        trace("two-mass", {"zta": 0.1}, 3)


def test_the_door_stays_a_function_however_often_it_is_opened() -> None:
    import workers

    for _ in range(3):
        assert callable(workers.trace)
        assert callable(workers.solve_tile)
