"""What several test files share: one in-process Dask client, a small plane, and its store."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Client

import atlas
from tests.planes import plane_of


@pytest.fixture(scope="session")
def client() -> Iterator[Client]:
    """Two threads of this process as a cluster."""
    with Client(
        processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0", set_as_default=False
    ) as made:
        yield made


@pytest.fixture(scope="session")
def solved_plane(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    """The store of ``plane`` after a run, only to be read."""
    path = tmp_path_factory.mktemp("plane") / "out.zarr"
    atlas.run(plane_of(), path, client=client)
    return path


@pytest.fixture
def finished(solved_plane: Path, tmp_path: Path) -> Path:
    """The store of ``plane`` after a run, of its own for each test: out.zarr in ``tmp_path``."""
    return Path(shutil.copytree(solved_plane, tmp_path / "out.zarr"))


@pytest.fixture
def plane() -> atlas.Spec:
    """7 x 5 cells in tiles of 3 x 2, cheap to solve."""
    return plane_of()
