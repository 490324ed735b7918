"""The benchmark of rules for watching chaos: what it counts, by lifetimes that are written by hand."""

from multiprocessing.pool import ThreadPool

import numpy as np
import pytest

from scripts.bench_survival import plane
from scripts.bench_watching import (
    COSTS_HEAD,
    NOISE_HEAD,
    PLANES,
    RIVALS_HEAD,
    RULES,
    RULES_HEAD,
    SURVIVAL,
    Lifetimes,
    costs,
    noises,
    rivals,
    rules,
)


def lifetimes(relaxation: list[float], settles: list[float]) -> Lifetimes:
    """Cells that are called chaotic after 1000 periods, of which they have looked so for 700."""
    life, count = Lifetimes.__new__(Lifetimes), len(settles)
    life.params = {"omega": np.ones(count), "b": np.ones(count)}
    life.relaxation, life.settles = np.array(relaxation), np.array(settles)
    life.used, life.survived, life.exponent = np.full(count, 1000.0), np.full(count, 700), np.full(count, 0.5)
    return life


def test_a_motion_is_seen_to_settle_up_to_the_verdict_and_missed_after_it() -> None:
    """Watched for a tenth, 4800 periods of which 700 are those of the averages: the verdict comes after 5100."""
    life = lifetimes([1.0] * 4, [5000.0, 5200.0, 85_000.0, 85_200.0])
    assert life.watched(np.full(4, 0.1)).tolist() == [0.1 * SURVIVAL - 700] * 4
    assert life.seen_and_missed(np.full(4, 0.1)) == (1, 2)


def test_what_is_not_watched_is_missed() -> None:
    assert lifetimes([9.0, 9.0], [2000.0, np.inf]).seen_and_missed(np.zeros(2)) == (0, 1)


def test_every_rule_asks_for_a_part_of_survival_and_all_but_none_see_what_settles_at_once() -> None:
    life = lifetimes([0.1, 1.0, 3.0, 10.0, 100.0], [1010.0] * 5)
    for name, rule in RULES.items():
        part = rule(life)
        assert np.all((part >= 0.0) & (part <= 1.0))
        assert life.seen_and_missed(part)[0] == (0 if name == "none" else 5)


def test_a_rule_that_misses_less_watches_for_longer_in_the_table() -> None:
    rows = rules([lifetimes([1.0, 2.0, 3.0, 4.0], [3000.0, 6000.0, 9000.0, np.inf])])
    assert all(len(row) == len(RULES_HEAD) for row in rows)
    whole, none, half = rows[:3]
    assert [row[0] for row in (none, half)] == ["none", "half of the solver's"]
    periods = [int(row[1].replace(",", "")) for row in (none, half, whole)]
    missed = [int(row[3]) for row in (none, half, whole)]
    assert periods == sorted(periods)
    assert missed == sorted(missed, reverse=True)


@pytest.mark.slow
def test_rivals_are_counted_among_motions_that_settle_and_among_others() -> None:
    """Every cell of a corner of the plane without chaos settles from any start."""
    corner = {"omega": np.linspace(4.2, 4.5, 6), "b": np.linspace(0.05, 0.1, 6)}
    life = lifetimes([1.0] * 6, [2000.0, 3000.0, *[np.inf] * 4])
    life.params = corner
    with ThreadPool(1) as pool:
        rows = rivals(pool, [life] * len(PLANES))
    assert [row[1:] for row in rows] == [["2 of 2", "4 of 4"] * 2] * len(PLANES)
    assert len(rows[0]) == len(RIVALS_HEAD)


@pytest.mark.slow
def test_motions_without_noise_settle_as_the_solver_has_them_settle() -> None:
    """And those that noise moves settle too: orbits attract what is disturbed."""
    with ThreadPool(1) as pool:
        rows = noises(pool, {name: np.asarray(values)[::60] for name, values in plane(PLANES[0], 20).items()})
    assert all(len(row) == len(NOISE_HEAD) for row in rows)
    assert [row[0] for row in rows][:2] == ["0", "1e-15"]
    assert len({row[1] for row in rows[:3]}) == 1


@pytest.mark.slow
def test_the_stages_of_a_plane_add_up_to_its_periods() -> None:
    rows = costs(plane(PLANES[0], 12))
    assert all(len(row) == len(COSTS_HEAD) for row in rows)
    periods = {row[0]: int(row[1].replace(",", "")) for row in rows if row[1]}
    assert sum(periods.values()) == pytest.approx(2 * periods["all"], abs=3)
    assert periods["watching"] > periods["searching"] > 0
    shares = {row[0]: int(row[2]) for row in rows}
    assert shares.pop("all") == 100
    assert 50 < sum(shares.values()) <= 102
