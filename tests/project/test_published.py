"""Claims about the gallery of published results: its page is that of its JSON, and its closed forms are right.

The closed forms of scripts/published are held against scipy's integrator with events, and against maps whose times are
bisected and whose derivatives are differences. Neither shares code with the solver. test_den_hartog.py and
test_branch_fig6.py have further references of the gallery.
"""

import json
from collections.abc import Callable
from math import atan2, cos, hypot, log, pi, sin, sqrt

import numpy as np
import pytest
from mpmath import mp
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from scripts.published.entries import (
    ENTRIES,
    bapat_1983,
    den_hartog_1931,
    hertz_1882,
    holmes_1982,
    holmes_phase_1982,
    ing_2008,
    li_tan_2011,
    masri_caughey_1966,
    mehta_luck_1990,
    popp_stelter_1990,
    shaw_1986,
)
from scripts.published.one_impact import OneImpact
from scripts.published.page import page_of, table
from tests import naive
from tests.paths import ROOT
from tests.support.oracle.closed_form import symmetric_orbit
from workers import SOLVER_VERSION

Array = NDArray[np.float64]
STORED = json.loads((ROOT / "docs/published.json").read_text())
BY_NAME = {entry.name: entry for entry in ENTRIES}
BY_STORED = {entry["name"]: entry for entry in STORED["entries"]}


def test_the_page_is_that_of_the_json() -> None:
    assert (ROOT / "docs/published.md").read_text() == page_of(STORED), "run python -m scripts.published"


def test_the_tables_are_those_of_the_json() -> None:
    tables = {path.stem: path.read_text() for path in (ROOT / "docs/published").iterdir()}
    assert tables == {name: table(entry["statements"]) for name, entry in BY_STORED.items()}


def test_the_json_holds_every_entry_of_the_present_solver() -> None:
    assert list(BY_STORED) == list(BY_NAME)
    assert STORED["solver_version"] == SOLVER_VERSION


@pytest.mark.parametrize("name", BY_NAME)
def test_the_texts_of_an_entry_are_those_of_its_module(name: str) -> None:
    entry, stored = BY_NAME[name], BY_STORED[name]
    for key in ("work", "link", "place", "title", "machine", "example", "caption"):
        assert stored[key] == getattr(entry, key), f"run python -m scripts.published {name}"
    assert tuple(stored["commands"]) == entry.commands
    assert bool(entry.caption) == (entry.picture is not None)


def test_there_are_at_least_twelve_entries_of_nine_works() -> None:
    assert len(BY_STORED) >= 12
    assert len({entry["work"] for entry in BY_STORED.values()}) >= 9


def test_every_difference_has_a_reason() -> None:
    differing = [
        statement for entry in BY_STORED.values() for statement in entry["statements"] if not statement["agrees"]
    ]
    assert differing and all(statement["reason"] for statement in differing)


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_NAME)
def test_an_entry_that_is_computed_again_has_the_numbers_of_the_page(name: str) -> None:
    found = BY_NAME[name].run()["statements"]
    assert len(found) == len(BY_STORED[name]["statements"])
    for now, then in zip(found, BY_STORED[name]["statements"], strict=True):
        assert {key: now[key] for key in ("text", "basis", "agrees")} == {
            key: then[key] for key in ("text", "basis", "agrees")
        }
        for key in ("reference", "ours"):
            exact = isinstance(then[key], str | int)
            assert now[key] == (then[key] if exact else pytest.approx(then[key], abs=1e-9)), now["text"]


# Orbits with one impact of a mass on a spring


def to_impact(law: OneImpact, A: float, sigma: float, start: tuple[float, float], skip: int = 0) -> tuple[float, float]:
    """From (phase of the forced response, speed before) at an impact to the same ``skip`` + 1 approaches later."""
    F, omega, zeta = law.response * A, law.omega, law.zeta
    force = (F * (1.0 - omega**2), 2.0 * F * zeta * omega)

    def rate(t: float, z: Array) -> list[float]:
        phase = start[0] + omega * t
        return [z[1], force[0] * sin(phase) + force[1] * cos(phase) - 2.0 * zeta * z[1] - z[0]]

    def distance(t: float, z: Array) -> float:
        return z[0] - sigma

    distance.terminal, distance.direction = skip + 1, 1.0  # type: ignore[attr-defined]
    begin = [sigma, -law.R * start[1]]
    span = (0.0, 2.5 * law.periods * 2.0 * pi / omega)
    run = solve_ivp(rate, span, begin, method="DOP853", rtol=1e-12, atol=1e-13, events=distance)
    return start[0] + omega * run.t_events[0][-1] - 2.0 * pi * law.periods, float(run.y_events[0][-1][1])


def start_of(law: OneImpact, A: float, sigma: float, v: float) -> tuple[float, float]:
    return atan2(sigma - law.alpha * v, -law.beta * v / law.omega), v


def multipliers(step: Callable[[Array], Array], at: Array, h: float = 1e-6) -> Array:
    """Eigenvalues of a map's derivative, from central differences."""
    columns = [(step(at + h * unit) - step(at - h * unit)) / (2.0 * h) for unit in np.eye(at.size)]
    return np.asarray(np.linalg.eigvals(np.array(columns).T))


@pytest.mark.parametrize(
    ("law", "A", "sigma"),
    [
        (OneImpact(1.8, 0.05, 0.8), 3.0, 1.0),
        (OneImpact(2.2, 0.05, 0.8), 6.0, 1.0),
        (OneImpact(1.0, 0.05, 0.8), 1.0, 1.0),
        (OneImpact(2.0, 0.0, 0.8), 1.0, -0.2),
        (OneImpact(4.0, 0.0, 0.8, 2), 1.0, 0.02),
    ],
)
def test_an_orbit_with_one_impact_closes(law: OneImpact, A: float, sigma: float) -> None:
    start = start_of(law, A, sigma, law.speeds(sigma, A)[0])
    assert to_impact(law, A, sigma, start) == pytest.approx(start, abs=1e-9)


@pytest.mark.parametrize(("omega", "zeta"), [(2.2, 0.05), (2.3, 0.05), (2.2, 0.0)])
def test_a_multiplier_is_minus_one_at_the_doubling(omega: float, zeta: float) -> None:
    law = OneImpact(omega, zeta, 0.8)
    sigma = law.doubling
    start = np.array(start_of(law, 1.0, sigma, law.doubling_ratio * sigma))
    found = multipliers(lambda z: np.array(to_impact(law, 1.0, sigma, (z[0], z[1]))), start)
    assert np.min(np.abs(found + 1.0)) < 1e-5


@pytest.mark.parametrize(("omega", "zeta"), [(1.8, 0.05), (1.8, 0.0)])
def test_both_orbits_with_one_impact_meet_at_the_fold(omega: float, zeta: float) -> None:
    law = OneImpact(omega, zeta, 0.8)
    assert len(law.speeds(law.fold * (1.0 - 1e-9), 1.0)) == 2
    assert len(law.speeds(law.fold * (1.0 + 1e-9), 1.0)) == 0
    first, second = law.speeds(law.fold * (1.0 - 1e-9), 1.0)
    assert first == pytest.approx(second, rel=1e-3)


# The ball and the impact pair: free flights


def first_zero(function: Callable[[float], float], begin: float, step: float = 1e-3) -> float:
    """The first zero of a function that is positive after its beginning."""
    t = begin
    while function(t + step) > 0.0:
        t += step
    return float(brentq(function, t, t + step, xtol=1e-15))


def bounce(R: float, a: float, z: Array) -> Array:
    """Phase and absolute speed after a bounce of the ball, to the same after the next one, at omega = g = 1."""
    t0, V = z

    def height(t: float) -> float:
        return a * sin(t0) + V * t - 0.5 * t**2 - a * sin(t0 + t)

    t = first_zero(height, 0.2)
    return np.array([t0 + t, (1.0 + R) * a * cos(t0 + t) - R * (V - t)])


@pytest.mark.parametrize(("R", "n", "A"), holmes_1982.CASES)
def test_the_ball_bounces_once_in_n_periods(R: float, n: int, A: float) -> None:
    start = np.array([np.arccos(holmes_1982.least(R, n) / A), n * pi])
    assert bounce(R, A, start) - [2.0 * pi * n, 0.0] == pytest.approx(start, abs=1e-9)
    assert A * cos(start[0]) - (n * pi - 2.0 * pi * n) == pytest.approx(holmes_1982.speed(R, n))
    largest = np.max(np.abs(multipliers(lambda z: bounce(R, A, z), start)))
    assert log(largest) / n == pytest.approx(log(R) / n, abs=1e-6)


@pytest.mark.parametrize(("R", "n", "A"), holmes_1982.CASES)
def test_the_period_of_the_ball_doubles_where_a_multiplier_is_minus_one(R: float, n: int, A: float) -> None:
    a = holmes_1982.doubling(R, n)
    start = np.array([np.arccos(holmes_1982.least(R, n) / a), n * pi])
    assert np.min(np.abs(multipliers(lambda z: bounce(R, a, z), start) + 1.0)) < 1e-6


def cross(R: float, nu: float, z: Array) -> Array:
    """Phase and absolute speed after the lower wall, to the same after the upper one, mirrored; alpha = omega = 1."""
    t0, V = z

    def gap(t: float) -> float:
        return nu - V * t - sin(t0) + sin(t0 + t)

    t = first_zero(gap, 0.0)
    return np.array([t0 + t - pi, -((1.0 + R) * cos(t0 + t) - R * V)])


@pytest.mark.parametrize("R", [0.6, 0.75, 0.9])
def test_the_impact_pair_loses_its_symmetry_where_a_multiplier_is_minus_one(R: float) -> None:
    nu = bapat_1983.breaking(R)
    V = bapat_1983.speed(R, nu) * (1.0 + R) / 2.0
    start = np.array([-np.arccos(bapat_1983.mu(R) * V), V])
    assert cross(R, nu, start) == pytest.approx(start, abs=1e-9)
    assert np.min(np.abs(multipliers(lambda z: cross(R, nu, z), start) + 1.0)) < 1e-5


@pytest.mark.parametrize("R", [0.6, 0.75, 0.9])
def test_the_symmetric_orbits_of_the_impact_pair_are_born_where_a_multiplier_is_one(R: float) -> None:
    theta = np.arctan(2.0 * bapat_1983.mu(R) / pi)
    start = np.array([theta, cos(theta) / bapat_1983.mu(R)])
    assert cross(R, bapat_1983.longest(R), start) == pytest.approx(start, abs=1e-9)
    found = multipliers(lambda z: cross(R, bapat_1983.longest(R), z), start)
    assert np.min(np.abs(found - 1.0)) < 1e-5


@pytest.mark.parametrize("a", [3.35, 3.6])
def test_the_multiplier_of_the_inelastic_ball_without_rest(a: float) -> None:
    theta = np.arccos(pi / a)
    assert bounce(0.0, a, np.array([theta, pi]))[0] == pytest.approx(theta + 2.0 * pi, abs=1e-9)
    found = multipliers(lambda z: bounce(0.0, a, np.array([z[0], a * cos(z[0])]))[:1], np.array([theta]))
    assert found == pytest.approx([1.0 - sqrt(a**2 - pi**2)], abs=1e-6)


@pytest.mark.parametrize("a", [1.3, 3.1])
def test_the_inelastic_ball_is_above_the_table_during_its_flight_and_on_it_at_its_end(a: float) -> None:
    leave, end = np.arcsin(1.0 / a), mehta_luck_1990.flight(a)
    t = np.linspace(0.01, 1.0, 1000) * end
    height = a * sin(leave) + a * cos(leave) * t - 0.5 * t**2 - a * np.sin(leave + t)
    assert np.all(height[:-1] > 0.0)
    assert abs(height[-1]) < 1e-12


# Friction


def half_slide(zeta: float, A: float, omega: float, X: float, psi: float) -> Array:
    """(x, x') half a period after a turning point X at which the force is A cos(psi), sliding backwards."""
    run = solve_ivp(
        lambda t, z: [z[1], A * cos(omega * t + psi) + 1.0 - 2.0 * zeta * z[1] - z[0]],
        (0.0, pi / omega), [X, 0.0], method="DOP853", rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    return np.asarray(run.y[:, -1])


def turning_point(zeta: float, A: float, omega: float, near: float) -> tuple[float, float]:
    """The turning point of the motion that slides all the time, and the force there, by shooting."""

    def mismatch(z: Array) -> Array:
        return half_slide(zeta, A, omega, *z) + np.array([z[0], 0.0])

    found = [fsolve(mismatch, [near, psi], xtol=1e-13) for psi in np.arange(0.0, 6.0, 1.0)]
    X, psi = min(found, key=lambda z: (np.abs(mismatch(z)).max() > 1e-9, abs(z[0] - near)))
    assert np.abs(mismatch(np.array([X, psi]))).max() < 1e-9
    return float(X), A * cos(psi)


@pytest.mark.parametrize("omega", [0.9, *shaw_1986.onsets()])
def test_the_amplitude_with_friction_and_damping_and_the_force_at_its_turning_point(omega: float) -> None:
    X, excess = shaw_1986.turning(omega)
    found, force = turning_point(shaw_1986.ZETA, shaw_1986.A, omega, X)
    assert found == pytest.approx(X, abs=1e-9)
    assert force - found + shaw_1986.S == pytest.approx(excess, abs=1e-8)


@pytest.mark.parametrize("omega", [0.6, 1.3])
def test_the_amplitude_of_den_hartog(omega: float) -> None:
    A = 1.5 * den_hartog_1931.least_force(omega)
    X = den_hartog_1931.amplitude(omega, A)
    assert turning_point(0.0, A, omega, X)[0] == pytest.approx(X, abs=1e-9)


@pytest.mark.parametrize(("r", "u"), popp_stelter_1990.CASES)
def test_the_cycle_on_the_belt(r: float, u: float) -> None:
    def same(t: float, z: Array) -> float:
        return z[1] - u

    same.terminal, same.direction = True, 1.0  # type: ignore[attr-defined]
    run = solve_ivp(lambda t, z: [z[1], r - z[0]], (0.0, 10.0), [1.0, u], rtol=1e-12, atol=1e-13, events=same)
    assert run.y[0, -1] == pytest.approx(2.0 * r - 1.0, abs=1e-9)
    assert run.t[-1] + (1.0 - run.y[0, -1]) / u == pytest.approx(popp_stelter_1990.cycle(r, u), abs=1e-9)


# Soft stop, impact damper, two masses


@pytest.mark.parametrize("a", ing_2008.AMPLITUDES)
def test_the_motion_without_contact_reaches_the_stop_at_the_grazes(a: float) -> None:
    for omega in ing_2008.grazes(a):
        response = a * omega**2 / abs(1.0 - omega**2 + 2j * ing_2008.ZETA * omega)
        assert response == pytest.approx(ing_2008.E, rel=1e-12)


def half_turn_of_damper(omega: float, A: float, z: Array) -> Array:
    """(phase of the forced response, x1, v1, v2) after an upper impact to the same after the lower one, mirrored."""
    phase, x1, v1, v2 = z
    mu, zeta, R = masri_caughey_1966.MU, masri_caughey_1966.ZETA, masri_caughey_1966.R
    F = A / hypot(1.0 - omega**2, 2.0 * zeta * omega)

    def rate(t: float, y: Array) -> list[float]:
        angle = phase + omega * t
        force = F * ((1.0 - omega**2) * sin(angle) + 2.0 * zeta * omega * cos(angle))
        return [y[2], y[3], force - 2.0 * zeta * y[2] - y[0], 0.0]

    def wall(t: float, y: Array) -> float:
        return y[1] - y[0] + 1.0

    wall.terminal, wall.direction = True, -1.0  # type: ignore[attr-defined]
    run = solve_ivp(rate, (0.0, 20.0), [x1, x1 + 1.0, v1, v2], "DOP853", rtol=1e-12, atol=1e-13, events=wall)
    x1, _, v1, v2 = run.y[:, -1]
    change = (1.0 + R) * (v2 - v1) / (1.0 + mu)
    return np.array([phase + omega * run.t[-1] - pi, -x1, -(v1 + mu * change), -(v2 - change)])


@pytest.mark.parametrize("omega", [1.0, 1.01])
def test_the_impact_damper_breaks_its_symmetry_and_flutters_where_the_closed_form_says(omega: float) -> None:
    mu = masri_caughey_1966.MU
    for A, at in ((masri_caughey_1966.breaking(omega), -1.0), (masri_caughey_1966.flutter(omega), None)):
        U, sine, cosine = masri_caughey_1966.orbit(omega, A)
        x1 = U * pi / (2.0 * omega) - 1.0
        v1 = (1.0 + 2.0 * mu) * U - masri_caughey_1966.speed(omega, A)
        start = np.array([atan2(sine, cosine), x1, v1, -U])
        assert half_turn_of_damper(omega, A, start) == pytest.approx(start, abs=1e-8)
        found = multipliers(lambda z, A=A: half_turn_of_damper(omega, A, z), start)
        if at is None:
            assert np.max(np.abs(found)) == pytest.approx(1.0, abs=1e-5)
        else:
            assert np.min(np.abs(found - at)) < 1e-5


def test_the_exponents_of_fig_3_are_those_of_multiprecision_arithmetic() -> None:
    (orbit,) = (solution for solution in symmetric_orbit(naive.FIGURES[3]) if solution.exponents[0] < 0)
    assert [float(exponent) for exponent in orbit.exponents] == pytest.approx(li_tan_2011.FIG_3, abs=1e-14)


def test_the_symmetric_orbit_of_fig_6_has_a_multiplier_one_where_it_breaks_its_symmetry() -> None:
    omega = next(statement["reference"] for statement in BY_STORED["li-tan-2011-fig6"]["statements"])
    with mp.workdps(40):
        near = [
            min(abs(value - 1) for value in orbit.multipliers)
            for orbit in symmetric_orbit(naive.FIGURES[3] | {"omega": omega, "b": 0.15})
        ]
        assert min(near) < 1e-10


def test_hertz_impact_is_that_of_an_integration() -> None:
    """A unit mass alone on k d^1.5, from the contact on until it leaves it again."""
    k, v = 30.0, 0.7

    def left(t: float, z: Array) -> float:
        return z[0] if t > 0.0 else 1.0

    left.terminal = True  # type: ignore[attr-defined]
    law = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "events": left, "max_step": 1e-2}
    run = solve_ivp(lambda _, z: [z[1], -k * max(0.0, z[0]) ** 1.5], (0.0, 5.0), [0.0, v], **law)
    deepest = solve_ivp(lambda _, z: [z[1], -k * max(0.0, z[0]) ** 1.5], (0.0, 0.5 * run.t[-1]), [0.0, v], **law).y[
        0, -1
    ]
    assert deepest == pytest.approx(hertz_1882.depth(k, v), rel=1e-9)
    assert run.t[-1] == pytest.approx(hertz_1882.TIME * hertz_1882.depth(k, v) / v, rel=1e-6)


@pytest.mark.parametrize(("R", "n", "a"), [(0.5, 1, 1.3), (0.9, 2, 0.7)])
def test_the_ball_bounces_at_the_phase_of_the_closed_form(R: float, n: int, a: float) -> None:
    """The flight from that phase on, by the parabola and the table: it lands at the same phase with the same speed."""
    phase = holmes_phase_1982.phase(R, n, a)
    after = R * holmes_1982.speed(R, n) + a * cos(phase)  # speed in space; the table moves at a cos(phase)

    def height(t: float) -> float:
        return after * t - 0.5 * t**2 - a * (sin(phase + t) - sin(phase))

    T = 2.0 * pi * n
    assert all(height(t) > 0.0 for t in np.linspace(0.01, T - 0.01, 400))
    assert height(T) == pytest.approx(0.0, abs=1e-12)
    assert a * cos(phase) - (after - T) == pytest.approx(holmes_1982.speed(R, n), rel=1e-12)
