"""A block of the cells of a store: how it is found behind a dataset, how its levels are read, what reading cost."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, InputError
from atlas.overview.coarsen import CODES, SHARE, Cells, Widths, coarsen, from_cells, level_variables, needed
from atlas.overview.pyramid import MARKS, Pyramid, level_widths
from atlas.query.window import axis_values
from atlas.spec.spec import Slices
from atlas.store.store import Header, read_header
from atlas.store.tally import AREAS, BY_REASON, Entries, done_mask, read_tally, tile_areas
from workers.results import NO_REASON, PENDING, REASON, REASONS, REGIME, Variable

if TYPE_CHECKING:
    import xarray as xr


@dataclass
class Reads:
    """What was read inside ``counted``.

    chunks   how many were found and read
    level    the coarsest that a view was read from, 0 the cells themselves
    block    cells of the atlas, (x, y), for which a cell of the coarsest view stands
    """

    chunks: int = 0
    level: int = 0
    block: tuple[int, ...] = (1,)

    def add(self, chunks: int, level: int, block: tuple[int, ...]) -> None:
        """Count some more."""
        self.chunks, self.level = self.chunks + chunks, max(self.level, level)
        self.block = max(self.block, block, key=math.prod)


_reads: ContextVar[Reads | None] = ContextVar("reads", default=None)


@contextmanager
def counted() -> Iterator[Reads]:
    """Count the chunks that views and fractions read inside the ``with`` block; a block around it counts them too."""
    outer, reads = _reads.get(), Reads()
    token = _reads.set(reads)
    try:
        yield reads
    finally:
        _reads.reset(token)
        if outer is not None:
            outer.add(reads.chunks, reads.level, reads.block)


def find_part(ds: "xr.Dataset", names: Iterable[str]) -> "Part | None":
    """The block of a store that a dataset shows, or None unless each named variable is as ``atlas.open`` gave it.

    Selections of neighbouring cells are; anything computed, changed, loaded or put together is not.
    """
    source = ds.encoding.get("source")
    if not isinstance(source, str):
        return None
    try:
        header = read_header(source)
    except InputError:
        return None
    if ds[REGIME.name].dims != header.spec.dims:
        return None
    cells = [_place(np.array(axis.values), axis_values(ds, axis.name)) for axis in reversed(header.spec.axes)]
    pyramid = Pyramid(header)
    if any(place is None for place in cells) or not all(_untouched(ds, name, pyramid) for name in names):
        return None
    return Part(header, tuple(place for place in cells if place is not None), pyramid)


def _place(full: NDArray[np.float64], values: NDArray[np.float64]) -> slice | None:
    """Where values stand, one after the other, among all values of an axis."""
    first = int(np.searchsorted(full, values[0])) if values.size else full.size
    found = full[first : first + values.size]
    return slice(first, first + values.size) if values.size and np.array_equal(found, values) else None


def _untouched(ds: "xr.Dataset", name: str, pyramid: Pyramid) -> bool:
    """Whether a variable's values are still, whole in their inner dimensions, those of the stored one of its name."""
    if name not in ds:
        return False
    # Xarray has no public word for "neither loaded nor assigned to, and from where": its wrappers are followed down to
    # the Zarr array. Should they change, none is found, and the cells are read from the dataset: slower, never wrong.
    data: Any = getattr(ds[name].variable, "_data", None)
    while hasattr(data, "array") and not getattr(data, "_copied", False):
        data = data.array
    array = getattr(data, "_array", None)
    dims = len(pyramid.levels.shape)
    return array is not None and pyramid.holds(array, name) and bool(ds[name].shape[dims:] == array.shape[dims:])


@dataclass(frozen=True)
class Part:
    """A block of the cells of a store, and how its levels are read."""

    header: Header
    cells: Slices
    pyramid: Pyramid = field(repr=False)

    @cached_property
    def widths(self) -> list[Widths]:
        """Widths of the cells of every level along each dimension."""
        return level_widths(self.header)

    @cached_property
    def _variables(self) -> tuple[Variable, ...]:
        return level_variables(self.header.variables)

    @cached_property
    def _done(self) -> NDArray[np.bool_]:
        """Which tiles are done, as an array over the tiles."""
        return done_mask(self.header)

    @cached_property
    def _tally(self) -> tuple[Entries, NDArray[np.bool_]]:
        """The tally's entries, those of tiles that are not done made up, and the mask of the tiles that have one."""
        pending = ~self._done
        entries, known = read_tally(self.pyramid.root, self.header.tiling)
        entries[pending] = 0.0
        entries[pending, AREAS.start + CODES.tolist().index(PENDING)] = tile_areas(self.header)[pending]
        return entries, known | pending

    def tell(self, steps: Sequence[int] = (0,)) -> None:
        """Add what was read to the count around, if there is one; the steps are those of a view."""
        reads = _reads.get()
        if reads is not None:
            reads.add(self.pyramid.chunks_read, min(steps), tuple(2**count for count in reversed(steps)))

    def closed(self, names: Iterable[str]) -> list[str]:
        """All variables that coarsening these takes."""
        return needed(self._variables, names)

    def read(self, level: int, piece: Slices, names: Iterable[str]) -> Cells:
        """Variables of a piece of a level, a regime among them.

        What of an overview is missing, damaged or out of date, as it is over a tile that is not done any more, is
        computed from the level before, down to the cells; where no tile is done below, it is pending. Raises
        ChunkError where a chunk of the cells themselves is missing or damaged.
        """
        wanted = list(names)
        if level == 0:
            stored = {v.name for v in self.header.variables}
            base = stored & {*wanted, *(name.removesuffix("_count") for name in wanted), REGIME.name}
            return from_cells({name: self.pyramid.read(0, name, piece) for name in base}, wanted)
        made, missing = self._stored(level, piece, wanted)
        for block in missing:
            place = _within(piece, block)
            finer = self.pyramid.levels.finer(level, place)
            if self._below(level, place).any():
                below = self.read(level - 1, finer, self.closed(wanted))
                widths = tuple(w[f] for w, f in zip(self.widths[level - 1], finer, strict=True))
                computed = coarsen(below, widths)
                for name in wanted:
                    made[name][block] = computed[name]
            elif SHARE.name in made:
                made[SHARE.name][(*block, CODES.tolist().index(PENDING))] = 1.0
        return made

    def _stored(self, level: int, piece: Slices, names: Sequence[str]) -> tuple[Cells, list[Slices]]:
        """Variables of a piece of a level as stored, and the blocks of it of which that is not to be believed."""
        blocks = list(self._blocks(level, piece))
        mark = next(mark.name for mark in MARKS if mark.name in names)
        try:
            if self.pyramid.made:
                # The mark first: what was there before it is there, though a run may be writing all of it right now.
                ordered = dict.fromkeys((mark, *names))
                made = {name: self.pyramid.read(level, name, piece) for name in ordered}
                missing = [b for b in blocks if not self._is_current(level, _within(piece, b), made[mark][b])]
                return made, missing
        except ChunkError:
            if len(blocks) > 1:  # which of them is bad shows when each is read alone
                return self._stored_each(level, piece, names, blocks)
        return {name: self._pending(piece, name) for name in names}, blocks

    def _stored_each(
        self, level: int, piece: Slices, names: Sequence[str], blocks: Iterable[Slices]
    ) -> tuple[Cells, list[Slices]]:
        made, missing = {name: self._pending(piece, name) for name in names}, []
        for block in blocks:
            cells, bad = self._stored(level, _within(piece, block), names)
            missing += [block] if bad else []
            for name in names:
                made[name][block] = cells[name]
        return made, missing

    def _pending(self, piece: Slices, name: str) -> NDArray[Any]:
        variable = next(v for v in self._variables if v.name == name)
        shape = tuple(p.stop - p.start for p in piece) + tuple(CODES.size for _ in variable.extra)
        return np.full(shape, variable.fill, dtype=variable.dtype)

    def _is_current(self, level: int, place: Slices, marks: NDArray[Any]) -> bool:
        """Whether an overview has all of a place, and every tile below it is still done."""
        return not (marks == PENDING).any() and bool(self._below(level, place).all())

    def _blocks(self, level: int, piece: Slices) -> Iterator[Slices]:
        """The piece cut along the borders of chunks, counted from its own first cell."""
        along = []
        for p, c in zip(piece, self.pyramid.levels.chunk, strict=True):
            cuts = [p.start, *range((p.start // c + 1) * c, p.stop, c), p.stop]
            along.append([slice(a - p.start, b - p.start) for a, b in itertools.pairwise(cuts)])
        yield from itertools.product(*along)

    def undone(self, level: int, place: Slices) -> list[tuple[int, ...]]:
        """The tiles below a place of a level that are not done."""
        tile = self.pyramid.levels.tile
        first = [(s.start << level) // t for s, t in zip(place, tile, strict=True)]
        return [tuple(np.add(first, at).tolist()) for at in np.argwhere(~self._below(level, place))]

    def _below(self, level: int, place: Slices) -> NDArray[np.bool_]:
        """Which of the tiles below a place of a level are done."""
        tile = self.pyramid.levels.tile
        tiles = tuple(
            slice((s.start << level) // t, -(-(s.stop << level) // t)) for s, t in zip(place, tile, strict=True)
        )
        return self._done[tiles]

    def pieces(self) -> Iterator[tuple[int, Slices]]:
        """The part cut into pieces of whole cells of levels, as coarse as they fit."""
        levels = self.pyramid.levels
        inner: Slices | None = None
        for level in range(levels.count, -1, -1):
            shape = levels.shape_of(level)
            outer = tuple(
                slice(-(-s.start >> level), n if s.stop == whole else s.stop >> level)
                for s, n, whole in zip(self.cells, shape, levels.shape, strict=True)
            )
            if all(s.start < s.stop for s in outer):
                yield from ((level, piece) for piece in _around(outer, inner))
                inner = levels.finer(level, outer) if level else None

    def areas(self, level: int, piece: Slices) -> NDArray[np.float64]:
        """The area of each regime in a piece, in the order of CODES.

        What of an overview is missing is taken from the tally, or from the level before, down to the cells.
        """
        if level == 0:
            return self._areas_of_cells(piece)
        made, missing = self._stored(level, piece, [REGIME.name, SHARE.name])
        share = made[SHARE.name]
        for block in missing:
            share[block] = 0.0
        total = self._weighed(level, piece, share)
        for block in missing:
            place = _within(piece, block)
            finer = self.pyramid.levels.finer(level, place)
            tiles = self._tiles(level, place)
            whole = tiles is not None and self._tally[1][tiles].all()
            total = total + (self._tallied(tiles) if tiles and whole else self.areas(level - 1, finer))
        return total

    def _areas_of_cells(self, piece: Slices) -> NDArray[np.float64]:
        """The areas in a piece of the cells themselves: by the tally in whole tiles that have an entry there."""
        levels = self.pyramid.levels
        tiles = tuple(
            slice(-(-s.start // t), -(-n // t) if s.stop == n else s.stop // t)
            for s, t, n in zip(piece, levels.tile, levels.shape, strict=True)
        )
        if any(s.start >= s.stop for s in tiles) or not self._tally[1][tiles].any():
            return self._read_areas(piece)
        ends = zip(tiles, levels.tile, levels.shape, strict=True)
        inner = tuple(slice(s.start * t, min(s.stop * t, n)) for s, t, n in ends)
        total = self._tallied(tiles)
        for side in _around(piece, inner):
            total = total + self._read_areas(side)
        for index in np.argwhere(~self._tally[1][tiles]) + [s.start for s in tiles]:
            total = total + self._read_areas(self.header.tiling.at(tuple(index.tolist())).slices)
        return total

    def _tiles(self, level: int, piece: Slices) -> Slices | None:
        """The tiles that a piece of a level is made of, None where it cuts through one."""
        levels = self.pyramid.levels
        cells = [slice(s.start << level, min(s.stop << level, n)) for s, n in zip(piece, levels.shape, strict=True)]
        ends = list(zip(cells, levels.tile, levels.shape, strict=True))
        if any(s.start % t or (s.stop % t and s.stop < n) for s, t, n in ends):
            return None
        return tuple(slice(s.start // t, -(-s.stop // t)) for s, t, _ in ends)

    def _tallied(self, tiles: Slices) -> NDArray[np.float64]:
        """The areas in those of some tiles that have an entry in the tally."""
        entries, known = self._tally
        return np.asarray(entries[tiles][known[tiles]][:, AREAS].sum(axis=0))

    def _read_areas(self, piece: Slices) -> NDArray[np.float64]:
        return self._weighed(0, piece, self.read(0, piece, [REGIME.name, SHARE.name])[SHARE.name])

    def _weighed(self, level: int, piece: Slices, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """The area of each regime, from its shares of the cells of a piece."""
        for width, p in zip(self.widths[level], piece, strict=True):
            share = np.tensordot(width[p], share, axes=1)
        return np.asarray(share)

    def reasons(self) -> NDArray[np.int64]:
        """Cells of the part by reason, in the order of the table: by the tally where whole tiles have an entry there.

        Of other tiles, those at the part's border with an entry that has reasons, the reasons are read.
        """
        levels = self.pyramid.levels
        entries, known = self._tally
        inside = [
            (np.arange(-(-n // t)) * t >= s.start) & (np.minimum(np.arange(1, -(-n // t) + 1) * t, n) <= s.stop)
            for s, t, n in zip(self.cells, levels.tile, levels.shape, strict=True)
        ]
        whole = known & reduce(np.logical_and.outer, inside)
        total = entries[whole][:, BY_REASON].sum(axis=0).astype(np.int64)
        none = entries[..., BY_REASON][..., NO_REASON] == entries[..., BY_REASON].sum(axis=-1)
        met = np.zeros(known.shape, dtype=bool)
        met[tuple(slice(s.start // t, -(-s.stop // t)) for s, t in zip(self.cells, levels.tile, strict=True))] = True
        for index in np.argwhere(met & ~whole & self._done & ~(known & none)).tolist():
            ends = zip(self.header.tiling.at(tuple(index)).slices, self.cells, strict=True)
            piece = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in ends)
            codes = self.pyramid.read(0, REASON.name, piece)
            total += [np.count_nonzero(codes == reason.code) for reason in REASONS]
        return total


def _within(piece: Slices, block: Slices) -> Slices:
    """A block of a piece, counted from the piece's first cell, as cells of the level."""
    return tuple(slice(p.start + b.start, p.start + b.stop) for p, b in zip(piece, block, strict=True))


def _around(outer: Slices, inner: Slices | None) -> Iterator[Slices]:
    """The outer box without the inner one, as boxes."""
    if inner is None:
        yield outer
        return
    for dim, (out, within_) in enumerate(zip(outer, inner, strict=True)):
        for side in (slice(out.start, within_.start), slice(within_.stop, out.stop)):
            if side.start < side.stop:
                yield (*inner[:dim], side, *outer[dim + 1 :])
