"""The overviews in a store, coarser copies of the atlas: every level is a group, ``overviews/1`` and on, for plain
xarray.

The workers of a run write the overviews. A chunk of level 1 over a single tile is written with the tile. Any other
chunk is a job from the coordinator (``OverviewBuilder``). Overviews are only a cache of finished work:

- A chunk is written when every tile below it is finished, all its arrays first and ``regime`` last. Its regimes exist,
  none pending, if and only if the chunk is current.
- The chunks over a lost tile are dropped before the tile is written again, ``regime`` first.

A kill leaves a chunk current or missing. A reader computes missing chunks from the previous level
(``atlas.query.store_block``).
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, RunError, message_of
from atlas.overview.coarsen import (
    CODES,
    REGIME_SHOWN,
    Cells,
    Widths,
    coarsen,
    from_cells,
    halve_widths,
    level_variables,
)
from atlas.overview.coordinates import level_coordinates, level_dims, multiscales
from atlas.overview.levels import MIN_SIDE, SIDE, Index, OverviewLevels
from atlas.spec.cells import widths_along
from atlas.spec.spec import Slices
from atlas.store.groups import drop_group
from atlas.store.metadata import (
    CRC32C,
    ROOT,
    Node,
    array_node,
    encode_node,
    encode_whole,
    group_node,
    sealed,
    unsealed,
)
from atlas.store.schema import OVERVIEWS, StoredArray, chunk_of_whole, whole_node
from atlas.store.store import AtlasStore, array_in, chunk_key, write_root
from atlas.store.tiles import encode_chunks
from atlas.store.tiling import chunk_mask
from workers.results import PENDING, REGIME, Variable

GROUP = OVERVIEWS
MARKS = (REGIME, REGIME_SHOWN)
"""The two variables of a chunk that are written last, ``regime`` at the very end. Either marks the others as
complete.
"""
_LOOKS, _PAUSE = 10, 0.2
"""Number of attempts at reading finished cells, and seconds between them.

A tile that an earlier run still writes is unfinished for a moment.
"""

_SHAPES = ("side", "least", "classes")
"""Attributes of the group of all levels: ``chunk_side`` and ``min_side`` of ``OverviewLevels``, and the number of
regimes.
"""


class Pyramid:
    """The cells of a store, which are level 0, and its overviews, levels 1 and on: reading, writing, dropping.

    exists   True if there are overviews
    levels   geometry of the levels

    handle         the store
    side, minimum  ``chunk_side`` and ``min_side`` of ``OverviewLevels``, for overviews that are not created yet
    data           metadata of the group of all levels, by default those in the store
    """

    def __init__(
        self, handle: AtlasStore, side: int = SIDE, minimum: int = MIN_SIDE, data: bytes | None = None
    ) -> None:
        from atlas.overview.verifying_store import VerifyingStore  # imports Zarr, which is slow

        self.handle, self._store = handle, VerifyingStore(handle)
        self._arrays: dict[str, Any] = {}
        stored = _stored_shapes(data or handle.backend.get(f"{GROUP}/{ROOT}"))
        self.exists = stored is not None
        shapes = stored or {"side": side, "least": minimum}
        self.levels = OverviewLevels(
            handle.spec.shape,
            handle.tile,
            chunk_side=shapes["side"],
            min_side=shapes["least"],
            n_uncoarsened=handle.spec.n_uncoarsened_dims,
        )

    @property
    def chunks_read(self) -> int:
        """Number of chunks read so far; missing chunks are not counted."""
        return self._store.chunks_read

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        """Variables of every overview, which follow from the results in the store."""
        return level_variables(self.handle.variables)

    @cached_property
    def widths(self) -> list[Widths]:
        """Widths of the cells of every level along each dimension: the atlas first, then the overviews. Only their
        ratios count.
        """
        levels = [widths_along(self.handle.spec)]
        for _ in range(self.levels.count):
            before, n_uncoarsened = levels[-1], self.levels.n_uncoarsened
            levels.append((*before[:n_uncoarsened], *map(halve_widths, before[n_uncoarsened:])))
        return levels

    def array(self, level: int, name: str) -> Any:
        """Return a variable of an overview level, or of the cells themselves for level 0, as a Zarr array for
        reading.
        """
        path = f"{GROUP}/{level}/{name}" if level else name
        if path not in self._arrays:
            node = self.nodes[f"{level}/{name}"] if level else self.handle.nodes[name]
            self._arrays[path] = array_in(self._store, path, node)
        return self._arrays[path]

    def read(self, level: int, name: str, block: Slices) -> NDArray[Any]:
        """Return the values of a variable in a block of cells of an overview level, or of the atlas for level 0.

        Raise ChunkError if a chunk of the block is missing or damaged.
        """
        array = self.array(level, name)
        with _named(self.handle, array.path):
            values = np.asarray(array[block])
        if not level:
            values = self.handle.dominant_arrays({name: values})[name]
        return values

    def stored(self, level: int, mark: Variable) -> set[Index]:
        """Return the indices of the chunks of an overview level that exist, by one of the variables MARKS, from one
        listing.
        """
        folder = f"{GROUP}/{level}/{mark.name}/c"
        keys = self.handle.backend.whole_keys(self.handle.backend.list_keys(f"{folder}/"))
        return set(map(tuple, np.argwhere(chunk_mask(keys, folder, self.levels.grid(level))).tolist()))

    def create(self) -> None:
        """Create the groups of all overview levels, without values, unless they exist."""
        if self.exists:
            return
        backend, top = self.handle.backend, f"{GROUP}/{ROOT}"
        drop_group(self.handle, GROUP)
        backend.remove_all(backend.list_keys(f"{GROUP}/"))
        objects = self.layout()
        backend.put_all({key: data for key, data in objects.items() if key != top})
        backend.put(top, objects[top])
        write_root(self.handle)  # xarray finds a level by the root's copy
        self.exists = True

    def layout(self) -> dict[str, bytes]:
        """Return all metadata and coordinates that the overviews should have, as bytes by key."""
        shapes = {"side": self.levels.chunk_side, "least": self.levels.min_side, "classes": int(CODES.size)}
        about = {"multiscales": multiscales(self.handle.spec, self.levels.count)}
        objects = {f"{GROUP}/{ROOT}": sealed(shapes | about, self.nodes)}
        for path, node in self.nodes.items():
            member_nodes = {
                name.removeprefix(f"{path}/"): n for name, n in self.nodes.items() if name.startswith(f"{path}/")
            }
            objects[f"{GROUP}/{path}/{ROOT}"] = encode_node(node, member_nodes or None)
        for path, stored in self.coordinates().items():
            objects[chunk_of_whole(path, stored)] = encode_whole(stored.values)
        return objects

    def coordinates(self) -> dict[str, StoredArray]:
        """Return the coordinates of all levels by their path in the store."""
        levels = range(1, self.levels.count + 1)
        by_level = {level: level_coordinates(self.handle, level) for level in levels}
        return {f"{GROUP}/{level}/{name}": array for level in levels for name, array in by_level[level].items()}

    def build_chunk(self, level: int, index: Index) -> None:
        """Compute a chunk of an overview level from the next finer level and write it, ``regime`` last.

        All tiles below the chunk must be finished. Raise RunError if cells below stay pending.
        """
        block = self.levels.block(level, index)
        finer = self.levels.finer(level, block)
        names = [variable.name for variable in self.variables]
        below = names if level > 1 else [variable.name for variable in self.handle.variables if variable.name in names]
        for _ in range(_LOOKS):
            arrays = {name: self.read(level - 1, name, finer) for name in below}
            if not (arrays[REGIME.name] == PENDING).any():
                break
            time.sleep(_PAUSE)
        else:
            raise RunError(f"{self.handle.backend}: overview {level}, chunk {index}: cells below it are missing")
        self._write(level, index, from_cells(arrays, names) if level == 1 else arrays)

    def build_chunk_over(self, tile: Index, arrays: Mapping[str, NDArray[Any]]) -> bool:
        """Write the chunk of level 1 that covers a finished tile, from the results of the tile.

        Return False, without writing, if there are no overviews or the chunk covers other tiles, too.
        """
        if not (self.exists and self.levels.is_alone_under_chunk(tile)):
            return False
        names = [variable.name for variable in self.variables]
        stored = {v.name: np.asarray(arrays[v.name], dtype=v.dtype) for v in self.handle.variables if v.name in names}
        self._write(1, self.levels.chunk_over(tile), from_cells(self.handle.dominant_arrays(stored), names))
        return True

    def _write(self, level: int, index: Index, below: Cells) -> None:
        """Coarsen ``below``, the cells that a chunk covers in the next finer level, and write the chunk, ``regime``
        last.

        The lease is confirmed before ``regime`` is written.
        """
        block = self.levels.block(level, index)
        finer = self.levels.finer(level, block)
        widths = tuple(width[f] for width, f in zip(self.widths[level - 1], finer, strict=True))
        coarse, objects = coarsen(below, widths, self.levels.coarsened), dict[str, bytes]()
        for variable in self.variables:
            if variable.name == REGIME.name:
                self.handle.backend.put_all(objects)
                objects = {}
            objects |= encode_chunks(self.array(level, variable.name), block, coarse[variable.name])
        for key, data in objects.items():
            self.handle.backend.commit(key, data)

    def drop(self, tiles: Iterable[Index]) -> None:
        """Make the overview chunks over these tiles count as missing, before any of the tiles is written."""
        self.drop_chunks({(1, self.levels.chunk_over(tile)) for tile in tiles})

    def drop_chunks(self, chunks: Iterable[tuple[int, Index]]) -> int:
        """Make chunks, given as pairs (level, index), and all coarser chunks over them count as missing; return their
        number.
        """
        requested, dropped = set(chunks), set[tuple[int, Index]]()
        if not requested or not self.exists:
            return 0
        over: set[Index] = set()
        for level in range(1, self.levels.count + 1):
            over = {self.levels.parent_chunk(index) for index in over} | {index for n, index in requested if n == level}
            # Both marks: a kill during writing may have left the second without the first.
            for mark in MARKS:
                for index in over & self.stored(level, mark):
                    self.handle.backend.remove(level_key(level, mark, index))
                    dropped.add((level, index))
        return len(dropped)

    @cached_property
    def nodes(self) -> dict[str, Node]:
        """Zarr metadata of the groups of all levels and of their arrays, by path below the group of all levels."""
        levels = range(1, self.levels.count + 1)
        nodes: dict[str, Node] = {str(level): group_node(self._about(level)) for level in levels}
        for path, stored in self.coordinates().items():
            nodes[path.removeprefix(f"{GROUP}/")] = whole_node(stored, (CRC32C,))
        for level in levels:
            nodes |= {f"{level}/{v.name}": self._variable_node(level, v) for v in self.variables}
        return nodes

    def _about(self, level: int) -> dict[str, Any]:
        return {
            "title": f"{self.handle.attributes['title']}, overview {level}",
            "comment": f"a cell stands for {2**level} cells along each axis, fewer at the far ends",
            "level": level,
            "digest": self.handle.digest,
        }

    def _variable_node(self, level: int, variable: Variable) -> Node:
        spec, shape = self.handle.spec, self.levels.shape_of(level)
        stored = REGIME.name if variable.name == REGIME_SHOWN.name else variable.name
        attributes = dict(self.handle.nodes[stored]["attributes"]) if stored in self.handle.nodes else {}
        attributes |= {"long_name": variable.long_name, "units": variable.units}
        if fixed := " ".join(spec.parameters):
            attributes["coordinates"] = fixed
        extra = tuple(CODES.size for _ in variable.extra_dims)
        return array_node(
            shape + extra,
            variable.dtype,
            level_dims(spec) + variable.extra_dims,
            attributes,
            fill=variable.fill,
            block=tuple(map(min, self.levels.chunk, shape)) + extra,
        )


def pyramid_of(handle: AtlasStore) -> Pyramid:
    """Return the cells and overviews of a store, opened once for a handle and its copies with other backends."""
    pyramid = handle.cached(GROUP, lambda: Pyramid(handle))
    if not pyramid.exists and pyramid.levels.count:  # a run makes them after the store
        pyramid = handle.cache[GROUP] = Pyramid(handle)
    through = copy(pyramid)  # shares open arrays, with the handle that writes
    through.handle = handle
    return through


@contextmanager
def _named(handle: AtlasStore, path: str) -> Iterator[None]:
    """Convert errors that damaged bytes cause within the block into a ChunkError that names the path."""
    try:
        yield
    except (OSError, MemoryError, RunError):
        raise
    except Exception as error:  # a codec, or a parser of metadata, may raise anything
        raise ChunkError(handle.backend, {path: f"is damaged ({message_of(error)})"}) from None


def _stored_shapes(data: bytes | None) -> dict[str, int] | None:
    """Return the attributes ``_SHAPES`` in the metadata of the group of all levels.

    None if the metadata are damaged, or written for another number of regimes.
    """
    attributes = unsealed(data)
    if attributes is None or attributes.get("classes") != CODES.size:
        return None
    return {name: int(attributes[name]) for name in _SHAPES}


def level_key(level: int, variable: Variable, index: Index) -> str:
    """Return the key of the object with a chunk of a variable of an overview level."""
    return f"{GROUP}/{level}/{chunk_key(variable, index)}"
