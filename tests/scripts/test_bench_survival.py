"""The benchmark of survival runs, and counts what it says. No time is asserted."""

from multiprocessing.pool import ThreadPool

import numpy as np
import pytest

from scripts.bench_error_bars import compared
from scripts.bench_relaxation import rows
from scripts.bench_survival import HEAD, PLANES, cells_of, measure, plane
from workers.attractors.starts import wilson

pytestmark = pytest.mark.slow


def test_more_watching_costs_more_and_leaves_no_more_wrong() -> None:
    with ThreadPool(1) as pool:
        rows = measure(pool, "omega-R, zeta .005", side=16, survivals=[0, 40_000], far=20_000, tolerance=0.05)
    least, most = rows
    assert least["cells"] == most["cells"] == 256
    assert least["wrong"] > most["wrong"]
    assert least["periods"] < most["periods"]
    assert len(cells_of(most, first=True)) == len(HEAD)


@pytest.mark.parametrize("name", PLANES)
def test_a_plane_has_so_many_different_cells(name: str) -> None:
    params = plane(name, 5)
    axes = [key for key, value in params.items() if np.size(value) > 1]
    assert len(axes) == 2
    assert len({tuple(params[key][k] for key in axes) for k in range(25)}) == 25  # type: ignore[index]


def test_the_interval_of_a_share_is_wilsons() -> None:
    """Of 10 in 100: 5.52 to 17.44 per cent (Brown, Cai & DasGupta 2001 give the formula)."""
    assert wilson(10, 100) == pytest.approx((0.0552, 0.1744), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_error_bars_are_held_against_longer_runs_from_the_same_start() -> None:
    with ThreadPool(1) as pool:
        cells, values = compared(pool, seed=3, wanted=4, tolerance=0.1)
    count = len(values["largest"])
    assert count == len(cells["omega"]) > 0
    assert np.all(values["again_error"][~values["settled"]] < values["error"][~values["settled"]])


def test_what_remembers_for_longer_is_watched_for_longer() -> None:
    with ThreadPool(1) as pool:
        table = list(rows(pool, cells=1500, seed=11, far=3000, survivals=[0, 20_000], tolerance=0.1))
    costs = [[int(cost.replace(",", "")) for cost in row[3::3] if cost] for row in table]
    extra = [watched - brief for brief, watched in (pair for pair in costs if len(pair) == 2)]
    assert len(extra) >= 4
    assert extra[0] < extra[1] < extra[2] < extra[3]
