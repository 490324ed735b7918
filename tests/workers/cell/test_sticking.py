"""Chatter, rest and release beyond one period: Jacobians by differences, rest for ever, and what is lost exactly."""

import math
from typing import Any

import numpy as np
import pytest

from tests import naive
from tests.oscillators import mass_spring
from tests.support.oracle.simulate import section_jacobian
from tests.workers.orbit.test_stroboscopic import KINDS, jacobian
from workers.cell.cell_batch import CellBatch
from workers.cell.interval import run_periods
from workers.cell.solve import solve
from workers.kernel.coordinates import motion_from
from workers.kernel.motion import FLIGHT, LOST, STUCK
from workers.model.hybrid_modes import ON
from workers.model.oscillator import Oscillator, many_of
from workers.results import PERIODIC, empty_results, result_variables
from workers.settings import Settings

START = {"x1": 0.01, "x2": -0.02, "v1": 0.05, "v2": 0.03}


RESTING = ["sticks", "sticks, R = 0", "long chatter", "held at the section", "leaves at once, R = 0"]


@pytest.mark.parametrize("kind", RESTING)
def test_the_jacobian_agrees_with_multiprecision_orbits_through_rest_and_release(kind: str) -> None:
    """Truth: differences of 36-digit orbits that follow every hop down to 1e-14 of a time scale."""
    params = KINDS[kind] | START
    osc, state = naive.two_mass(**params)
    true = np.array([[float(v) for v in row] for row in section_jacobian(params, 1, 36)])
    assert jacobian(osc, state, 1) == pytest.approx(true, abs=2e-4 * np.abs(true).max())


def preloaded(force: float = 0.01, R: float = 0.6) -> tuple[Oscillator, np.ndarray]:
    """Stops at 0.2 and 0.3: the springs press mass 1 on the lower one, the weak force never lifts it."""
    osc = mass_spring(
        mass=np.diag([1.0, 2.0]), damping=0.1 * np.array([[1.0, -1.0], [-1.0, 6.0]]),
        stiffness=np.array([[1.0, -1.0], [-1.0, 6.0]]), gap_row=np.array([1.0, 0.0]), force=np.array([force, 0.0]),
        omega=1.3, tau=0.4, b_upper=0.3, b_lower=-0.2, R=R,
    )  # fmt: skip
    return osc, np.array([0.25, 0.0, 0.1, 0.0])


def solved(osc: Oscillator, start: np.ndarray) -> dict[str, Any]:
    """The results of one cell, with all exponents."""
    settings = Settings(exponents="spectrum")
    found = empty_results(result_variables(settings), (1,), {"exponent": 4, "state": 4})
    solve(CellBatch(many_of(osc), np.zeros(1, dtype=np.int8), start[None], settings, found))
    return {name: array[0] for name, array in found.items()}


def test_a_mass_that_is_always_pressed_on_a_stop_rests_there_for_ever() -> None:
    """Nothing waits for a release: the time at rest is all the time once it has begun."""
    osc, start = preloaded()
    motion = motion_from(osc, start)
    assert run_periods(osc, motion, 50) == 50
    before = motion.tally[STUCK]
    assert run_periods(osc, motion, 50) == 50
    assert motion.tally[STUCK] - before == pytest.approx(50 * osc.period, rel=1e-13)
    assert motion.mode[0] == FLIGHT - ON
    assert motion.tally[LOST] == 2


def test_a_mass_at_rest_for_ever_has_the_exponents_of_what_is_left() -> None:
    """Truth: mass 2 alone, x2'' + 0.3 x2' + 3 x2 = ..., decays at 0.15; the other two directions are lost."""
    osc, start = preloaded()
    cell = solved(osc, start)
    assert (cell["regime"], cell["period"], cell["sticks"]) == (PERIODIC, 1, True)
    assert cell["stuck_fraction"] == pytest.approx(1.0, abs=1e-13)
    assert cell["spectrum"][:2] == pytest.approx([-0.15 * osc.period] * 2, rel=1e-10)
    assert np.all(cell["spectrum"][2:] == -math.inf)


@pytest.mark.parametrize(("kind", "lost"), [("sticks", 2), ("sticks, R = 0", 2), ("leaves at once, R = 0", 1)])
def test_exponents_are_minus_infinity_exactly_where_directions_are_lost(kind: str, lost: int) -> None:
    osc, start = naive.two_mass(**KINDS[kind])
    cell = solved(osc, start)
    assert int(np.sum(cell["spectrum"] == -math.inf)) == lost
    assert np.all(np.isfinite(cell["spectrum"][: 4 - lost]))
