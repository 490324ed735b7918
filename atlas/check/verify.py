"""Whether a store is what it says: everything in it read and held against everything known of it."""

import os
import random
import time
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np

from atlas.check.foreign import foreign_keys
from atlas.check.metadata import coordinate_faults, metadata_faults
from atlas.check.overviews import check_overviews, drop_unsound
from atlas.check.reproduce import Sample, beyond_error, place_in, solve_again, unequal
from atlas.check.rules import broken_rules
from atlas.errors import ChunkError, InputError
from atlas.overview.pyramid import drop
from atlas.service.lease import claimed
from atlas.service.notebook import reporting
from atlas.service.progress import Progress
from atlas.store.archive import refuse_packed
from atlas.store.machine import this_machine
from atlas.store.schema import ALLOWANCES
from atlas.store.sidecar import notes_of
from atlas.store.store import (
    READERS,
    ZOOM,
    Header,
    done_tiles,
    machines,
    open_arrays,
    open_digests,
    read_header,
    restore_coordinates,
)
from atlas.store.tiles import covered_variables, digest_faults, drop_tile, read_tile
from atlas.store.tiling import Tiling
from atlas.store.zoom import sheet_place, sheets
from atlas.text import plural
from workers import SOLVER_VERSION
from workers.results import FAILED

SAMPLE = 32
SHOWN = 50
"""Faults that a terminal gets to see; ``--json`` has all."""

Index = tuple[int, ...]


@dataclass(frozen=True)
class Fault:
    """Something wrong: the tile it is in, None where it is the store as a whole, and what, in a line."""

    tile: Index | None
    what: str

    def __str__(self) -> str:
        return self.what if self.tile is None else f"tile {self.tile}: {self.what}"


@dataclass(frozen=True)
class Report:
    """What a verification found.

    tiles, tiles_done, chunks    in all; finished; their chunks read whole, their checksums right
    overview_chunks              read whole, and held against the cells below them
    digests                      whether the tiles have digests, by which an exchange of tiles is found
    cells_checked                held against the rules
    cells_solved                 of the sample that was asked for, solved again
    comparison                   "bits", "error", or why none was made
    faults                       proved: damage, contradictions, cells that come out otherwise on the same machine
    doubts                       cells that come out otherwise, beyond their errors, on another kind of machine
    repaired                     tiles made unfinished, so that the next run solves them again
    dropped                      chunks of overviews made missing, so that the next run makes them anew
    removed                      names among the chunks that are none
    sheets                       of the zoom levels, verified as the stores that they are
    """

    store: str
    tiles: int
    tiles_done: int
    chunks: int
    cells_checked: int
    cells_solved: int
    comparison: str
    seed: int
    faults: tuple[Fault, ...]
    doubts: tuple[Fault, ...]
    overview_chunks: int = 0
    digests: bool = True
    repaired: tuple[Index, ...] | None = None
    dropped: int = 0
    removed: tuple[str, ...] = ()
    sheets: int = 0

    @property
    def complete(self) -> bool:
        """Whether every tile is finished."""
        return self.tiles_done == self.tiles

    @property
    def fine(self) -> bool:
        """Whether the store is complete and nothing speaks against it."""
        return self.complete and not self.faults and not self.doubts

    def __str__(self) -> str:
        how = {"bits": "all to the bit", "error": "within error (solved on another kind of machine)"}
        lines = [
            f"tiles    {self.tiles_done} of {self.tiles} done" + ("" if self.complete else "; atlas run completes it"),
            f"chunks   {self.chunks} read, their checksums right",
            f"digests  {'of every tile' if self.digests else 'none, the store is too old: tiles may be exchanged'}",
            f"levels   {plural(self.overview_chunks, 'chunk')} of overviews held against the cells below",
            f"cells    {self.cells_checked} held against the rules",
            f"sample   {plural(self.cells_solved, 'cell')} solved again, compared {how[self.comparison]}"
            if self.comparison in how
            else f"sample   not solved again: {self.comparison}",
        ]
        lines += [f"zoom     {plural(self.sheets, 'sheet')} of explored cells held against the same"] * bool(
            self.sheets
        )
        for title, found in (("found", self.faults), ("in doubt", self.doubts)):
            lines += [f"{title}: {fault}" for fault in found[:SHOWN]]
            lines += [f"and {len(found) - SHOWN} more {title}: --json lists them"] if len(found) > SHOWN else []
        if self.repaired is not None:
            what = f"{plural(len(self.repaired), 'tile')} dropped: run it again to solve them"
            lines.append(what if self.repaired else "no tile to drop")
            if self.dropped:
                lines.append(f"{plural(self.dropped, 'chunk')} of overviews dropped: run it again to make them")
            lines += [f"removed: {key}" for key in self.removed]
        bad = bool(self.faults or self.doubts)
        lines.append("fine" if self.fine else "not fine" if bad else "nothing wrong, but not complete")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """What ``atlas verify --json`` prints."""
        return {
            "store": self.store,
            "fine": self.fine,
            "complete": self.complete,
            "tiles": self.tiles,
            "tiles_done": self.tiles_done,
            "chunks": self.chunks,
            "cells_checked": self.cells_checked,
            "cells_solved": self.cells_solved,
            "comparison": self.comparison,
            "seed": self.seed,
            "faults": [{"tile": fault.tile, "what": fault.what} for fault in self.faults],
            "doubts": [{"tile": fault.tile, "what": fault.what} for fault in self.doubts],
            "overview_chunks": self.overview_chunks,
            "digests": self.digests,
            "repaired": self.repaired,
            "dropped": self.dropped,
            "removed": self.removed,
            "sheets": self.sheets,
        }


def verify(
    store: str | os.PathLike[str],
    sample: int = SAMPLE,
    repair: bool = False,
    seed: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Report:
    """Read a whole store, while no run is at work on it, and report all that is wrong in it.

    Metadata and coordinates are held against the spec; every chunk of every finished tile is read, which checks its
    checksum, and all of a tile against its digest; every cell is held against ``rules``, the sum
    law among them; every chunk of an overview is held against what it stands for. Of ``sample`` cells
    that ``seed`` draws (failed ones left out), the solution is made again: on the kind of machine that solved them
    it has to be the same to the bit, elsewhere within the errors. ``repair`` makes every tile with a fault unfinished,
    drops overviews that are not sound, removes names among the chunks that are none, and writes damaged coordinates
    anew; it touches no tile that is only in doubt.
    Raises InputError where there is no store to verify, OSError where it cannot be read or repaired.
    """
    if sample < 0:
        raise InputError(f"sample: found {sample}, must be 0 or more")
    header = read_header(store)
    if repair:
        refuse_packed(header.place)
    seed = random.SystemRandom().randrange(2**32) if seed is None else seed
    with reporting(on_progress) as report:
        notify = report or (lambda _: None)
        return _with_zoom(_verified(header, sample, repair, seed, notify), header, sample, repair, notify)


def _verified(header: Header, sample: int, repair: bool, seed: int, notify: Callable[[Progress], None]) -> Report:
    tiling = header.tiling
    notify(Progress("listing the tiles"))
    done = sorted(done_tiles(header))
    report = Report(str(header.place), tiling.count, len(done), 0, 0, 0, "no cell is done", seed, faults=(), doubts=())
    faults = [Fault(None, what) for what in metadata_faults(header)]
    if faults:  # whatever is read through wrong metadata means nothing
        return replace(report, comparison="the metadata are damaged", faults=tuple(faults))
    report = replace(report, digests=open_digests(header) is not None)
    worn = coordinate_faults(header)
    faults += [Fault(None, what) for what in worn]
    foreign = tuple(foreign_keys(header))
    faults += [Fault(None, f"{key} is no chunk of this atlas") for key in foreign]

    chunks = cells = 0
    samples: list[Sample] = []
    for tile in _read_all(header, done, draw_cells(tiling, done, sample, seed), notify):
        faults += [Fault(tile.index, what) for what in tile.faults]
        chunks, cells = chunks + tile.chunks, cells + tile.cells
        samples += tile.samples

    comparison = _comparison(header, sample, bool(done))
    report = replace(report, chunks=chunks, cells_checked=cells, comparison=comparison)
    doubts: list[Fault] = []
    if report.comparison in ("bits", "error"):
        exact = report.comparison == "bits"
        notify(Progress(f"solving {plural(len(samples), 'cell')} again"))
        for k, one in enumerate(samples, 1):
            notify(Progress(f"solving cell {k} of {len(samples)} again", passing=True))
            again = solve_again(header.spec, one)
            different = unequal(one.stored, again) if exact else beyond_error(header.spec, one.stored, again)
            if different:
                found = Fault(one.tile, f"cell {place_in(header.spec, one.cell)}: {different}")
                (faults if exact else doubts).append(found)
        report = replace(report, cells_solved=len(samples))
    bad = sorted({fault.tile for fault in faults if fault.tile is not None})
    overviews = check_overviews(header, set(bad), lambda level: notify(Progress(f"checking overview {level}")))
    faults += [Fault(None, what) for what in overviews.faults]
    report = replace(report, overview_chunks=overviews.chunks)
    report = replace(report, faults=tuple(faults), doubts=tuple(doubts))
    if not repair:
        return report
    if worn:
        restore_coordinates(header)
    with claimed(notes_of(header.place), str(header.place)):
        drop_unsound(header, overviews)
        drop(header, bad)  # first: an overview must not outlive what it is of
        for index in bad:
            drop_tile(header, index)
        for key in foreign:
            header.place.remove(key)
    return replace(report, repaired=tuple(bad), dropped=len(overviews.unsound), removed=foreign)


def _with_zoom(report: Report, header: Header, sample: int, repair: bool, notify: Callable[[Progress], None]) -> Report:
    """The report with what is wrong in the zoom levels, whose sheets are stores themselves.

    Of as many sheets as the sample has cells, one cell each is solved again.
    """
    found = sheets(header)
    solved = set(random.Random(report.seed).sample(found, min(sample, len(found))))
    faults, doubts = list(report.faults), list(report.doubts)
    for k, (plane, sheet) in enumerate(found, 1):
        notify(Progress(f"reading the zoom levels: sheet {k} of {len(found)}", passing=True))
        try:
            inner = read_header(sheet_place(header, plane, sheet))
        except InputError as error:
            faults.append(Fault(None, str(error)))
            continue
        own = _verified(inner, int((plane, sheet) in solved), repair, report.seed, lambda _: None)
        for all_of, some in ((faults, own.faults), (doubts, own.doubts)):
            all_of += [Fault(None, f"{ZOOM}/{plane}/{sheet}: {fault}") for fault in some]
    return replace(report, sheets=len(found), faults=tuple(faults), doubts=tuple(doubts))


@dataclass(frozen=True)
class _Checked:
    """A tile read: good chunks, cells held against the rules, what is wrong, and the cells drawn from it."""

    index: Index
    chunks: int
    cells: int
    faults: tuple[str, ...]
    samples: tuple[Sample, ...]


def _read_all(
    header: Header, done: list[Index], drawn: dict[Index, list[int]], notify: Callable[[Progress], None]
) -> Iterator[_Checked]:
    """Read and check the finished tiles, several at once."""
    arrays, digests, tiling = open_arrays(header), open_digests(header), header.tiling
    sizes = [tiling.at(index).size for index in done]
    pending = tiling.cells - sum(sizes)  # counted as read, so that the time left is that of reading
    begin = time.perf_counter()
    unfinished = tiling.count - len(done)
    stage = Progress("reading", tiles=tiling.count, cells=tiling.cells, tiles_done=unfinished, cells_done=pending)
    notify(stage)
    with ThreadPoolExecutor(READERS) as readers:
        checked = readers.map(lambda index: _check(header, arrays, digests, index, drawn.get(index, [])), done)
        for read, (tile, cells) in enumerate(zip(checked, accumulate(sizes), strict=True), 1):
            seconds = time.perf_counter() - begin
            tiles = unfinished + read
            notify(replace(stage, tiles_done=tiles, cells_done=pending + cells, cells_solved=cells, seconds=seconds))
            yield tile


def _check(header: Header, arrays: dict[str, Any], digests: Any | None, index: Index, drawn: list[int]) -> _Checked:
    tile = header.tiling.at(index)
    needed = {each.name for each in (*header.variables, *ALLOWANCES)}
    if digests is not None:
        needed |= {variable.name for variable in covered_variables(header, digests)}
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
    if digests is not None:
        faults += digest_faults(header, digests, index, values)
    samples = []
    for flat in drawn:
        inner = tuple(int(i) for i in np.unravel_index(flat, tile.shape))
        cell = tuple(part.start + i for part, i in zip(tile.slices, inner, strict=True))
        one = tuple(slice(i, i + 1) for i in inner)
        samples.append(Sample(cell, index, {name: array[one].copy() for name, array in values.items()}))
    absent = [v.name for v in (*header.variables, *header.unknown) if v.sparse and v.name in values]
    chunks = len(stored) - sum(1 for name in absent if not values[name].any())
    # A failed cell may be one that ends its process, which is why it was marked so: it is left alone.
    return _Checked(index, chunks, tile.size, faults, tuple(one for one in samples if one.regime != FAILED))


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
        return f"the store is of solver version {header.solver_version}, this program's is {SOLVER_VERSION}"
    if header.spec.continuation is not None:
        return "each cell of a continued sweep depends on those before it"
    if not any_done:
        return "no cell is done"
    return "bits" if {machine.name for machine in machines(header)} == {this_machine().name} else "error"
