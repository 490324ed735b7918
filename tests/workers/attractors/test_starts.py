"""Claims about the initial states from which attractors are sought, and about the shares that counting them gives."""

import numpy as np
import pytest
from scipy.stats import binomtest

from workers.attractors.initial_states import REACH, AttractorSettings, boxes, initial_states, unseen_share, wilson
from workers.model.system import find_system

TWO_MASS = find_system("two-mass")


def oscillators(**changes: float):
    values = {p.name: np.array([changes.get(p.name, p.default)]) for p in TWO_MASS.parameters}
    return TWO_MASS.build_many(values)[0]


def states_of(starts: AttractorSettings, **changes: float) -> np.ndarray:
    return initial_states(starts, oscillators(**changes), TWO_MASS, np.zeros((1, 4)))[0]


@pytest.mark.parametrize(("hits", "count"), [(0, 32), (1, 7), (16, 32), (64, 64)])
def test_wilson_intervals_are_those_of_scipy(hits: int, count: int) -> None:
    expected = binomtest(hits, count).proportion_ci(0.95, method="wilson")
    assert wilson(hits, count) == pytest.approx((expected.low, expected.high), abs=1e-12)


@pytest.mark.parametrize("count", [1, 16, 32])
def test_an_attractor_of_the_unseen_share_is_missed_by_one_cell_in_twenty(count: int) -> None:
    assert (1.0 - unseen_share(count)) ** count == pytest.approx(0.05)


@pytest.mark.parametrize("count", [1, 2, 3, 17, 32, 64])
def test_waves_take_every_initial_state_once_and_pause_where_a_cell_may_be_done(count: int) -> None:
    starts = AttractorSettings(count)
    waves = starts.waves()
    assert [k for wave in waves for k in wave] == list(range(count))
    assert len(waves[0]) == 1
    assert starts.enough in {wave.stop for wave in waves}


def test_the_own_initial_state_is_the_first_and_the_others_lie_in_the_box_between_the_stops() -> None:
    starts = AttractorSettings(33, box=(("x1", -0.05, 0.2), ("v2", 0.1, 0.3)))
    states = states_of(starts, b=0.1)
    assert np.all(states[0] == 0.0)
    rest = states[1:]
    assert np.all((rest[:, 0] >= -0.05) & (rest[:, 0] < 0.1))
    assert np.all((rest[:, 3] >= 0.1) & (rest[:, 3] <= 0.3))


def test_initial_states_lie_between_both_stops_of_two_masses_that_hit_each_other() -> None:
    """Their gap is a difference, so that no box of coordinates keeps them apart."""
    system = find_system("impact-damper")
    oscillators, _ = system.build_many({p.name: np.array([p.default]) for p in system.parameters})
    states = initial_states(AttractorSettings(65), oscillators, system, np.zeros((1, 4)))[0]
    y = states[:, :2] @ oscillators.gap_row[0]
    assert np.all((y > oscillators.lower) & (y < oscillators.upper))


def test_initial_states_are_the_same_to_the_bit_for_a_seed_and_others_for_another() -> None:
    assert np.array_equal(states_of(AttractorSettings(16, seed=3)), states_of(AttractorSettings(16, seed=3)))
    assert not np.any(states_of(AttractorSettings(16, seed=3))[1:] == states_of(AttractorSettings(16, seed=4))[1:])


def test_more_initial_states_begin_with_fewer() -> None:
    assert np.array_equal(states_of(AttractorSettings(64))[:16], states_of(AttractorSettings(16)))


def test_the_default_box_is_made_of_the_amplitudes_of_the_forced_answer() -> None:
    """Truth: the answer of M x'' + C x' + K x = F sin, where the gap is too narrow to count."""
    omega, b = 2.5, 1e-3
    M, K = np.diag([1.0, 2.0]), np.array([[1.0, -1.0], [-1.0, 6.0]])
    x = np.linalg.solve(K - omega**2 * M + 1j * omega * 0.1 * K, np.array([1.0, 0.0]))
    low, high = boxes(AttractorSettings(), oscillators(omega=omega, b=b), TWO_MASS)
    assert high[0, 0] == b  # between the stops
    assert high[0, 1:] == pytest.approx([REACH * abs(x[1]), *(REACH * omega * np.abs(x))])
    assert low == pytest.approx(-high)


def test_the_default_box_reaches_twice_as_far_as_a_wide_gap() -> None:
    _, high = boxes(AttractorSettings(), oscillators(omega=4.0, b=50.0), TWO_MASS)
    assert high[0, [0, 2]] == pytest.approx([50.0, REACH * 4.0 * 50.0])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"count": 0}, "starts: found 0, must be a whole number, 1 to 10000"),
        ({"seed": -1}, "seed: found -1"),
        ({"keep": 65}, "keep: found 65"),
        ({"box": (("x1", 1.0, 0.0),)}, "box.x1: found 1.0 to 0.0"),
    ],
)
def test_what_makes_no_starts_is_refused_in_one_line(changes: dict, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        AttractorSettings(**changes)
