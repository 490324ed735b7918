"""Whether a store is what it says: everything in it is read and compared with everything known of it."""

import json
import random
import time
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np

from atlas.arguments import checked_flag, checked_kind, is_whole
from atlas.check.foreign import foreign_keys
from atlas.check.groups import check_groups, mend_groups
from atlas.check.metadata import coordinate_faults, metadata_faults, restore_coordinates
from atlas.check.overviews import check_overviews, drop_unsound
from atlas.check.records import record_faults, tile_faults
from atlas.check.report import Report, StoreFault
from atlas.check.reproduce import Sample, beyond_error, place_in, solve_again, unequal
from atlas.check.rules import broken_rules
from atlas.check.zoom import drop_zoom, plane_faults
from atlas.errors import ChunkError, InputError, shown
from atlas.overview.pyramid import Pyramid
from atlas.overview.upkeep import Overviews
from atlas.service.lease import Claim, claimed
from atlas.service.notebook import reporting
from atlas.service.progress import Progress
from atlas.store.archive import refuse_packed
from atlas.store.location import Given, place_of
from atlas.store.machine import this_machine
from atlas.store.machines import machines
from atlas.store.making import refused
from atlas.store.origin import ALLOWANCES
from atlas.store.place import Place
from atlas.store.record import COVERED, WIDTH, Rows
from atlas.store.records import Records, write_compaction
from atlas.store.sidecar import notes_of
from atlas.store.spare import (
    SPARE,
    copy_metadata,
    mend_by_spare,
    nodes_of,
    packed_spare,
    read_spare,
    remedy,
    spare_faults,
)
from atlas.store.store import (
    READERS,
    ROOT,
    ZOOM,
    Header,
    chunk_key,
    done_tiles,
    header_by,
    open_arrays,
    read_header,
)
from atlas.store.tiles import drop_tile, is_blank, read_tile, record_of
from atlas.store.tiling import Tiling
from atlas.store.zoom import sheet_place, sheets
from atlas.text import plural
from workers import SOLVER_VERSION
from workers.results import REGIME

SAMPLE = 32

Index = tuple[int, ...]


def verify(
    store: Given,
    sample: int = SAMPLE,
    repair: bool = False,
    seed: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Report:
    """Read a whole store, while no run is at work on it, and report all that is wrong in it.

    Metadata and coordinates are compared with the spec; every chunk of every finished tile is read, which checks its
    checksum, and all of a tile against its record; every cell is checked by ``rules``, the sum law among them; every
    chunk of an overview is compared with the cells below it. ``sample`` cells that ``seed`` draws, without failed ones,
    are solved again: on the kind of machine that solved them the results have to be the same to the bit, elsewhere
    within the errors. Tables, curves, records of machines and zoom levels are checked too.
    ``repair``, which holds the store's claim throughout, makes every tile with a fault unfinished, drops overviews,
    tables, curves and zoom levels that are not sound, removes foreign names among the chunks, rewrites damaged
    coordinates and missing overviews of finished tiles, and collects the records of all tiles; it touches no tile that
    is only in doubt.
    Raises InputError where there is no store to verify, OSError where it cannot be read or repaired.

    >>> import atlas
    >>> atlas.verify("plane.zarr", sample=2).fine
    True
    """
    if not is_whole(sample) or sample < 0:
        raise InputError(f"sample: found {shown(sample)}, must be a whole number, 0 or more")
    if seed is not None:
        checked_kind("seed", seed, int, "a whole number")
    checked_flag("repair", repair)
    place = place_of(store)
    if repair:
        refuse_packed(place)
    with refused(place, "read"):
        spare = read_spare(place)
    if spare is None:
        read_header(place)
    seed = random.SystemRandom().randrange(2**32) if seed is None else seed
    with reporting(on_progress) as report, ExitStack() as stack:
        notify = report or (lambda _: None)
        claim = stack.enter_context(claimed(notes_of(place), str(place))) if repair else None
        place = place if claim is None else claim.guard(place)
        lost = _unlike_spare(place, spare)
        told = tuple(StoreFault(None, f"{key} {what}: {remedy(place)}") for key, what in lost.items())
        if spare is not None and lost and claim is None:  # whatever is read through wrong metadata means nothing
            header = header_by(place, spare, nodes_of(spare)[f"{REGIME.name}/{ROOT}"])
            return replace(_begun(header, seed), comparison="the metadata are damaged", faults=told)
        if spare is not None and lost:
            mend_by_spare(place, spare, lost)
        header = read_header(place)
        found = _with_zoom(_verified(header, sample, claim, seed, notify), header, sample, claim, notify)
        if claim is not None and lost:
            if spare is None:
                place.put(SPARE, packed_spare(place.get(ROOT) or b""))
            found = replace(found, mended=(*(f"{key} written again" for key in lost), *found.mended))
        return replace(found, faults=(*told, *found.faults))


def _unlike_spare(place: Place, spare: Mapping[str, Any] | None) -> dict[str, str]:
    """The faults of a store's metadata beside its spare, by their keys; a spare of None is itself the fault."""
    return {SPARE: "is missing or damaged"} if spare is None else spare_faults(place, spare)


def _begun(header: Header, seed: int) -> Report:
    """The report on a store before anything is read."""
    done = len(done_tiles(header))
    return Report(str(header.place), header.tiling.count, done, 0, 0, 0, "no cell is done", seed, faults=(), doubts=())


def _verified(
    header: Header, sample: int, claim: Claim | None, seed: int, notify: Callable[[Progress], None]
) -> Report:
    """The report on a store; repaired where its claim is given."""
    tiling = header.tiling
    notify(Progress("listing the tiles"))
    done = sorted(done_tiles(header))
    report = _begun(header, seed)
    faults = [StoreFault(None, what) for what in metadata_faults(header)]
    if faults:  # whatever is read through wrong metadata means nothing
        report = replace(report, comparison="the metadata are damaged", faults=tuple(faults))
        return report if claim is None else _with_metadata(header, report)
    records = Records(header, done)
    worn = coordinate_faults(header)
    faults += [StoreFault(None, what) for what in worn]
    foreign = tuple(foreign_keys(header))
    faults += [StoreFault(None, f"{key} is not a chunk of this atlas") for key in foreign]

    chunks = cells = 0
    samples: list[Sample] = []
    counted: dict[Index, Rows] = {}
    for tile in _read_all(header, records, done, draw_cells(tiling, done, sample, seed), notify):
        faults += [StoreFault(tile.index, what) for what in tile.faults]
        chunks, cells = chunks + tile.chunks, cells + tile.cells
        samples += tile.samples
        counted |= {tile.index: tile.row} if tile.row is not None else {}
    faults += [StoreFault(index, f"{chunk_key(header.regime, index)} is missing") for index in records.lost]

    comparison = _comparison(header, sample, bool(done))
    report = replace(report, chunks=chunks, cells_checked=cells, comparison=comparison)
    doubts: list[StoreFault] = []
    if report.comparison in ("bits", "error"):
        exact = report.comparison == "bits"
        notify(Progress(f"solving {plural(len(samples), 'cell')} again"))
        for k, one in enumerate(samples, 1):
            notify(Progress(f"solving cell {k} of {len(samples)} again", passing=True))
            again = solve_again(header.spec, one)
            different = unequal(one.stored, again) if exact else beyond_error(header.spec, one.stored, again)
            if different:
                found = StoreFault(one.tile, f"cell {place_in(header.spec, one.cell)}: {different}")
                (faults if exact else doubts).append(found)
        report = replace(report, cells_solved=len(samples))
    bad = sorted({fault.tile for fault in faults if fault.tile is not None})
    overviews = check_overviews(header, set(bad), lambda level: notify(Progress(f"checking overview {level}")))
    faults += [StoreFault(None, what) for what in overviews.faults]
    notify(Progress("checking tables and records"))
    groups = check_groups(header)
    wrong = record_faults(header, records, counted)
    faults += [StoreFault(None, what) for what in (*groups.faults, *wrong)]
    report = replace(report, overview_chunks=overviews.chunks)
    report = replace(report, faults=tuple(faults), doubts=tuple(doubts))
    if claim is None:
        return report
    if worn:
        restore_coordinates(header)
    drop_unsound(header, overviews)
    Pyramid(header).drop(bad)  # first: an overview must not outlive what it is of
    for index in bad:
        drop_tile(header, index)
    for key in foreign:
        header.place.remove(key)
    mended = tuple(mend_groups(header, groups))
    sound = {index: row for index, row in counted.items() if index not in bad}
    loose = any(records.done[index] for index in records.single)
    if wrong or bad or loose or not records.known[records.done].all():
        mended += tuple(_put_together(header, sound))
    notify(Progress("writing overviews"))
    made = Overviews(header).finish()
    mended += (f"{plural(made, 'chunk')} of overviews written",) if made else ()
    return replace(report, repaired=tuple(bad), dropped=len(overviews.unsound), removed=foreign, mended=mended)


def _put_together(header: Header, sound: dict[Index, Rows]) -> Iterator[str]:
    """Write the records of sound tiles anew by their cells, all together; a line about it."""
    rows, settled = np.zeros((*header.tiling.grid, WIDTH)), np.zeros(header.tiling.grid, dtype=bool)
    for index, row in sound.items():
        rows[index], settled[index] = row, True
    write_compaction(header, rows, settled)
    yield f"records of {plural(len(sound), 'tile')} collected"


def _with_metadata(header: Header, report: Report) -> Report:
    """The report after the root's copies of the metadata of its arrays were made again from these."""
    root = json.loads(header.place.get(ROOT) or b"{}")
    copy_metadata(header.place, root)
    left = metadata_faults(read_header(header.place))
    mended = () if left else (f"{ROOT}: its consolidated metadata written again: verify the store again",)
    return replace(report, repaired=(), mended=mended)


def _with_zoom(
    report: Report, header: Header, sample: int, claim: Claim | None, notify: Callable[[Progress], None]
) -> Report:
    """The report with what is wrong in the zoom levels, whose sheets are stores themselves; a repair drops these.

    Of as many sheets as the sample has cells, one cell each is solved again.
    """
    found = sheets(header)
    planes = {} if header.place.only_read else plane_faults(header)
    solved = set(random.Random(report.seed).sample(found, min(sample, len(found))))
    faults, doubts = list(report.faults), list(report.doubts)
    faults += [StoreFault(None, f"{key} {what}") for key, what in planes.items()]
    bad: list[tuple[str, ...]] = [tuple(key.split("/")[1:-1]) for key in planes]
    for k, (plane, sheet) in enumerate(found, 1):
        notify(Progress(f"reading the zoom levels: sheet {k} of {len(found)}", passing=True))
        try:
            inner = read_header(sheet_place(header, plane, sheet))
            lost = _unlike_spare(inner.place, read_spare(inner.place))
        except InputError as error:
            faults.append(StoreFault(None, str(error)))
            bad.append((plane, sheet))
            continue
        own = _verified(inner, int((plane, sheet) in solved), None, report.seed, lambda _: None)
        own = replace(own, faults=(*(StoreFault(None, f"{key} {fault}") for key, fault in lost.items()), *own.faults))
        bad += [(plane, sheet)] if own.faults else []
        for all_of, some in ((faults, own.faults), (doubts, own.doubts)):
            all_of += [StoreFault(None, f"{ZOOM}/{plane}/{sheet}: {fault}") for fault in some]
    mended = list(report.mended)
    if claim is not None and bad:
        drop_zoom(header, bad)
        mended += [f"{ZOOM}/{ROOT} written again"] * (() in bad)
        if dropped := {*bad} - {()}:
            mended.append(f"{ZOOM}: {plural(len(dropped), 'folder')} dropped: the explorer solves again what it shows")
    return replace(report, sheets=len(found), faults=tuple(faults), doubts=tuple(doubts), mended=tuple(mended))


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
    header: Header,
    records: Records,
    done: list[Index],
    drawn: dict[Index, list[int]],
    notify: Callable[[Progress], None],
) -> Iterator[_Checked]:
    """Read and check the finished tiles, several at once."""
    arrays, tiling = open_arrays(header), header.tiling
    _ = records.rows  # before several threads ask for them
    sizes = [tiling.at(index).size for index in done]
    pending = tiling.cells - sum(sizes)  # counted as read, so that the time left is that of reading
    begin = time.perf_counter()
    unfinished = tiling.count - len(done)
    stage = Progress("reading", tiles=tiling.count, cells=tiling.cells, tiles_done=unfinished, cells_done=pending)
    notify(stage)
    with ThreadPoolExecutor(READERS) as readers:
        checked = readers.map(lambda index: _check(header, arrays, records, index, drawn.get(index, [])), done)
        for read, (tile, cells) in enumerate(zip(checked, accumulate(sizes), strict=True), 1):
            seconds = time.perf_counter() - begin
            tiles = unfinished + read
            notify(replace(stage, tiles_done=tiles, cells_done=pending + cells, cells_solved=cells, seconds=seconds))
            yield tile


def _check(header: Header, arrays: dict[str, Any], records: Records, index: Index, drawn: list[int]) -> _Checked:
    tile = header.tiling.at(index)
    needed = {each.name for each in (*header.variables, *ALLOWANCES)} | {*header.record["attributes"][COVERED]}
    stored = needed & arrays.keys()
    try:
        values = read_tile(header, index, needed, arrays)
    except ChunkError as error:
        bad = tuple(f"{key} {fault}" for key, fault in error.faults.items())
        return _Checked(index, len(stored) - len(bad), 0, bad, ())
    broken = broken_rules(header.spec, tile.slices, values)
    faults = tuple(
        f"{text}: {plural(int(mask.sum()), 'cell')}, the first at {place_in(header.spec, _first(mask, tile.slices))}"
        for text, mask in broken.items()
    )
    row = record_of(header, index, values)
    faults += tuple(tile_faults(records, index, row))
    samples = []
    for flat in drawn:
        inner = tuple(int(i) for i in np.unravel_index(flat, tile.shape))
        cell = tuple(part.start + i for part, i in zip(tile.slices, inner, strict=True))
        one = tuple(slice(i, i + 1) for i in inner)
        samples.append(Sample(cell, index, {name: array[one].copy() for name, array in values.items()}))
    sparse = [v for v in (*header.variables, *header.unknown, *header.allowances) if v.sparse and v.name in values]
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


def _comparison(header: Header, sample: int, any_done: bool) -> str:
    """How the cells that are solved again are to be compared, or why none is."""
    if not sample:
        return "none asked for"
    if header.solver_version != SOLVER_VERSION:
        return f"the store has solver version {header.solver_version}, this program {SOLVER_VERSION}"
    if header.spec.continuation is not None:
        return "each cell of a continued sweep depends on those before it"
    if not any_done:
        return "no cell is done"
    return "bits" if {machine.name for machine in machines(header)} == {this_machine().name} else "error"
