"""Claims about the attractors of machines without a force: cycles and equilibria, whatever the phase of a motion.

Truth: closed forms of a block on a belt, and shares that bSTAB (doi 10.1007/s11071-021-06786-5, Nonlinear Dyn. 2021)
finds for a belt whose friction decays exponentially, of 5000 random initial states in [-2, 2] x [0, 2] each.
"""

import math
from typing import Any

import numpy as np
import pytest

from tests.unforced import machine, pair_of, random_pair
from workers import Settings, System, solve_tile
from workers.attractors.basins import AttractorTable, section_points, solve_basins
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.results import CENTRE, NO_IMPACT, PERIODIC, REASONS, UNDETERMINED

SETTINGS = Settings(exponents="spectrum", max_periods=1000, survival=500)
ROUND = AttractorSettings(64, box=(("x", -2.0, 2.0), ("v", 0.0, 2.0)))


def belt(c: float = 0.1, speed: float = 0.5) -> System:
    """x'' + c x' + x + friction = 0 on a belt, kinetic .4 and static 1."""
    friction = {"name": "belt", "row": [1.0], "kinetic": 0.4, "static": 1.0, "belt": speed}
    return machine(damping=[[c]], friction=[friction])


def decaying() -> System:
    """Friction .5 + .5 e^(-2 |v_r|) in segments, damping ratio .05."""
    law = {"law": "0.5 + 0.5 * exp(-2 * v)", "within": 1e-3, "range": 6.0}
    friction = {"name": "belt", "row": [1.0], "belt": "u"} | law
    return machine(damping=[[0.1]], friction=[friction], parameters={"u": 1.5})


@pytest.mark.parametrize(("u", "share", "error"), [(1.325, 0.1478, 0.005), (1.5, 0.312, 0.007), (1.7, 0.4922, 0.0071)])
def test_the_equilibrium_of_a_belt_has_the_share_of_bstab_within_both_errors(
    u: float, share: float, error: float
) -> None:
    many = AttractorSettings(400, box=ROUND.box)
    found = solve_attractors(decaying(), {"u": u}, SETTINGS, many)
    (still,) = np.flatnonzero(found["regime"] == NO_IMPACT)
    (cycle,) = np.flatnonzero(found["regime"] == PERIODIC)
    assert found["starts"] == 400 and found["undecided"] == 0
    assert abs(found["share"][still] - share) < 2.0 * math.hypot(error, float(found["share_error"][still]))
    assert found["share"][cycle] == pytest.approx(1.0 - found["share"][still])
    assert found["share_low"][still] < share < found["share_high"][still]


@pytest.mark.parametrize("u", [0.8, 1.925])
def test_beside_the_values_where_both_attract_bstab_and_we_find_one_attractor(u: float) -> None:
    found = solve_attractors(decaying(), {"u": u}, SETTINGS, ROUND)
    assert (found["attractors"], found["share"][0]) == (1, 1.0)
    assert found["regime"][0] == (PERIODIC if u < 1.0 else NO_IMPACT)


def reaches_belt(x: Any, v: Any, c: float, speed: float) -> Any:
    """Whether a block that slides from (x, v), slower than the belt, comes to the speed of the belt: else it spirals
    into x = .4. x'' + c x' + x = .4 in closed form, over a turn: each further one is smaller."""
    w, t = math.sqrt(1.0 - 0.25 * c * c), np.linspace(0.0, 2.1 * math.pi, 20001)
    y, eta = np.asarray(x) - 0.4, 0.5 * c
    decay, sine = np.exp(-eta * t), np.sin(w * t)
    most = [np.max(decay * (b * np.cos(w * t) - (eta * b + a) / w * sine)) for a, b in zip(y, v, strict=True)]
    return np.array(most) - speed


def test_the_basin_of_sliding_is_where_the_closed_form_never_reaches_the_belt() -> None:
    c, speed = 0.1, 0.5
    x, v = (values.ravel() for values in np.meshgrid(np.linspace(-0.55, 1.35, 24), np.linspace(-0.95, 0.45, 20)))
    beyond = reaches_belt(x, v, c, speed)
    found = solve_basins(belt(c, speed), {"x": x, "v": v}, SETTINGS, AttractorSettings(32))
    sure = np.abs(beyond) > 1e-4
    assert np.array_equal(found["regime"][sure], np.where(beyond > 0.0, PERIODIC, NO_IMPACT)[sure])
    assert 0.2 < np.mean(found["regime"] == NO_IMPACT) < 0.8
    assert len(set(found["label"].tolist())) == 2
    for regime in (PERIODIC, NO_IMPACT):
        assert len(set(found["label"][found["regime"] == regime].tolist())) == 1
    assert found["settled"].min() >= 0


def test_a_block_without_damping_sticks_and_slips_or_swings_about_its_centre() -> None:
    """B1 is the only attractor: within v of x = .4 the block slides for ever, in a continuum of circles."""
    speed = 0.2
    system = belt(0.0, speed)
    starts = AttractorSettings(200, box=(("x", 0.1, 0.7), ("v", -0.4, 0.15)))
    found = solve_attractors(system, {}, SETTINGS, starts)
    T = 2.0 * 0.6 / speed + math.pi + 2.0 * math.atan(speed / 0.6)
    assert (found["attractors"], found["regime"][0]) == (1, PERIODIC)
    assert found["cycle_period"][0] == pytest.approx(9.78509376238307763, rel=1e-13) == T
    assert found["belt_stuck"][0] == pytest.approx(0.61317756842206796, rel=1e-12)
    in_circle = math.pi * speed**2 / 2.0 + speed * 0.15 * math.sqrt(1.0 - 0.75**2) + speed**2 * math.asin(0.75)
    assert found["undecided"] / 200 == pytest.approx(in_circle / (0.6 * 0.55), abs=0.05)


def test_a_centre_is_told_after_one_stretch() -> None:
    found = solve_tile(belt(0.0, 0.2), {"x": 0.45}, Settings())
    assert (found["regime"], found["reason"]) == (UNDETERMINED, CENTRE)
    assert found["periods_used"] < 200
    assert "centre" in REASONS[CENTRE].text
    loaded = machine(load=[0.3], gap=[1.0], upper=1.0, restitution=0.8)
    assert solve_tile(loaded, {"x": 0.5}, Settings())["reason"] == CENTRE


def test_phases_do_not_count_and_no_state_of_a_cycle_is_another_attractor() -> None:
    """Initial states all along one cycle reach it."""
    table = AttractorTable(belt(), {p.name: p.default for p in belt().parameters}, SETTINGS, AttractorSettings(16))
    (cycle,) = (k for k, attractor in enumerate(table.attractors) if attractor.cycle)
    points = section_points(table, 40)[cycle]
    found = solve_basins(belt(), {"x": points[:, 0], "v": points[:, 1]}, SETTINGS, AttractorSettings(16))
    assert found["label"].tolist() == [cycle] * 40
    assert np.ptp(points[:, 0]) > 1.0
    assert np.ptp(found["cycle_period"]) == 0.0


def test_the_attractor_of_the_own_initial_state_is_that_of_solve_tile_to_the_bit() -> None:
    for x in (0.45, 1.6):
        alone = solve_tile(belt(), {"x": x}, SETTINGS)
        many = solve_attractors(belt(), {"x": x}, SETTINGS, AttractorSettings(8))
        for name, value in alone.items():
            if name != "periods_used":
                np.testing.assert_array_equal(many[name][many["own_attractor"]], value, err_msg=name)


def test_a_cell_does_not_depend_on_its_neighbours() -> None:
    together = solve_attractors(decaying(), {"u": [1.4, 1.6, 1.9]}, SETTINGS, ROUND)
    alone = solve_attractors(decaying(), {"u": 1.6}, SETTINGS, ROUND)
    for name, value in alone.items():
        np.testing.assert_array_equal(together[name][1], value, err_msg=name)


def buckled(**more: Any) -> System:
    """Two wells: x'' + c x' - x and a law of the spring that holds it, symmetric, with equilibria at +-1."""
    law = [[-3.0, -7.0], [-0.5, 0.0], [0.5, 0.0], [3.0, 7.0]]
    return machine(stiffness=[[-1.0]], springs=[{"name": "frame", "row": [1.0], "law": law}], **more)


def test_equilibria_that_are_mirror_images_are_two_attractors() -> None:
    """-x + 2.8 (x - .5) = 0: x = 1.4 / 1.8, with the rates of x'' + .2 x' + 1.8 x = 0."""
    found = solve_attractors(buckled(damping=[[0.2]]), {"x": 0.3}, SETTINGS, AttractorSettings(32))
    assert found["attractors"] == 2
    assert sorted(found["state"][:2, 0].tolist()) == pytest.approx([-1.4 / 1.8, 1.4 / 1.8], abs=1e-9)
    np.testing.assert_allclose(found["spectrum"][:2], -0.1, rtol=1e-9)


def two_wells() -> System:
    """Negative damping in a double well that soft walls with damping bound: x in each of the wells has a cycle."""
    walls = {"name": "walls", "gap": [1.0], "upper": 1.0, "lower": -1.0, "stiffness": 5.0, "damping": 2.0}
    return buckled(damping=[[-0.05]], contacts=[walls])


def test_cycles_that_are_mirror_images_are_two_attractors() -> None:
    found = solve_attractors(two_wells(), {"x": 0.7}, SETTINGS, AttractorSettings(32))
    cycles = np.flatnonzero(found["regime"] == PERIODIC)
    one_sided = [k for k in cycles.tolist() if not found["symmetric"][k]]
    assert len(one_sided) == 2
    a, b = one_sided
    assert found["cycle_period"][a] == pytest.approx(found["cycle_period"][b], rel=1e-10)


@pytest.mark.parametrize("seed", [103, 105, 112, 115, 121, 123])
def test_a_cycle_is_told_once_round_from_wherever_it_is_reached(seed: int) -> None:
    """No two cycles have lengths in a whole ratio: motions that return after two or three turns are on the same one."""
    found = solve_attractors(
        pair_of(*random_pair(seed)), {}, Settings(exponents="none", max_periods=500, survival=0), AttractorSettings(8)
    )
    T = found["cycle_period"][: int(found["attractors"])]
    ratios = T[:, None] / T
    assert np.all((np.abs(ratios - np.round(ratios)) > 1e-6) | np.eye(len(T), dtype=bool))
