"""Find the faults of a store: everything in it is read and compared, and nothing is written."""

import random
import time
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import accumulate

import numpy as np

from atlas.check.foreign_keys import foreign_keys, leftovers
from atlas.check.groups import small_faults
from atlas.check.metadata import RightObjects, metadata_faults, open_damaged_store
from atlas.check.overviews import check_overviews
from atlas.check.records import record_faults
from atlas.check.report import FOREIGN, StoreFault, VerifyReport
from atlas.check.reproduce import (
    SampledCell,
    find_bit_differences,
    find_differences_beyond_error,
    place_in,
    solve_again,
)
from atlas.check.rules import broken_rules
from atlas.errors import ChunkError
from atlas.formatting import plural
from atlas.service.progress import Progress
from atlas.spec.spec import Spec
from atlas.store.backend import StoreBackend
from atlas.store.host import current_host
from atlas.store.host_records import read_hosts
from atlas.store.object_backend import os_errors_as_input_errors
from atlas.store.record_format import DIGEST, RECORDS, Rows
from atlas.store.store import READERS, AtlasStore, chunk_key, done_mask
from atlas.store.tile_records import EXCHANGED, TileRecords, is_exchanged
from atlas.store.tiles import is_blank, read_tile, record_of
from atlas.store.tiling import Index, Tiling
from workers import SOLVER_VERSION


@dataclass(frozen=True)
class VerifyFindings:
    """The result of reading a whole store: its faults, and what a repair needs.

    handle  handle of the store
    report  the report for people
    rows    correct records of the tiles without faults, computed from their cells
    right   metadata and coordinates that the store should have, by key
    """

    handle: AtlasStore
    report: VerifyReport
    rows: Mapping[Index, Rows] = field(default_factory=dict)
    right: Mapping[str, bytes] = field(default_factory=dict)


def find_faults(backend: StoreBackend, sample: int, seed: int, notify: Callable[[Progress], None]) -> VerifyFindings:
    """Read a whole store and return all its faults.

    backend  backend of the store
    sample   number of cells to solve again
    seed     seed by which they are drawn
    notify   function called with the progress

    Raise InputError if there is no store.
    """
    with os_errors_as_input_errors(backend, "read"):
        handle = open_damaged_store(backend)  # metadata and coordinates are not needed, since they follow from the spec
    notify(Progress("listing the tiles"))
    records, right = TileRecords(handle, done_mask(handle)), RightObjects(handle)
    finished_tiles = [tuple(index) for index in np.argwhere(records.finished_mask).tolist()]
    faults = [*metadata_faults(handle, right), *right.faults]
    faults += [StoreFault(None, f"{key} is not a chunk of this atlas", (FOREIGN, key)) for key in foreign_keys(handle)]

    drawn = draw_cells(handle.tiling, finished_tiles, sample, seed)
    tiles = list(_read_tiles(handle, records, finished_tiles, drawn, notify))
    faults += [StoreFault(tile.index, text) for tile in tiles for text in tile.faults]
    faults += [StoreFault(index, f"{chunk_key(handle.regime, index)} is missing") for index in records.lost]

    comparison, solved, doubts = _comparison(handle, sample, bool(finished_tiles)), 0, list[StoreFault]()
    if comparison in ("bits", "error"):
        samples = [one for tile in tiles for one in tile.samples]
        different, solved = _solve_again(handle.spec, samples, comparison == "bits", notify), len(samples)
        (faults if comparison == "bits" else doubts).extend(different)
    bad = {fault.tile for fault in faults if fault.tile is not None}
    chunks, wrong = check_overviews(handle, bad, lambda level: notify(Progress(f"checking overview {level}")))
    notify(Progress("checking tables and records"))
    rows = {tile.index: tile.row for tile in tiles if tile.row is not None}
    contradictions = [StoreFault(None, text, (RECORDS,)) for text in record_faults(handle, records, rows)]
    faults += [*wrong, *small_faults(handle), *contradictions]
    report = VerifyReport(
        store=str(backend),
        tiles=handle.tiling.count,
        tiles_done=len(finished_tiles),
        seed=seed,
        chunks=sum(tile.chunks for tile in tiles),
        cells_checked=sum(tile.cells for tile in tiles),
        cells_solved=solved,
        comparison=comparison,
        overview_chunks=chunks,
        faults=tuple(faults),
        doubts=tuple(doubts),
        leftovers=tuple(leftovers(handle.backend)),
    )
    return VerifyFindings(handle, report, {index: row for index, row in rows.items() if index not in bad}, right)


def _solve_again(
    spec: Spec, samples: list[SampledCell], exact: bool, notify: Callable[[Progress], None]
) -> Iterator[StoreFault]:
    """Solve sampled cells again, and yield a fault for each whose results differ from the stored results.

    With ``exact`` any differing bit counts, else only differences beyond the errors.
    """
    for k, one in enumerate(samples, 1):
        notify(Progress("solving cells again", detail=f"{k} of {len(samples)}"))
        again = solve_again(spec, one)
        different = (
            find_bit_differences(one.stored, again) if exact else find_differences_beyond_error(spec, one.stored, again)
        )
        if different:
            yield StoreFault(one.tile, f"cell {place_in(spec, one.cell)}: {different}")


@dataclass(frozen=True)
class _TileCheckResult:
    """The result of reading and checking a tile.

    index    index of the tile
    chunks   number of its intact chunks
    cells    number of its cells checked by the rules
    faults   texts about its faults
    samples  cells drawn from it, to be solved again
    row      its correct tile record, from the cells; None if they cannot be read
    """

    index: Index
    chunks: int
    cells: int
    faults: tuple[str, ...]
    samples: tuple[SampledCell, ...]
    row: Rows | None = None


def _read_tiles(
    handle: AtlasStore,
    records: TileRecords,
    finished_tiles: list[Index],
    drawn: dict[Index, list[int]],
    notify: Callable[[Progress], None],
) -> Iterator[_TileCheckResult]:
    """Read and check the finished tiles, several at once, and yield the result of each.

    handle          the store
    records         its tile records
    finished_tiles  indices of the tiles
    drawn           cells to be solved again, as flat indices within a tile, by tile
    notify          function called with the progress
    """
    tiling = handle.tiling
    _ = records.columns(DIGEST)  # before several threads read them
    sizes = [tiling.at(index).size for index in finished_tiles]
    pending = tiling.cells - sum(sizes)  # counted as read, so that the time left is that of reading
    begin = time.perf_counter()
    unfinished = tiling.count - len(finished_tiles)
    stage = Progress("reading", tiles=tiling.count, cells=tiling.cells, tiles_done=unfinished, cells_done=pending)
    notify(stage)
    with ThreadPoolExecutor(READERS) as readers:
        checked = readers.map(lambda index: _check_tile(handle, records, index, drawn.get(index, [])), finished_tiles)
        for read, (tile, cells) in enumerate(zip(checked, accumulate(sizes), strict=True), 1):
            seconds = time.perf_counter() - begin
            tiles = unfinished + read
            notify(replace(stage, tiles_done=tiles, cells_done=pending + cells, cells_solved=cells, seconds=seconds))
            yield tile


def _check_tile(handle: AtlasStore, records: TileRecords, index: Index, drawn: list[int]) -> _TileCheckResult:
    """Read a finished tile, and check its chunks, its cells and its record; ``drawn`` are cells to be solved again."""
    tile = handle.tiling.at(index)
    stored = (*handle.variables, *handle.allowances)
    try:
        values = read_tile(handle, index)
    except ChunkError as error:
        return _TileCheckResult(index, len(stored) - len(error.lines), 0, tuple(error.lines), ())
    broken = broken_rules(handle.spec, tile.slices, values)
    faults = tuple(
        f"{text}: {plural(int(mask.sum()), 'cell')}, the first at {place_in(handle.spec, _first(mask, tile.slices))}"
        for text, mask in broken.items()
    )
    row = record_of(handle, index, values)
    faults += (EXCHANGED,) * is_exchanged(records, index, row)
    samples = []
    for flat in drawn:
        inner = tuple(int(i) for i in np.unravel_index(flat, tile.shape))
        cell = tuple(part.start + i for part, i in zip(tile.slices, inner, strict=True))
        one = tuple(slice(i, i + 1) for i in inner)
        samples.append(SampledCell(cell, index, {name: array[one].copy() for name, array in values.items()}))
    sparse = [variable for variable in stored if variable.sparse]
    chunks = len(stored) - sum(is_blank(values[v.name], v) for v in sparse)
    return _TileCheckResult(index, chunks, tile.size, faults, tuple(samples), row)


def _first(mask: np.ndarray, slices: tuple[slice, ...]) -> Index:
    """Return the index, in the atlas, of the first cell that is True in a mask over the tile with these slices."""
    return tuple(part.start + int(along[0]) for part, along in zip(slices, np.nonzero(mask), strict=True))


def draw_cells(tiling: Tiling, finished_tiles: list[Index], count: int, seed: int) -> dict[Index, list[int]]:
    """Draw ``count`` cells at random from the finished tiles, all with the same probability.

    Return, by tile, the flat indices of the drawn cells within the tile.
    """
    rng = random.Random(seed)
    ends = list(accumulate(tiling.at(index).size for index in finished_tiles))
    total = ends[-1] if ends else 0
    drawn: defaultdict[Index, list[int]] = defaultdict(list)
    for flat in sorted(rng.sample(range(total), min(count, total))):
        tile = bisect_right(ends, flat)
        drawn[finished_tiles[tile]].append(flat - (ends[tile - 1] if tile else 0))
    return drawn


def _comparison(handle: AtlasStore, sample: int, any_done: bool) -> str:
    """Return how cells that are solved again are compared, "bits" or "error", or the reason why no cell is compared."""
    if not sample:
        return "none asked for"
    if handle.solver_version != SOLVER_VERSION:
        return f"the store has solver version {handle.solver_version}, this program {SOLVER_VERSION}"
    if handle.spec.continuation is not None:
        return "each cell of a continued sweep depends on the cells before it"
    if not any_done:
        return "no cell is done"
    return "bits" if {machine.name for machine in read_hosts(handle)} == {current_host().name} else "error"
