"""The budget of what explorers keep in a store."""

from inspect import signature
from pathlib import Path

import pytest

from atlas.cli.explore import GB, explore
from atlas.explore.kept import MOST_BYTES
from atlas.explore.session import explore as session
from atlas.store.store import Header, create
from atlas.store.zoom import FILE_BLOCK, ZOOM, sheet_bytes
from tests.synthetic import spec_of


@pytest.fixture
def header(tmp_path: Path) -> Header:
    return create(tmp_path / "a.zarr", spec_of(), (19, 45))


def test_each_file_counts_as_a_whole_block_so_that_the_budget_bounds_files_too(header: Header) -> None:
    """A tile takes about twenty files, and a screen of cells a thousand tiles."""
    sheet = header.path / ZOOM / "plane" / "sheet"
    sheet.mkdir(parents=True)
    for k, size in enumerate((1, 100, FILE_BLOCK, FILE_BLOCK + 1)):
        (sheet / str(k)).write_bytes(b"0" * size)
    assert sheet_bytes(header, "plane", "sheet") == 5 * FILE_BLOCK
    assert MOST_BYTES / FILE_BLOCK < 65_000


def test_the_command_and_python_have_the_same_budget() -> None:
    (limit,) = [each.default for each in explore.params if each.name == "limit"]
    assert limit * GB == signature(session).parameters["most_bytes"].default == MOST_BYTES
