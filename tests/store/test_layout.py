"""The metadata of a store as a function of the attributes of its root."""

import hashlib
from pathlib import Path

import xarray as xr
import zarr

from atlas.store.create import create_store
from atlas.store.record_format import TILES_PER_CHUNK
from atlas.store.schema import FORMAT_VERSION, layout, root_attributes
from atlas.store.store import open_store
from atlas.store.tile_records import TileRecords
from tests.planes import plane_of
from tests.synthetic import spec_of

DIGESTS = {3: "3667df1708507807"}
"""Digests of the layout of one spec by format version. If another one comes out of a version that was released, the
format version has to rise.
"""


def test_a_format_version_has_one_layout() -> None:
    spec = plane_of()
    told = ("source", "software", "solver_version")
    attributes = root_attributes(spec, (2, 3), None, run_id="0" * 32) | dict.fromkeys(told, "")
    digest = hashlib.sha256(repr(sorted(layout(attributes, spec).items())).encode()).hexdigest()
    assert digest[:16] == DIGESTS[FORMAT_VERSION]


def test_a_new_store_is_its_layout(tmp_path: Path) -> None:
    path = create_store(tmp_path / "plane.zarr", plane_of(), (2, 3)).path
    stored = {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}
    assert stored == open_store(path).layout


def test_zarr_and_xarray_read_what_the_layout_says(tmp_path: Path) -> None:
    handle = create_store(tmp_path / "plane.zarr", plane_of(), (2, 3))
    group = zarr.open_group(handle.path, mode="r", use_consolidated=False)
    for name, node in handle.nodes.items():
        assert dict(group[name].attrs) == node["attributes"]
        if node["node_type"] == "array":
            assert list(group[name].shape) == node["shape"]
    with xr.open_zarr(handle.path) as ds:
        for name, stored in handle.coordinates.items():
            assert ds[name].values.tolist() == stored.values.tolist()


def test_a_status_holds_the_records_of_one_chunk_at_a_time(tmp_path: Path) -> None:
    handle = create_store(tmp_path / "plane.zarr", spec_of(200, 150), (1, 1))
    sizes = [rows[..., 0].size for _, rows, _ in TileRecords(handle).valid_blocks()]
    assert sum(sizes) == handle.tiling.count and max(sizes) <= TILES_PER_CHUNK
