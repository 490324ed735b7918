"""Labelling the basins of a plane: what it takes of a worker's memory, and who gets to do it."""

import shutil
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from distributed import Client, LocalCluster

import atlas
from atlas.errors import RunError
from atlas.service import run as running
from atlas.store.create import create_store
from atlas.store.store import AtlasStore
from atlas.store.tiles import read_tile, write_tile
from atlas.task import label_basins
from atlas.task.label_basins import complete_basins, labelling_bytes
from workers.attractors import basins as solving
from workers.results import BEYOND_TABLE, empty_results

SIDE, LABELS = 32, 100


def spec_of(rows: int, columns: int = SIDE) -> atlas.Spec:
    axes = {
        "x1": {"start": -0.09, "stop": 0.09, "num": columns},
        "v1": {"start": -1.0, "stop": 1.0, "num": rows},
    }
    return atlas.Spec("two-mass", axes, {"omega": 4.0, "b": 0.1}, attractors={"starts": 1})


def beyond(path: Path, rows: int, columns: int = SIDE) -> AtlasStore:
    """A plane whose every cell is on an attractor that the table has not; its x1 is the cell's place in the plane."""
    handle = create_store(path, spec_of(rows, columns), (SIDE, SIDE))
    for tile in handle.tiling.tiles():
        arrays = empty_results(handle.spec.variables, tile.shape, handle.spec.extra_sizes)
        arrays["label"][...], arrays["regime"][...] = BEYOND_TABLE, 1
        i, j = np.mgrid[tile.slices]
        arrays["state"][..., 0] = i * columns + j
        write_tile(handle, tile.index, arrays)
    return handle


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """The places in the plane of what is labelled, in turn; each gets the rest of its place by LABELS as its label."""
    states_of: list[np.ndarray] = []

    def labels_beyond(table: Any, states: np.ndarray) -> np.ndarray:
        states_of.append(states[:, 0].copy())
        return states[:, 0].astype(np.int64) % LABELS

    monkeypatch.setattr(solving, "labels_beyond", labels_beyond)
    monkeypatch.setattr(solving, "AttractorTable", lambda *_: SimpleNamespace(attractors=[]))
    monkeypatch.setattr(label_basins, "_columns", lambda *_: {})
    monkeypatch.setattr(label_basins, "write_table", lambda *_: None)
    return states_of


def peak(handle: AtlasStore) -> int:
    tracemalloc.start()
    try:
        complete_basins(handle)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_the_memory_of_labelling_does_not_grow_with_the_height_of_the_plane(tmp_path: Path, asked: object) -> None:
    """Truth: labels, masks and states of a whole plane took 70 bytes a cell of one worker."""
    peak(beyond(tmp_path / "first.zarr", SIDE))  # what is loaded once
    low, high = (peak(beyond(tmp_path / f"{tiles}.zarr", tiles * SIDE)) for tiles in (2, 24))
    assert (high - low) / (22 * SIDE**2) < 16  # bytes a cell, of which this test keeps 8


def test_cells_are_labelled_in_the_order_of_the_plane_whatever_the_tiles(
    tmp_path: Path, asked: list[np.ndarray]
) -> None:
    handle = beyond(tmp_path / "out.zarr", 3 * SIDE, 2 * SIDE + 5)
    complete_basins(handle)
    np.testing.assert_array_equal(np.concatenate(asked), np.arange(3 * SIDE * (2 * SIDE + 5)))
    for tile in handle.tiling.tiles():
        stored = read_tile(handle, tile.index, ["label", "state"])
        np.testing.assert_array_equal(stored["label"], stored["state"][..., 0] % LABELS)


def test_the_memory_that_labelling_asks_for_is_that_of_a_band_of_tiles(tmp_path: Path, asked: object) -> None:
    handle = beyond(tmp_path / "out.zarr", 2 * SIDE, 8 * SIDE)
    needed = labelling_bytes(handle)
    assert needed == 8 * SIDE**2 * (2 * 8 * 4 + label_basins.BYTES_OF_LABEL)
    assert needed == labelling_bytes(create_store(tmp_path / "higher.zarr", spec_of(9 * SIDE, 8 * SIDE), (SIDE, SIDE)))
    one_tile = peak(beyond(tmp_path / "one.zarr", SIDE))
    assert peak(handle) - one_tile < needed


@pytest.mark.slow
def test_a_worker_with_too_little_memory_does_not_label_and_is_named(
    tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "out.zarr"
    atlas.run(spec_of(2, 2), store, client=client)
    shutil.rmtree(store / "attractors")
    monkeypatch.setattr(running, "labelling_bytes", lambda handle: 10**13)
    with (
        LocalCluster(
            processes=False, n_workers=1, threads_per_worker=1, memory_limit="4GB", dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster, set_as_default=False) as small,
        pytest.raises(
            RunError, match=r"memory limit 4 GB is below the required 10 TB; raise it with: dask worker --memory-limit"
        ),
    ):
        atlas.run(spec_of(2, 2), store, client=small)
