"""The metadata, attributes and coordinates of a new store."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from atlas.spec.spec import Spec
from atlas.store.axes import ROOT, copies
from atlas.store.location import LocalPlace
from atlas.store.machine import MACHINES
from atlas.store.origin import ALLOWANCES, Origin, allowances_in
from atlas.store.record import create_arrays
from atlas.store.schema import DIMENSIONS, StoredArray, coordinates, extra_sizes, root_attributes, variable_attributes
from atlas.store.spare import SPARE, packed_spare
from atlas.store.tiling import Tiling, part_side
from workers.results import Variable

if TYPE_CHECKING:
    import zarr


def build(path: Path, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    """Make a store without a result in a folder of this machine."""
    import zarr

    variables, tiling = spec.variables, Tiling(spec.shape, tuple(map(min, tile, spec.shape)))
    group = zarr.create_group(path, zarr_format=3, attributes=root_attributes(spec, origin, run_id))
    group.create_group(MACHINES, attributes={"long_name": "processors and software that solved this atlas"})
    for name, coordinate in coordinates(spec).items():
        create_whole(group, name, coordinate)
    for key, data in copies(spec).items():
        LocalPlace(path).put(key, data)
    retried = allowances_in(spec) if origin and origin.retry else ()
    for variable in (*variables, *retried):
        create_variable(group, variable, spec, tiling)
    create_arrays(group, (*variables, *ALLOWANCES), spec.dims, tiling.grid, codecs())
    consolidate(group)
    LocalPlace(path).put(SPARE, packed_spare((path / ROOT).read_bytes()))


def create_whole(group: "zarr.Group", name: str, stored: StoredArray) -> None:
    """Make an array of one chunk with its values, in the place of one that is there."""
    values, dims, attributes = stored
    array: Any = group.create_array(
        name,
        shape=values.shape,
        chunks=tuple(max(1, size) for size in values.shape),
        dtype="str" if values.dtype.kind == "T" else values.dtype,
        dimension_names=dims,
        compressors=codecs(),
        attributes=attributes,
        overwrite=True,
    )
    if values.size:
        array.with_config({"write_empty_chunks": True})[...] = values


def create_variable(group: "zarr.Group", variable: Variable, spec: Spec, tiling: Tiling) -> None:
    """Make the array of a result, one object a tile: a chunk, of a large tile a shard of smaller ones."""
    sizes = extra_sizes(spec)
    extra = tuple(sizes[dim] for dim in variable.extra)
    part = tuple(map(part_side, tiling.tile))
    group.create_array(
        variable.name,
        shape=tiling.shape + extra,
        chunks=part + extra,
        shards=tiling.tile + extra if part != tiling.tile else None,
        dtype=variable.dtype,
        fill_value=variable.fill,
        dimension_names=spec.dims + tuple(DIMENSIONS.get(dim, dim) for dim in variable.extra),
        compressors=codecs(),
        attributes=variable_attributes(variable, [*spec.parameters, *spec.points]),
    )


def consolidate(group: "zarr.Group", path: str = "") -> None:
    """Copy the metadata of all arrays below a group into its own metadata, which is all that xarray reads."""
    import zarr

    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        warnings.filterwarnings("ignore", message="Object at parts is not")  # of a search that is still at work
        zarr.consolidate_metadata(group.store, path=path or None)


def codecs() -> list[Any]:
    """How every chunk is packed."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(), Crc32cCodec()]  # writes are atomic but not synced: the checksum finds a torn chunk
