"""Kill -9 of workers, scheduler and coordinator, drawn at random; scripts/kill_test.py has the long mode."""

from collections import Counter
from dataclasses import replace

import pytest

from scripts.kill_test import Report, kill_test

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return kill_test(tmp_path_factory.mktemp("kills"), kills=5, seed=1)


def test_five_kills_happened_to_more_than_one_kind_of_process(report: Report) -> None:
    assert report.kills.total() == 5
    assert len(report.kills) >= 2


def test_killed_runs_end_with_the_arrays_of_an_undisturbed_one(report: Report) -> None:
    assert report.tiles == 25
    assert report.different == ()


def test_no_more_is_solved_again_than_what_was_under_way(report: Report) -> None:
    assert report.again <= report.bound


def test_a_report_of_loss_or_waste_does_not_pass() -> None:
    good = Report(tiles=4, kills=Counter(worker=1), again=1, bound=1, different=(), seconds=1.0)
    assert good.passed
    assert not replace(good, different=("regime",)).passed
    assert not replace(good, again=2).passed
