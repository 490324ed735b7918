"""A tally of each finished tile, kept in the store, so that what an atlas holds is known without reading its cells.

One array, ``tally/tiles``: for every tile one entry, its cells of each regime, their area, and its cells by reason.
Only the coordinator of a run writes it. It is a cache of finished work and never more than that:

- An entry counts while its tile is finished, by the listing of the store, and adds up to the tile's cells. Any other
  tile is counted from its chunks.
- Before a tile is solved its entry is cleared, and it is set again from the tile's receipt, after it is written.

So a kill at any moment leaves a right entry or none. A store whose tally is missing, damaged or of another form is
counted by the next run. In a tally from before there was some regime or reason, no cell has it.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, suppress
from functools import reduce
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, message_of
from atlas.spec.cells import widths_along
from atlas.spec.spec import Spec
from atlas.store.build import codecs
from atlas.store.store import READERS, ROOT, Header, done_tiles, open_arrays, open_group
from atlas.store.tiles import read_tile
from atlas.store.tiling import Tiling
from workers.results import PENDING, REASON, REASONS, REGIME, REGIMES

GROUP, ARRAY = "tally", "tiles"
_ABOUT = {"long_name": "what the finished tiles hold, a cache"}
CELLS, AREAS = slice(0, len(REGIMES)), slice(len(REGIMES), 2 * len(REGIMES))
BY_REASON = slice(2 * len(REGIMES), 2 * len(REGIMES) + len(REASONS))
"""Where an entry has its cells by regime, their areas, and its cells by reason, in the order of the tables."""
COLUMNS = (
    *(f"cells {regime.name}" for regime in REGIMES),
    *(f"area {regime.name}" for regime in REGIMES),
    *(f"reason {reason.name}" for reason in REASONS),
)
CHUNK = 4096
"""Entries in one chunk."""
FLUSH_SECONDS = 5.0
"""Between two writes of what has come; more where a write takes long, so that they take a small share of the time."""
COUNTED_TOGETHER = 512
"""Tiles counted between two writes, and at most after a run that ends early."""
WAIT_SECONDS = 5.0
"""Between two signs of life at the end of a run."""

Index = tuple[int, ...]
Entries = NDArray[np.float64]


def tile_entry(spec: Spec, slices: tuple[slice, ...], arrays: dict[str, NDArray[Any]]) -> Entries:
    """The entry of a tile from its regimes and, where there are any, its reasons. Areas are in units of the axes."""
    codes = arrays[REGIME.name]
    area = reduce(np.multiply.outer, (width[part] for width, part in zip(widths_along(spec), slices, strict=True)))
    known = (codes >= PENDING) & (codes < PENDING + len(REGIMES))  # what is none of them adds up to no entry
    places = codes[known] - PENDING
    entry = np.zeros(len(COLUMNS))
    entry[CELLS] = np.bincount(places, minlength=len(REGIMES))
    entry[AREAS] = np.bincount(places, weights=area[known], minlength=len(REGIMES))
    reasons = arrays.get(REASON.name, np.zeros(codes.shape, REASON.dtype))
    entry[BY_REASON] = [np.count_nonzero(reasons == reason.code) for reason in REASONS]
    return entry


def count_tiles(header: Header, tiles: Sequence[Index]) -> Iterator[Entries | ChunkError]:
    """The entries of finished tiles from their chunks, read concurrently; the error of one whose chunks are damaged."""
    if not tiles:
        return
    arrays = open_arrays(header)

    def count_one(index: Index) -> Entries | ChunkError:
        try:
            found = read_tile(header, index, (REGIME.name, REASON.name), arrays)
        except ChunkError as error:
            return error
        return tile_entry(header.spec, header.tiling.at(index).slices, header.leading(found))

    with ThreadPoolExecutor(READERS) as readers:
        yield from readers.map(count_one, tiles)


def tile_areas(header: Header) -> NDArray[np.float64]:
    """The area of every tile in the units of ``tile_entry``, as an array over the tiles."""
    widths = zip(widths_along(header.spec), header.tile, strict=True)
    along = (np.add.reduceat(width, np.arange(0, width.size, tile)) for width, tile in widths)
    return np.asarray(reduce(np.multiply.outer, along))


def done_mask(header: Header) -> NDArray[np.bool_]:
    """Which tiles are finished, as an array over the tiles."""
    done = np.zeros(header.tiling.grid, dtype=bool)
    for index in done_tiles(header):
        done[index] = True
    return done


def read_tally(root: Any, tiling: Tiling) -> tuple[Entries, NDArray[np.bool_]]:
    """The entries of all tiles, and the mask of those that are there and add up; of the store's root group."""
    entries = np.zeros((*tiling.grid, len(COLUMNS)))
    array = _array_of(root, tiling)
    if array is not None:
        places = [COLUMNS.index(name) for name in _columns_of(array)]
        for block in _blocks(array):
            entries[block][..., places] = _read(array, block)
    return entries, entries[..., CELLS].sum(axis=-1) == tiling.sizes()


def tally_faults(header: Header, counted: Mapping[Index, Entries]) -> list[str]:
    """What is wrong with a store's tally, by the entries that finished tiles have by their cells."""
    key = f"{GROUP}/{ARRAY}"
    if not any(header.place.exists(f"{path}/{ROOT}") for path in (GROUP, key)):
        return []
    root: Any = open_group(header.place, "r")
    array = _array_of(root, header.tiling)
    try:
        about = dict(root[GROUP].attrs)
    except OSError:
        raise
    except Exception:  # what is no metadata may raise anything
        about = {}
    if array is None or about != _ABOUT:
        return [f"metadata of the {GROUP} are damaged"]
    faults = []
    for block in _blocks(array):
        try:
            array[block]
        except OSError:
            raise
        except Exception as error:  # a codec that meets bytes it never wrote may raise anything
            chunk = (part.start // size for part, size in zip(block, array.chunks, strict=False))
            faults.append(f"{'/'.join([key, 'c', *map(str, chunk), '0'])} is damaged ({message_of(error)})")
    entries, known = read_tally(root, header.tiling)
    told = slice(0, None if REASON in header.variables else BY_REASON.start)  # an older store keeps no reasons
    wrong = [
        i for i, e in counted.items() if known[i] and not np.allclose(entries[i][told], e[told], rtol=1e-9, atol=0)
    ]
    return faults + [f"{key} contradicts the cells of tile {index}" for index in wrong]


def drop_tally(header: Header) -> None:
    """Make the tally absent: the next run counts the tiles anew."""
    for path in (GROUP, f"{GROUP}/{ARRAY}"):
        header.place.remove(f"{path}/{ROOT}")


class TallyKeeper(AbstractContextManager["TallyKeeper"]):
    """The tally of a store kept up during a run: a thread of the coordinator writes it every few seconds.

    On entry the entries of tiles that are to be solved are cleared: of unfinished ones and of ``again``. ``add`` takes
    the entry of a tile that is written; ``finish`` counts what an earlier run has left uncounted, and writes all.
    ``held`` is called before each write, and raises where another run has the store.
    """

    def __init__(self, header: Header, again: Iterable[Index] = (), held: Callable[[], None] = lambda: None) -> None:
        self._header, self._held = header, held
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._new: dict[Index, Entries] = {}
        settled = done_mask(header)
        for index in again:
            settled[index] = False
        self._array = _ensured(header)
        entries, known = read_tally(open_group(header.place, "r"), header.tiling)
        stale = entries.any(axis=-1) & ~settled
        if stale.any():
            self._write({tuple(index): np.zeros(len(COLUMNS)) for index in np.argwhere(stale).tolist()})
        self._uncounted = [tuple(index) for index in np.argwhere(settled & ~known).tolist()]
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="tally")
        self._counting: Future[None] = self._thread.submit(self._count)
        self._flushing: Future[None] | None = None
        self._due = time.monotonic() + FLUSH_SECONDS

    def add(self, index: Index, entry: Iterable[float]) -> None:
        """A tile is written, and this is its entry."""
        with self._lock:
            self._new[index] = np.array(tuple(entry))
        if time.monotonic() >= self._due and (self._flushing is None or self._flushing.done()):
            self._flushing = self._thread.submit(self._flush)

    def finish(self, on_wait: Callable[[int], None] = lambda _tiles: None) -> None:
        """Wait until what was left uncounted is counted, and write all; ``on_wait`` is called with their number."""
        while not self._counting.done():
            on_wait(len(self._uncounted))
            wait([self._counting], timeout=WAIT_SECONDS)
        self._counting.result()
        self._thread.submit(self._flush).result()

    def _count(self) -> None:
        """Count the tiles that an earlier run has left uncounted; one with a damaged chunk is left so."""
        for first in range(0, len(self._uncounted), COUNTED_TOGETHER):
            some = self._uncounted[first : first + COUNTED_TOGETHER]
            if self._stopped.is_set():
                return
            with suppress(OSError):
                found = zip(some, count_tiles(self._header, some), strict=True)
                self._write({index: entry for index, entry in found if not isinstance(entry, ChunkError)})

    def _flush(self) -> None:
        """Write what has come. What cannot be written is left out: it will be counted when it is needed."""
        with self._lock:
            new, self._new = self._new, {}
        begin = time.monotonic()
        with suppress(OSError):
            self._write({index: entry for index, entry in new.items() if entry.size == len(COLUMNS)})
        self._due = time.monotonic() + max(FLUSH_SECONDS, 20.0 * (time.monotonic() - begin))

    def _write(self, entries: dict[Index, Entries]) -> None:
        by_chunk: dict[Index, list[Index]] = {}
        for index in entries:
            chunk = tuple(i // c for i, c in zip(index, self._array.chunks, strict=False))
            by_chunk.setdefault(chunk, []).append(index)
        for chunk, indices in by_chunk.items():
            block = tuple(slice(k * c, (k + 1) * c) for k, c in zip(chunk, self._array.chunks, strict=False))
            values = _read(self._array, block)
            for index in indices:
                values[tuple(i - part.start for i, part in zip(index, block, strict=True))] = entries[index]
            self._held()
            self._array[block] = values

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write what has come, unless the run ended by an error: the store may then be another run's."""
        self._stopped.set()
        if kind is None or not issubclass(kind, Exception):
            self._thread.submit(self._flush)
        self._thread.shutdown()


def _array_of(root: Any, tiling: Tiling) -> Any:
    """The tally's array in a store, None where there is none with columns that are known."""
    try:
        array = root[f"{GROUP}/{ARRAY}"]
        columns = _columns_of(array)
        fits = array.shape == (*tiling.grid, len(columns)) and {*columns} <= {*COLUMNS}
    except OSError:
        raise
    except Exception:  # there is none, or its metadata are damaged, which may raise anything
        return None
    return array if fits else None


def _columns_of(array: Any) -> tuple[str, ...]:
    return tuple(array.attrs.get("columns", ()))


def _ensured(header: Header) -> Any:
    """The tally's array, made anew where there is none of this form."""
    root, grid = open_group(header.place, "r+"), header.tiling.grid
    array = _array_of(root, header.tiling)
    if array is not None and _columns_of(array) == COLUMNS:
        return array
    group = root.create_group(GROUP, overwrite=True, attributes=_ABOUT)
    side = round(CHUNK ** (1.0 / len(grid)))
    return group.create_array(
        ARRAY,
        shape=(*grid, len(COLUMNS)),
        chunks=(*(min(side, n) for n in grid), len(COLUMNS)),
        dtype="float64",
        fill_value=0.0,
        dimension_names=(*(f"tile_{name}" for name in header.spec.dims), "column"),
        compressors=codecs(),
        attributes={"columns": list(COLUMNS)},
    )


def _blocks(array: Any) -> Iterator[tuple[slice, ...]]:
    """The chunks of the tally, as slices of its tiles."""
    tiles, chunks = array.shape[:-1], array.chunks[:-1]
    for chunk in np.ndindex(*(-(-n // c) for n, c in zip(tiles, chunks, strict=True))):
        yield tuple(slice(k * c, (k + 1) * c) for k, c in zip(chunk, chunks, strict=True))


def _read(array: Any, block: tuple[slice, ...]) -> Entries:
    """A chunk of the tally, in its own columns; one that is damaged reads as without an entry."""
    try:
        return np.array(array[block])
    except OSError:
        raise
    except Exception:  # a codec that meets bytes it never wrote may raise anything
        shape = (len(range(*p.indices(n))) for p, n in zip(block, array.shape, strict=False))
        return np.zeros((*shape, array.shape[-1]))
