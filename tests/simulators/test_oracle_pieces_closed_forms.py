"""The oracle of piecewise-linear machines against closed forms, one element or two at a time."""

import math

import numpy as np
import pytest

from tests.support.oracle.piecewise import (
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewiseMode,
    orbit,
    simulate,
)
from tests.support.oracle.piecewise.one_mass import oscillator, soft


@pytest.mark.parametrize("R", [0.0, 0.5])
def test_two_coupled_masses_pressed_on_each_other_and_on_a_stop_both_come_to_rest(R: float) -> None:
    """x1 <= 0 and x2 <= x1, both pushed by 1: each impact of one parts the other, and the speeds fall to rounding."""
    contacts = tuple(PiecewiseContact(row, 0.0, restitution=R) for row in ([1.0, 0.0], [-1.0, 1.0]))
    one = np.eye(2).tolist()
    machine = PiecewiseMachine(one, (0.1 * np.eye(2)).tolist(), one, [1.0, 1.0], 1.0, contacts=contacts)
    run = simulate(machine, [-0.5, -1.3, 0.0, 0.0], span=9.0, digits=30, rest=1e-8)
    assert run.modes[-1].contacts == ("held+", "held+")
    np.testing.assert_allclose(np.array(run.sections[-1], dtype=float), 0.0, atol=1e-20)


def test_chatter_with_friction_on_its_row_takes_the_time_of_its_geometric_series() -> None:
    """A mass pressed by a with friction F: hops shrink by r = R sqrt((a - F)/(a + F)).

    From a rebound w they last w (1/(a + F) + 1/sqrt(a^2 - F^2)) / (1 - r) in all.
    """
    a, F, R, w = 1.0, 0.3, 0.6, 0.5
    machine = PiecewiseMachine(
        [[1.0]], [[0.0]], [[0.0]], [a], 1.0,
        contacts=(PiecewiseContact([1.0], 0.0, restitution=R),), friction=(PiecewiseFriction([1.0], F, F),),
    )  # fmt: skip
    run = simulate(machine, [0.0, -w], span=3.0, digits=50, rest=1e-14)
    rest = next(event for event in run.events if event.kind == "rest")
    r = R * math.sqrt((a - F) / (a + F))
    assert float(rest.t) == pytest.approx(w * (1 / (a + F) + 1 / math.sqrt(a**2 - F**2)) / (1 - r), abs=1e-13)
    assert run.modes[-1] == PiecewiseMode(0, ("held+",), ("stick",))


def test_strong_friction_stops_a_mass_between_hops() -> None:
    machine = PiecewiseMachine(
        [[1.0]], [[0.0]], [[0.0]], [1.0], 1.0,
        contacts=(PiecewiseContact([1.0], 0.0, restitution=0.6),), friction=(PiecewiseFriction([1.0], 0.3, 1.1),),
    )  # fmt: skip
    run = simulate(machine, [0.0, -0.5], span=3.0)
    assert [event.kind for event in run.events] == ["stick"]
    assert float(run.events[0].value) == pytest.approx(-(0.5**2) / (2 * 1.3), abs=1e-15)


def test_hops_on_the_edge_of_a_preload_slow_down_by_the_damper() -> None:
    """Outer load a below the preload p: the speed of the hops falls as exp(-c a t / (3 p)), unit mass, small c."""
    a, p, c = 0.3, 1.0, 0.5
    machine = PiecewiseMachine(
        [[1.0]], [[0.0]], [[0.0]], [a], 1.0, contacts=(PiecewiseContact([1.0], 0.0, damping=c, preload=p),)
    )
    run = simulate(machine, [0.0, 0.02], span=20.0, digits=30, rest=1e-8)
    hits = [event for event in run.events if event.kind == "hit"]
    first, last = hits[0], hits[-1]
    rate = math.log(float(first.value / last.value)) / float(last.t - first.t)
    assert rate == pytest.approx(c * a / (3 * p), rel=0.01)


def test_the_order_of_impacts_decides_where_two_coupled_contacts_are_hit_at_once() -> None:
    """Rows (1, 0) and (-1, 1), unit masses, both hit at t = 1: (1, 0) first, as contacts come in order.

    With R = .8 and v = (1, 2): x1 rebounds to (-.8, 2), then the gap x2 - x1 closing at 2.8 turns into -2.24.
    """
    rows = ([1.0, 0.0], [-1.0, 1.0])
    machine = PiecewiseMachine(
        np.eye(2).tolist(), np.zeros((2, 2)).tolist(), np.zeros((2, 2)).tolist(), [0.0, 0.0], 1.0,
        contacts=tuple(PiecewiseContact(row, 0.0, restitution=0.8) for row in rows),
    )  # fmt: skip
    run = simulate(machine, [-1.0, -2.0, 1.0, 2.0], span=1.0 + 1e-3)
    assert [(event.index, float(event.value)) for event in run.events[:2]] == [
        (0, pytest.approx(1.0)),
        (1, pytest.approx(2.8)),
    ]


@pytest.mark.parametrize("depth", [1e-6, 1e-8])
def test_a_graze_of_a_damped_stop_that_releases_by_force_kicks_in_proportion_to_its_depth(depth: float) -> None:
    """A border collision: on the contact side the end differs from free flight by depth^1."""

    def end(d: float, c: float) -> float:
        stop = PiecewiseContact([1.0], 0.0, damping=c, stiffness=20.0, release="force")
        machine = PiecewiseMachine([[1.0]], [[0.0]], [[0.0]], [-1.0], 1.0, contacts=(stop,) if c else ())
        return float(simulate(machine, [-0.5 + d, 1.0], span=2.0, digits=40).sections[-1][1])

    c = 0.3
    kick = (end(depth, c) - end(depth, 0.0)) / depth
    assert kick == pytest.approx(-c, rel=100 * math.sqrt(depth))


@pytest.mark.slow
def test_at_the_onset_of_stick_with_higher_static_friction_the_multipliers_jump_though_the_stick_is_short() -> None:
    """x'' + .1 x' + x + sgn x' = 2 cos(omega t), static 1.2, about omega = .655453162351025, where |Lambda| rises.

    The stick begins with zero length and grows in proportion; the lost direction is there at once. No outside source.
    """
    lengths = []
    for off in (1e-6, 1e-5):
        machine = oscillator(0.655453162351025 * (1 - off), 2.0, friction=PiecewiseFriction([1.0], 1.0, 1.2))
        found = orbit(machine, [2.2959656, 1.5007525])
        stick, slip, *_ = found.run.events
        assert (stick.kind, slip.kind) == ("stick", "slip-")
        lengths.append(float(slip.t - stick.t))
        assert found.multipliers[0] == pytest.approx(0.06751, abs=1e-4)
        assert abs(found.multipliers[1]) < 1e-20
    assert lengths[1] / lengths[0] == pytest.approx(10.0, rel=1e-3)
    sliding = orbit(
        oscillator(0.655453162351025 * (1 + 1e-6), 2.0, friction=PiecewiseFriction([1.0], 1.0, 1.2)), [2.296, 1.5007]
    )
    assert sliding.multipliers[0] == pytest.approx(-0.05589 + 0.0067j, abs=1e-4)


def test_soft_and_rigid_contacts_close_to_each_other_agree_in_the_limit() -> None:
    """A spring of 1e8 without damper turns a mass as R = 1 does, up to the time of contact, pi / sqrt(k)."""
    hard = oscillator(0.95, 0.5, contact=PiecewiseContact([1.0], 0.3, stiffness=1e8))
    rigid = oscillator(0.95, 0.5, contact=PiecewiseContact([1.0], 0.3, restitution=1.0))
    ends = [np.array(simulate(m, [0.0, 0.5], digits=24).sections[-1], dtype=float) for m in (hard, rigid)]
    np.testing.assert_allclose(*ends, atol=5e-3)
    assert soft(1.0).contacts[0].restitution is None
