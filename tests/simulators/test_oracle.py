"""The oracle itself, against closed forms and invariants: what checks the solver has to be right first."""

import math

import pytest
from mpmath import mp

from tests.support.oracle import simulate, symmetric_orbit
from tests.support.oracle.crossing import first_upward_zero

FIG3 = {"mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "tau": math.pi, "R": 0.8, "b": 0.1}
STICKING = {**FIG3, "R": 0.3, "b": 0.15, "omega": 1.0}


def polynomial_with_zeros(*zeros: float) -> list:
    """Coefficients, lowest first, with sign so that it is negative before the first zero."""
    coefficients = [mp.mpf(-1)]
    for zero in zeros:
        shifted = [mp.zero, *coefficients]
        coefficients = [a / zero - b for a, b in zip(shifted, [*coefficients, mp.zero], strict=True)]
    sign = -1 if coefficients[0] > 0 else 1
    return [sign * value for value in coefficients]


def test_first_zero_of_a_polynomial_is_found_among_several() -> None:
    with mp.workdps(40):
        found = first_upward_zero(polynomial_with_zeros(0.7, 0.3, 0.31), mp.mpf("1e-38"))
        assert abs(found - mp.mpf(0.3)) < 1e-35


@pytest.mark.parametrize("clearance", ["1e-3", "1e-9", "1e-15", "1e-24"])
def test_parabola_that_just_reaches_zero_is_a_crossing_and_one_that_just_fails_is_not(clearance: str) -> None:
    with mp.workdps(60):
        gap, peak = mp.mpf(clearance), mp.mpf(1) / 3
        reaching = [gap - peak**2, 2 * peak, mp.mpf(-1)]
        missing = [-gap - peak**2, 2 * peak, mp.mpf(-1)]
        assert abs(first_upward_zero(reaching, mp.mpf("1e-58")) - (peak - mp.sqrt(gap))) < 1e-40
        assert first_upward_zero(missing, mp.mpf("1e-58")) is None


def test_closed_form_of_fig_3_has_the_published_exponents() -> None:
    published = [-0.235569640371152, -0.235569640371152, -0.524876727616246, -0.524876727616246]
    orbits = symmetric_orbit(FIG3)
    stable = [orbit for orbit in orbits if orbit.exponents[0] < 0]
    assert len(stable) == 1
    assert [float(value) for value in stable[0].exponents] == pytest.approx(published, abs=1e-14)


@pytest.mark.slow
def test_sticking_orbit_does_not_depend_on_when_chatter_is_cut_short() -> None:
    coarse, fine = (simulate(STICKING, 6, rest=rest).sections[-1] for rest in (1e-7, 1e-12))
    assert max(abs(a - b) for a, b in zip(coarse, fine, strict=True)) < 1e-19


def test_stuck_mass_stays_on_its_stop_and_leaves_when_the_acceleration_turns() -> None:
    run = simulate(STICKING, 10)
    last = run.stuck[-2]
    assert 0 < last.end - last.start < 2 * math.pi
    # Released without speed or acceleration, it must not be taken to hit the stop that it leaves.
    between = [impact for impact in run.impacts if impact.t > last.end]
    assert between[0].t - last.end > 0.1
    assert between[0].side == -last.side


def test_inelastic_impact_rests_at_once_or_leaves() -> None:
    run = simulate({**STICKING, "R": 0.0}, 10)
    assert len(run.stuck) > 5
    assert all(any(impact.t == stuck.start for impact in run.impacts) for stuck in run.stuck)


@pytest.mark.parametrize(
    ("state", "impacts", "rests"),
    [
        ({"x1": 0.15, "v1": 0.2}, 1, False),
        ({"x1": 0.15, "v1": -0.2}, 0, False),
        ({"x1": 0.15, "x2": 5.0}, 0, True),
        ({"x1": 0.15, "x2": -5.0}, 0, False),
    ],
    ids=["outward", "inward", "pressed", "pulled away"],
)
def test_initial_state_on_a_stop_is_the_contact_that_it_is(state: dict, impacts: int, rests: bool) -> None:
    run = simulate({**STICKING, **state}, 1)
    at_once = [impact for impact in run.impacts if impact.t == 0]
    assert len(at_once) == impacts
    assert bool(run.stuck and run.stuck[0].start == 0) == rests
