"""What several test files share: one in-process Dask client, and a small plane."""

from collections.abc import Iterator

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


@pytest.fixture
def plane() -> atlas.Spec:
    """7 x 5 cells in tiles of 3 x 2, cheap to solve."""
    return plane_of()
