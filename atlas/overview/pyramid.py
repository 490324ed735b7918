"""Overviews on disk: every level a group of the store, ``overviews/1`` and on, that plain xarray opens.

Only the coordinator of a run writes them, because a coarse chunk lies over many tiles. They are a cache of finished
work and never more than that:

- A chunk is written when every tile below it is done, all its arrays first and ``regime`` last. Its regimes are there,
  none of them pending, if and only if the chunk is current.
- Before a tile is written for a second time, the chunks over it are dropped: ``regime`` first.

So a kill at any moment leaves a chunk current or missing, and what is missing is computed from the level before when
it is asked for (``atlas.query.source``).
"""

import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, RunError, message_of
from atlas.overview.coarsen import (
    CODES,
    REGIME_SHOWN,
    Widths,
    coarsen,
    from_cells,
    halved,
    level_variables,
)
from atlas.overview.levels import Index, Levels
from atlas.spec.cells import edges_of, widths_along
from atlas.spec.spec import Slices
from atlas.store.build import codecs
from atlas.store.schema import OVERVIEWS, Coordinate
from atlas.store.store import ROOT, Header, chunk_key, done_tiles, open_group
from atlas.store.tiling import chunk_index
from workers.results import PENDING, REGIME, REGIMES, Variable

GROUP = OVERVIEWS
MARKS = (REGIME, REGIME_SHOWN)
"""Written last of a chunk, the first of them at the very end: either tells that all else of it is there."""
WAIT_SECONDS = 5.0
"""Between two signs of life at the end of a run."""
_VERSION = 1
"""Of the form of the levels; those of another version are not read, and made anew by the next run."""


def levels_of(header: Header) -> Levels:
    """The geometry of a store's overviews."""
    return Levels(header.spec.shape, header.tile)


class Pyramid:
    """A store's cells and overviews opened for reading, with the number of chunks read since.

    ``root`` is the store's group; ``made`` tells whether there are overviews at all. ``read`` takes level 0 for the
    cells.
    """

    def __init__(self, header: Header) -> None:
        self._header = header
        self._plain = _root(header, "r").store
        self.root = _guarded_root(header)
        self._arrays: dict[str, Any] = {}
        self.levels = levels_of(header)
        self.made = _made(self.root)

    @property
    def chunks_read(self) -> int:
        """Chunks found and read so far; one that does not exist is not counted."""
        return int(self.root.store.chunks_read)

    def holds(self, array: Any, name: str) -> bool:
        """Whether this store is where a Zarr array lies, by that name."""
        place = getattr(array, "store_path", None)
        return place is not None and place.path == name and place.store in (self.root.store, self._plain)

    def array(self, level: int, name: str) -> Any:
        """A variable of a level as a Zarr array; ChunkError where its metadata are damaged."""
        path = f"{GROUP}/{level}/{name}" if level else name
        if path not in self._arrays:
            with _named(self._header, f"{path}/{ROOT}"):
                self._arrays[path] = self.root[path]
        return self._arrays[path]

    def read(self, level: int, name: str, part: Slices) -> NDArray[Any]:
        """A part of a variable of a level; ChunkError where a chunk of it is missing or damaged."""
        array = self.array(level, name)
        with _named(self._header, array.path):
            return np.asarray(array[part])


class Overviews(AbstractContextManager["Overviews"]):
    """The overviews of a store kept up during a run: a thread of the coordinator makes each chunk when it can.

    On entry, what lies over unfinished tiles and over ``pending`` ones, finished but to be written again, is dropped.
    ``add`` tells of a tile that is written; ``finish`` waits until everything that can be made is. On the way out what
    is not yet begun is left.
    """

    def __init__(self, header: Header, pending: Iterable[Index] = ()) -> None:
        self._header = header
        self._levels = levels_of(header)
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="overviews")
        self._futures: list[Future[int]] = []
        self._missing: dict[Index, int] = {}
        if not self._levels.count:
            return
        _ensure(header)
        waiting = np.ones(header.tiling.grid, dtype=bool)
        for tile in done_tiles(header):
            waiting[tile] = False
        for tile in pending:
            waiting[tile] = True
        drop(header, filter(waiting.__getitem__, np.ndindex(waiting.shape)))
        for tile in filter(waiting.__getitem__, np.ndindex(waiting.shape)):
            over = self._levels.over(tile)
            self._missing[over] = self._missing.get(over, 0) + 1
        self._current = {n: stored_chunks(header, n, REGIME) for n in self._numbers}
        # What an earlier run finished and did not come to: it was killed, or knew no overviews.
        self._submit(1, [i for i in self._levels.chunks(1) if i not in self._missing and i not in self._current[1]])
        for level in self._numbers[1:]:
            self._submit(level, [i for i in self._levels.chunks(level) if self._ready(level, i)])

    @property
    def _numbers(self) -> range:
        return range(1, self._levels.count + 1)

    def _ready(self, level: int, index: Index) -> bool:
        """Whether a chunk above level 1 is missing and all that it is made of is there."""
        below = self._current[level - 1]
        return index not in self._current[level] and all(i in below for i in self._levels.children(level, index))

    def add(self, tile: Index) -> None:
        """A tile is written."""
        if not self._levels.count:
            return
        over = self._levels.over(tile)
        left = self._missing.get(over, 0) - 1
        self._missing[over] = max(left, 0)
        if left < 0:  # written once more than was said
            self._futures.append(self._threads.submit(self._again, tile))
        elif left == 0:
            self._submit(1, [over])

    def finish(self, tell: Callable[[int, int], None] = lambda _done, _all: None) -> int:
        """Wait until all that can be made is made; the number of chunks made since the beginning.

        ``tell`` is called, now and every few seconds, with the parts done and all parts while there is something to
        wait for. Raises RunError where a write failed.
        """
        left = set(self._futures)
        while left and self._failure() is None:
            if any(not future.done() for future in left):
                tell(len(self._futures) - len(left), len(self._futures))
            _, left = wait(left, timeout=WAIT_SECONDS, return_when=FIRST_EXCEPTION)
        if (failure := self._failure()) is not None:
            if not isinstance(failure, OSError | ValueError):
                raise failure
            raise RunError(
                f"{self._header.place}: the tiles done are kept, but the overviews could not be written ({failure}); "
                "run again to make them"
            ) from failure
        return sum(future.result() for future in self._futures)

    def _failure(self) -> BaseException | None:
        return next((future.exception() for future in self._futures if future.done() and future.exception()), None)

    def _submit(self, level: int, indices: Iterable[Index]) -> None:
        self._futures += [self._threads.submit(self._make, level, index) for index in indices]

    def _make(self, level: int, index: Index) -> int:
        """Make a chunk, and those above it that it completes; how many."""
        made = 0
        while index not in self._current[level]:
            make(self._header, level, index)
            self._current[level].add(index)
            made += 1
            above = tuple(i // 2 for i in index)
            if level == self._levels.count or not self._ready(level + 1, above):
                break
            level, index = level + 1, above
        return made

    def _again(self, tile: Index) -> int:
        """Drop what lies over a tile and make it anew as far as its tiles are done."""
        drop(self._header, [tile])
        over = index = self._levels.over(tile)
        for level in self._numbers:
            self._current[level].discard(index)
            index = tuple(i // 2 for i in index)
        return self._make(1, over) if not self._missing[over] else 0

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave what is not begun; a chunk under way is finished."""
        self._threads.shutdown(cancel_futures=True)


def drop(header: Header, tiles: Iterable[Index]) -> None:
    """Drop the overviews of these tiles: to be done before any of them is written."""
    levels = levels_of(header)
    drop_chunks(header, {(1, levels.over(tile)) for tile in tiles})


def drop_all(header: Header) -> None:
    """Drop the overviews as a whole, metadata and all: without its own metadata the group counts as not there."""
    header.place.remove(f"{GROUP}/{ROOT}")


def drop_chunks(header: Header, chunks: Iterable[tuple[int, Index]]) -> None:
    """Drop chunks of levels, each given as its level and index, and all that lies over them."""
    wanted, levels = set(chunks), levels_of(header)
    if not wanted or not _made(_root(header, "r")):
        return
    over: set[Index] = set()
    for level in range(1, levels.count + 1):
        over = {tuple(i // 2 for i in index) for index in over} | {index for n, index in wanted if n == level}
        # Both, each where it is: a kill while a chunk was written may have left the second without the first.
        for mark in MARKS:
            for index in over & stored_chunks(header, level, mark):
                header.place.remove(level_key(level, mark, index))


def make(header: Header, level: int, index: Index) -> None:
    """Compute a chunk of a level from the level before and write it, ``regime`` last; all tiles below must be done."""
    levels = levels_of(header)
    root, read = _root(header, "r+"), _guarded_root(header)
    names = [variable.name for variable in level_variables(header.variables)]
    part = levels.finer(level, levels.block(level, index))
    source = read if level == 1 else read[f"{GROUP}/{level - 1}"]
    arrays = {name: np.asarray(source[name][part]) for name in names if name in source}
    if (arrays[REGIME.name] == PENDING).any():
        raise RunError(f"{header.place}: overview {level}, chunk {index}: not all that lies below it is done")
    cells = from_cells(arrays, names) if level == 1 else arrays
    widths = level_widths(header)[level - 1]
    made = coarsen(cells, tuple(width[p] for width, p in zip(widths, part, strict=True)))
    for name in names:
        array = root[f"{GROUP}/{level}/{name}"]
        array.with_config({"write_empty_chunks": True})[levels.block(level, index)] = made[name]


def level_widths(header: Header) -> list[Widths]:
    """The widths of the cells of every level along each dimension, the atlas itself first; only ratios count."""
    found = [widths_along(header.spec)]
    for _ in range(levels_of(header).count):
        found.append(tuple(map(halved, found[-1])))
    return found


def level_edges(header: Header, level: int) -> list[NDArray[np.float64]]:
    """The edges of the cells of a level along each dimension."""
    found = []
    for axis in reversed(header.spec.axes):
        edges = edges_of(np.array(axis.values), axis.scale == "log")
        found.append(np.append(edges[: -1 : 2**level], edges[-1]))
    return found


def _root(header: Header, mode: Literal["r", "r+"]) -> Any:
    return open_group(header.place, mode)


def _guarded_root(header: Header) -> Any:
    """The root group for reading, on a store that lets no bad chunk pass."""
    import zarr

    from atlas.overview.guard import GuardedStore

    return zarr.open_group(GuardedStore(header), mode="r", use_consolidated=False)


@contextmanager
def _named(header: Header, path: str) -> Iterator[None]:
    """What reading bytes that nobody wrote raises becomes a ChunkError that names the path."""
    try:
        yield
    except (OSError, MemoryError, RunError):
        raise
    except Exception as error:  # a codec, or a parser of metadata, may raise anything
        raise ChunkError(header.place, {path: f"is damaged ({message_of(error)})"}) from None


def _made(root: Any) -> bool:
    """Whether there are overviews of the form known here; metadata that are damaged are none."""
    try:
        return GROUP in root and root[GROUP].attrs.get("version") == _VERSION
    except OSError:
        raise
    except Exception:  # what is no JSON, or no metadata, may raise anything
        return False


def _ensure(header: Header) -> None:
    """Make the groups of all levels, without a value, where they are not yet; the last step says that they are."""
    import zarr

    root = _root(header, "r+")
    if _made(root):
        return
    levels = levels_of(header)
    top = root.create_group(GROUP, overwrite=True)
    for level in range(1, levels.count + 1):
        _create(root, top.create_group(str(level)), header, level)
    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        for level in range(1, levels.count + 1):
            zarr.consolidate_metadata(root.store, path=f"{GROUP}/{level}")
        zarr.consolidate_metadata(root.store)
    top.attrs["version"] = _VERSION


def _create(root: Any, group: Any, header: Header, level: int) -> None:
    levels, spec = levels_of(header), header.spec
    group.attrs.update(
        {
            "title": f"{root.attrs['title']}, overview {level}",
            "comment": f"a cell stands for {2**level} cells along each axis, fewer at the far ends",
            "level": level,
            "digest": header.digest,
        }
    )

    fixed = " ".join(name for name in spec.parameters if name in header.coordinates)
    for name, (values, dims, attributes) in level_coordinates(header, level).items():
        group.create_array(name, data=values, chunks=values.shape, dimension_names=dims, attributes=attributes)
    for variable in level_variables(header.variables):
        stored = REGIME.name if variable.name == REGIME_SHOWN.name else variable.name
        attributes = dict(root[stored].attrs) if stored in root else {}
        attributes |= {"long_name": variable.long_name, "units": variable.units}
        if fixed:
            attributes["coordinates"] = fixed
        extra = tuple(CODES.size for _ in variable.extra)
        shape = levels.shape_of(level)
        group.create_array(
            variable.name,
            shape=shape + extra,
            chunks=tuple(map(min, levels.chunk, shape)) + extra,
            dtype=variable.dtype,
            fill_value=variable.fill,
            dimension_names=spec.dims + variable.extra,
            compressors=codecs(),
            attributes=attributes,
        )


def level_coordinates(header: Header, level: int) -> dict[str, Coordinate]:
    """The coordinates of a level by name: axes with their bounds, fixed parameters, the names of the classes."""
    spec, base, made = header.spec, header.coordinates, {}
    for axis, edges in zip(reversed(spec.axes), level_edges(header, level), strict=True):
        bounds = bounds_name(axis.name)
        attributes = {**base[axis.name].attributes, "bounds": bounds}
        made[axis.name] = Coordinate(centres(edges, axis.scale == "log"), (axis.name,), attributes)
        made[bounds] = Coordinate(np.stack([edges[:-1], edges[1:]], axis=1), (axis.name, "bound"), {})
    for name in base.keys() & spec.parameters.keys():
        made[name] = Coordinate(np.asarray(base[name].values), (), base[name].attributes)
    named = np.array([regime.name for regime in REGIMES], dtype="T")
    return made | {"class": Coordinate(named, ("class",), {"long_name": "regime of motion"})}


def bounds_name(axis: str) -> str:
    """The name of the variable that holds the edges of an axis's coarse cells."""
    return f"{axis}_bounds"


def centres(edges: NDArray[np.float64], log: bool) -> NDArray[np.float64]:
    """The middles of cells: half way between their edges, on a log axis the geometric mean."""
    return np.sqrt(edges[:-1] * edges[1:]) if log else 0.5 * (edges[:-1] + edges[1:])


def level_key(level: int, variable: Variable, index: Index) -> str:
    """The key of a chunk of a level's variable."""
    return f"{GROUP}/{level}/{chunk_key(variable, index)}"


def stored_chunks(header: Header, level: int, mark: Variable) -> set[Index]:
    """Indices of the chunks of a level that exist, by one of MARKS. One listing tells them."""
    root, grid = f"{GROUP}/{level}/{mark.name}/c/", levels_of(header).grid(level)
    found = (chunk_index(key.removeprefix(root), grid) for key in header.place.list_keys(root))
    return {index for index in found if index is not None}
