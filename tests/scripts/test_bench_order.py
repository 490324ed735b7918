"""The simulated cluster of the benchmark of orders adds up, and its tables come out."""

from pathlib import Path

import numpy as np
import pytest
from distributed import Client

import atlas
from scripts.bench_order import SIDES, efficiencies, main, simulate, tile_costs
from tests.planes import plane_of

pytestmark = pytest.mark.slow


def test_each_size_of_tiles_has_its_row(tmp_path: Path, client: Client, capsys: pytest.CaptureFixture[str]) -> None:
    atlas.run(plane_of(), tmp_path / "out.zarr", client=client)
    assert main([str(tmp_path / "out.zarr"), "--workers", "4"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2 + len(SIDES)


def test_simulated_workers_share_equal_tiles_evenly() -> None:
    assert simulate(np.ones((6, 4)), np.ndindex(6, 4), workers=8) == 3.0


def test_a_costly_tile_begun_last_keeps_the_others_waiting() -> None:
    costs = np.array([1.0] * 9 + [9.0])
    assert simulate(costs, np.ndindex(10), workers=2) == 4 + 9
    assert simulate(costs, reversed(list(np.ndindex(10))), workers=2) == 9


def test_tiles_cost_what_their_cells_cost() -> None:
    cells = np.arange(35.0).reshape(5, 7)
    costs = tile_costs(cells, 3)
    assert costs.shape == (2, 3)
    assert costs.sum() == cells.sum()
    assert costs[1, 2] == cells[3:, 6:].sum()


def test_the_lattice_does_better_than_rows_where_the_last_rows_are_costly() -> None:
    y, x = np.mgrid[:128, :128]
    cells = 1 + 30 * np.exp(-((y - 127) ** 2 + (x - 20) ** 2) / 450)
    shares = efficiencies(cells, side=4, workers=64)
    assert shares["lattice"] > shares["rows"] + 0.2
    assert max(shares.values()) <= shares["bound"] <= 1
