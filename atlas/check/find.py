"""Finding faults: everything in a store is read and compared; nothing is written."""

import random
import time
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np

from atlas.check.foreign import foreign_keys
from atlas.check.groups import GroupReport, check_groups
from atlas.check.metadata import coordinate_faults, metadata_faults
from atlas.check.overviews import OverviewReport, check_overviews
from atlas.check.records import record_faults, tile_faults
from atlas.check.report import Report, StoreFault
from atlas.check.reproduce import Sample, beyond_error, place_in, solve_again, unequal
from atlas.check.rules import broken_rules
from atlas.check.zoom import plane_faults
from atlas.errors import ChunkError, InputError
from atlas.service.progress import Progress
from atlas.store.location import refused
from atlas.store.machine import this_machine
from atlas.store.machines import machines
from atlas.store.origin import ALLOWANCES
from atlas.store.place import Place
from atlas.store.record import COVERED, Rows
from atlas.store.records import Records
from atlas.store.spare import SPARE, nodes_of, read_spare, remedy, spare_faults
from atlas.store.store import (
    READERS,
    ROOT,
    ZOOM,
    Atlas,
    chunk_key,
    done_tiles,
    handle_by,
    open_arrays,
    open_handle,
)
from atlas.store.tiles import is_blank, read_tile, record_of
from atlas.store.tiling import Tiling
from atlas.store.zoom import sheet_place, sheets
from atlas.text import plural
from workers import SOLVER_VERSION
from workers.results import REGIME

Index = tuple[int, ...]


@dataclass(frozen=True)
class Findings:
    """The findings in a store: the report for people, and the parts that are faulty.

    unread      its metadata are, and nothing was read through them
    spareless   the spare of its metadata is
    worn        its coordinates are
    records     the records of its tiles, by the cells of each, where the stored ones are; None where they are sound
    tiles       finished tiles
    overviews, groups, foreign, zoom   the other parts; of the zoom levels sheets, planes and ()
    """

    handle: Atlas
    report: Report
    unread: bool = False
    spareless: bool = False
    worn: bool = False
    records: Mapping[Index, Rows] | None = None
    tiles: tuple[Index, ...] = ()
    overviews: OverviewReport | None = None
    groups: GroupReport | None = None
    foreign: tuple[str, ...] = ()
    zoom: tuple[tuple[str, ...], ...] = ()


def find(place: Place, sample: int, seed: int, notify: Callable[[Progress], None]) -> Findings:
    """All that is wrong in a store, see ``verify.verify``, by reading it whole. InputError where there is no store."""
    with refused(place, "read"):
        spare = read_spare(place)
    if spare is not None and (lost := spare_faults(place, spare)):
        handle = handle_by(place, spare, nodes_of(spare)[f"{REGIME.name}/{ROOT}"])
        return _unread(handle, seed, [f"{key} {what}: {remedy(place)}" for key, what in lost.items()])
    handle = open_handle(place)
    found = _with_zoom(_found(handle, sample, seed, notify), sample, notify)
    if spare is not None:
        return found
    fault = StoreFault(None, f"{SPARE} is missing or damaged: {remedy(place)}")
    return replace(found, spareless=True, report=replace(found.report, faults=(fault, *found.report.faults)))


def _unread(handle: Atlas, seed: int, faults: list[str]) -> Findings:
    """A store with damaged metadata, through which nothing can be read."""
    told = tuple(StoreFault(None, what) for what in faults)
    return Findings(handle, replace(_begun(handle, seed), comparison="the metadata are damaged", faults=told), True)


def _begun(handle: Atlas, seed: int) -> Report:
    """The report on a store before anything is read."""
    done = len(done_tiles(handle))
    return Report(str(handle.place), handle.tiling.count, done, 0, 0, 0, "no cell is done", seed, faults=(), doubts=())


def _found(handle: Atlas, sample: int, seed: int, notify: Callable[[Progress], None]) -> Findings:
    """The faults of a store, without its zoom levels."""
    tiling = handle.tiling
    notify(Progress("listing the tiles"))
    done = sorted(done_tiles(handle))
    report = _begun(handle, seed)
    if wrong := metadata_faults(handle):
        return _unread(handle, seed, wrong)
    records = Records(handle, done)
    worn = coordinate_faults(handle)
    faults = [StoreFault(None, what) for what in worn]
    foreign = tuple(foreign_keys(handle))
    faults += [StoreFault(None, f"{key} is not a chunk of this atlas") for key in foreign]

    chunks = cells = 0
    samples: list[Sample] = []
    counted: dict[Index, Rows] = {}
    for tile in _read_all(handle, records, done, draw_cells(tiling, done, sample, seed), notify):
        faults += [StoreFault(tile.index, what) for what in tile.faults]
        chunks, cells = chunks + tile.chunks, cells + tile.cells
        samples += tile.samples
        counted |= {tile.index: tile.row} if tile.row is not None else {}
    faults += [StoreFault(index, f"{chunk_key(handle.regime, index)} is missing") for index in records.lost]

    comparison = _comparison(handle, sample, bool(done))
    report = replace(report, chunks=chunks, cells_checked=cells, comparison=comparison)
    doubts: list[StoreFault] = []
    if report.comparison in ("bits", "error"):
        exact = report.comparison == "bits"
        notify(Progress(f"solving {plural(len(samples), 'cell')} again"))
        for k, one in enumerate(samples, 1):
            notify(Progress(f"solving cell {k} of {len(samples)} again", passing=True))
            again = solve_again(handle.spec, one)
            different = unequal(one.stored, again) if exact else beyond_error(handle.spec, one.stored, again)
            if different:
                found = StoreFault(one.tile, f"cell {place_in(handle.spec, one.cell)}: {different}")
                (faults if exact else doubts).append(found)
        report = replace(report, cells_solved=len(samples))
    bad = sorted({fault.tile for fault in faults if fault.tile is not None})
    overviews = check_overviews(handle, set(bad), lambda level: notify(Progress(f"checking overview {level}")))
    faults += [StoreFault(None, what) for what in overviews.faults]
    notify(Progress("checking tables and records"))
    groups = check_groups(handle)
    wrong = record_faults(handle, records, counted)
    faults += [StoreFault(None, what) for what in (*groups.faults, *wrong)]
    report = replace(report, overview_chunks=overviews.chunks, faults=tuple(faults), doubts=tuple(doubts))
    return Findings(
        handle,
        report,
        worn=bool(worn),
        records={index: row for index, row in counted.items() if index not in bad} if wrong else None,
        tiles=tuple(bad),
        overviews=overviews,
        groups=groups,
        foreign=foreign,
    )


def _with_zoom(found: Findings, sample: int, notify: Callable[[Progress], None]) -> Findings:
    """The same with the faults of the zoom levels, whose sheets are stores themselves.

    Of as many sheets as the sample has cells, one cell each is solved again.
    """
    handle, report = found.handle, found.report
    if found.unread:
        return found
    known = sheets(handle)
    planes = {} if handle.place.only_read else plane_faults(handle)
    solved = set(random.Random(report.seed).sample(known, min(sample, len(known))))
    faults, doubts = list(report.faults), list(report.doubts)
    faults += [StoreFault(None, f"{key} {what}") for key, what in planes.items()]
    bad: list[tuple[str, ...]] = [tuple(key.split("/")[1:-1]) for key in planes]
    for k, (plane, sheet) in enumerate(known, 1):
        notify(Progress(f"reading the zoom levels: sheet {k} of {len(known)}", passing=True))
        try:
            place = sheet_place(handle, plane, sheet)
            own = find(place, int((plane, sheet) in solved), report.seed, lambda _: None).report
        except InputError as error:
            faults.append(StoreFault(None, str(error)))
            bad.append((plane, sheet))
            continue
        bad += [(plane, sheet)] if own.faults else []
        for all_of, some in ((faults, own.faults), (doubts, own.doubts)):
            all_of += [StoreFault(None, f"{ZOOM}/{plane}/{sheet}: {fault}") for fault in some]
    report = replace(report, sheets=len(known), faults=tuple(faults), doubts=tuple(doubts))
    return replace(found, report=report, zoom=tuple(bad))


@dataclass(frozen=True)
class _Checked:
    """A tile read: good chunks, cells checked by the rules, what is wrong, and the cells drawn from it.

    ``row`` is its record, by the cells; None where they cannot be read.
    """

    index: Index
    chunks: int
    cells: int
    faults: tuple[str, ...]
    samples: tuple[Sample, ...]
    row: Rows | None = None


def _read_all(
    handle: Atlas,
    records: Records,
    done: list[Index],
    drawn: dict[Index, list[int]],
    notify: Callable[[Progress], None],
) -> Iterator[_Checked]:
    """Read and check the finished tiles, several at once."""
    arrays, tiling = open_arrays(handle), handle.tiling
    _ = records.rows  # before several threads ask for them
    sizes = [tiling.at(index).size for index in done]
    pending = tiling.cells - sum(sizes)  # counted as read, so that the time left is that of reading
    begin = time.perf_counter()
    unfinished = tiling.count - len(done)
    stage = Progress("reading", tiles=tiling.count, cells=tiling.cells, tiles_done=unfinished, cells_done=pending)
    notify(stage)
    with ThreadPoolExecutor(READERS) as readers:
        checked = readers.map(lambda index: _check(handle, arrays, records, index, drawn.get(index, [])), done)
        for read, (tile, cells) in enumerate(zip(checked, accumulate(sizes), strict=True), 1):
            seconds = time.perf_counter() - begin
            tiles = unfinished + read
            notify(replace(stage, tiles_done=tiles, cells_done=pending + cells, cells_solved=cells, seconds=seconds))
            yield tile


def _check(handle: Atlas, arrays: dict[str, Any], records: Records, index: Index, drawn: list[int]) -> _Checked:
    tile = handle.tiling.at(index)
    needed = {each.name for each in (*handle.variables, *ALLOWANCES)} | {*handle.record["attributes"][COVERED]}
    stored = needed & arrays.keys()
    try:
        values = read_tile(handle, index, needed, arrays)
    except ChunkError as error:
        bad = tuple(f"{key} {fault}" for key, fault in error.faults.items())
        return _Checked(index, len(stored) - len(bad), 0, bad, ())
    broken = broken_rules(handle.spec, tile.slices, values)
    faults = tuple(
        f"{text}: {plural(int(mask.sum()), 'cell')}, the first at {place_in(handle.spec, _first(mask, tile.slices))}"
        for text, mask in broken.items()
    )
    row = record_of(handle, index, values)
    faults += tuple(tile_faults(records, index, row))
    samples = []
    for flat in drawn:
        inner = tuple(int(i) for i in np.unravel_index(flat, tile.shape))
        cell = tuple(part.start + i for part, i in zip(tile.slices, inner, strict=True))
        one = tuple(slice(i, i + 1) for i in inner)
        samples.append(Sample(cell, index, {name: array[one].copy() for name, array in values.items()}))
    sparse = [v for v in (*handle.variables, *handle.allowances) if v.sparse and v.name in values]
    chunks = len(stored) - sum(is_blank(values[v.name], v) for v in sparse)
    return _Checked(index, chunks, tile.size, faults, tuple(samples), row)


def _first(mask: np.ndarray, slices: tuple[slice, ...]) -> Index:
    """The first cell of a mask over a tile, as its index in the atlas."""
    return tuple(part.start + int(found[0]) for part, found in zip(slices, np.nonzero(mask), strict=True))


def draw_cells(tiling: Tiling, done: list[Index], count: int, seed: int) -> dict[Index, list[int]]:
    """So many cells of the finished tiles, each as likely as any other: flat indices within their tiles."""
    rng = random.Random(seed)
    ends = list(accumulate(tiling.at(index).size for index in done))
    total = ends[-1] if ends else 0
    drawn: defaultdict[Index, list[int]] = defaultdict(list)
    for flat in sorted(rng.sample(range(total), min(count, total))):
        tile = bisect_right(ends, flat)
        drawn[done[tile]].append(flat - (ends[tile - 1] if tile else 0))
    return drawn


def _comparison(handle: Atlas, sample: int, any_done: bool) -> str:
    """How the cells that are solved again are to be compared, or why none is."""
    if not sample:
        return "none asked for"
    if handle.solver_version != SOLVER_VERSION:
        return f"the store has solver version {handle.solver_version}, this program {SOLVER_VERSION}"
    if handle.spec.continuation is not None:
        return "each cell of a continued sweep depends on those before it"
    if not any_done:
        return "no cell is done"
    return "bits" if {machine.name for machine in machines(handle)} == {this_machine().name} else "error"
