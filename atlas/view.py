"""What a picture or a query reads of an atlas: the cells in view, at the level that matches the pixels, no more.

``view`` is the door: the same dataset that ``atlas.open`` gives, read, and coarsened where cells are finer than
pixels. Data that are not what a store holds (computed, changed, put together) are taken as they are.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.coarsen import (
    CLASSES,
    CODES,
    REGIME_SHOWN,
    SHARE,
    Cells,
    Widths,
    coarsen,
    from_cells,
    halved,
    level_variables,
    needed,
)
from atlas.errors import InputError
from atlas.grid import LOG_SPAN, Window, axis_names, axis_values, edges_of, is_log, within
from atlas.overview import Pyramid, bounds_name, centres, level_widths
from atlas.spec import Slices
from atlas.store import Header, done_tiles, read_header
from workers.results import (
    ERROR,
    FAILED,
    INVALID,
    LARGEST,
    NO_IMPACT,
    PENDING,
    PERIODIC,
    REGIME,
    SUM_LAW_DEFECT,
    UNDETERMINED,
    Variable,
    result_variables,
)

if TYPE_CHECKING:
    import xarray as xr

_EXPONENTS = (LARGEST.name, ERROR.name, SUM_LAW_DEFECT.name)
_WITHOUT = (PENDING, UNDETERMINED, INVALID, FAILED)
"""Regimes without an exponent."""


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


def view(
    ds: "xr.Dataset",
    names: Iterable[str],
    window: Window | None = None,
    pixels: Sequence[int] | None = None,
    marks: bool = True,
) -> "xr.Dataset":
    """The named variables and the regimes of an atlas in a window, at the level that matches the pixels.

    The level is the finest whose cells are not finer than a pixel (the widest of them, where they differ).
    ``pixels`` is the size, (x, y), of the area that they will fill; None for the cells themselves. The answer is an
    atlas too: the same names, dimensions and attributes; where it is coarser, its axes carry CF bounds, ends at the
    window's, and ``encoding["level"]`` tells the level. What coarse cells say is in ``atlas.coarsen``. With ``marks``
    their regime is ``regime_shown``, and cells shown without an exponent, a period or a result have none;
    otherwise it is the most frequent one.
    A name without overviews is read cell by cell. Raises InputError for an unknown axis or a window without a cell.
    """
    ds = within(ds, window)
    wanted = list(dict.fromkeys([*names, REGIME.name]))
    part = find_part(ds, wanted)
    if part is None:
        return ds[wanted]
    known = {variable.name for variable in level_variables(part.header.spec.settings)}
    steps = _steps(ds, pixels) if pixels and known.issuperset(wanted) else [0] * ds[REGIME.name].ndim
    seen = _coarse(ds, part, wanted, steps, marks) if max(steps) else _fine(ds, part, wanted)
    part.tell(steps)
    return seen


def regime_areas(ds: "xr.Dataset", window: Window | None = None) -> dict[int, float] | None:
    """The area of each regime code in a window, cells counted by their widths; None for data not read from a store.

    Exact: the inside of the window is taken from the coarsest level that fits, its border from ever finer ones.
    """
    ds = within(ds, window)
    part = find_part(ds, [REGIME.name])
    if part is None:
        return None
    total = sum((part.areas(level, piece) for level, piece in part.pieces()), np.zeros(CODES.size))
    part.tell()
    return dict(zip(CODES.tolist(), total.tolist(), strict=True))


def find_part(ds: "xr.Dataset", names: Iterable[str]) -> "Part | None":
    """The block of a store that a dataset shows, or None unless each named variable is as ``atlas.open`` gave it.

    Selections of neighbouring cells are; anything computed, changed, loaded or put together is not.
    """
    source = ds.encoding.get("source")
    if not isinstance(source, str):
        return None
    try:
        header = read_header(Path(source))
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
    if name not in ds:
        return False
    if not _on_disk(ds[name].variable):
        return False
    try:
        stored = pyramid.array(0, name)
    except KeyError:
        return False
    # A renamed variable is lazy too, but tells another story than the stored one of that name.
    same = ds[name].attrs.get("long_name") == stored.attrs.get("long_name")
    dims = len(pyramid.levels.shape)
    return bool(same and ds[name].dtype == stored.dtype and ds[name].shape[dims:] == stored.shape[dims:])


def _on_disk(variable: "xr.Variable") -> bool:
    """Whether a variable's values are still those of a Zarr array, neither loaded nor assigned to.

    Xarray has no public word for that, so its wrappers are followed down. Should they change, nothing is found on disk
    and the cells are read from the dataset: slower, never wrong.
    """
    data: Any = getattr(variable, "_data", None)
    while hasattr(data, "array") and not getattr(data, "_copied", False):
        data = data.array
    return type(data).__name__ == "ZarrArrayWrapper"


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
        return level_variables(self.header.spec.settings)

    @cached_property
    def _done(self) -> NDArray[np.bool_]:
        """Which tiles are done, as an array over the tiles."""
        levels = self.pyramid.levels
        done = np.zeros([-(-n // t) for n, t in zip(levels.shape, levels.tile, strict=True)], dtype=bool)
        for index in done_tiles(self.header):
            done[index] = True
        return done

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

        What of an overview is missing is computed from the level before, down to the cells; where no tile is done
        below, it is pending without being looked for.
        """
        wanted = list(names)
        if level == 0:
            stored = {v.name for v in result_variables(self.header.spec.settings)}
            base = stored & {*wanted, *(name.removesuffix("_count") for name in wanted), REGIME.name}
            return from_cells({name: self.pyramid.read(0, name, piece) for name in base}, wanted)
        # Both regimes are written after all that they stand for, so that either tells what is there.
        mark = next(name for name in (REGIME.name, REGIME_SHOWN.name) if name in wanted)
        made = {mark: self._stored(level, piece, mark)}
        missing = [block for block in self._blocks(level, piece) if (made[mark][block] == PENDING).any()]
        made |= {name: self._stored(level, piece, name) for name in wanted if name != mark}
        for block in missing:
            place = tuple(slice(p.start + b.start, p.start + b.stop) for p, b in zip(piece, block, strict=True))
            finer = self.pyramid.levels.finer(level, place)
            if self._any_done(level, place):
                below = self.read(level - 1, finer, self.closed(wanted))
                widths = tuple(w[f] for w, f in zip(self.widths[level - 1], finer, strict=True))
                computed = coarsen(below, widths)
                for name in wanted:
                    made[name][block] = computed[name]
            elif SHARE.name in made:
                made[SHARE.name][(*block, CODES.tolist().index(PENDING))] = 1.0
        return made

    def _stored(self, level: int, piece: Slices, name: str) -> NDArray[Any]:
        if self.pyramid.made:
            return self.pyramid.read(level, name, piece)
        variable = next(v for v in self._variables if v.name == name)
        shape = tuple(p.stop - p.start for p in piece) + tuple(CODES.size for _ in variable.extra)
        return np.full(shape, variable.fill, dtype=variable.dtype)

    def _blocks(self, level: int, piece: Slices) -> Iterator[Slices]:
        """The piece cut along the borders of chunks, counted from its own first cell."""
        along = []
        for p, c in zip(piece, self.pyramid.levels.chunk, strict=True):
            cuts = [p.start, *range((p.start // c + 1) * c, p.stop, c), p.stop]
            along.append([slice(a - p.start, b - p.start) for a, b in itertools.pairwise(cuts)])
        yield from itertools.product(*along)

    def _any_done(self, level: int, place: Slices) -> bool:
        tile = self.pyramid.levels.tile
        tiles = tuple(
            slice((s.start << level) // t, -(-(s.stop << level) // t)) for s, t in zip(place, tile, strict=True)
        )
        return bool(self._done[tiles].any())

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
        """The area of each regime in a piece, in the order of CODES."""
        share = self.read(level, piece, [REGIME.name, SHARE.name])[SHARE.name]
        for width, p in zip(self.widths[level], piece, strict=True):
            share = np.tensordot(width[p], share, axes=1)
        return np.asarray(share)


def _around(outer: Slices, inner: Slices | None) -> Iterator[Slices]:
    """The outer box without the inner one, as boxes."""
    if inner is None:
        yield outer
        return
    for dim, (out, within_) in enumerate(zip(outer, inner, strict=True)):
        for side in (slice(out.start, within_.start), slice(within_.stop, out.stop)):
            if side.start < side.stop:
                yield (*inner[:dim], side, *outer[dim + 1 :])


def _steps(ds: "xr.Dataset", pixels: Sequence[int]) -> list[int]:
    """How many times each dimension is to be halved until its widest cell is not finer than a pixel.

    A quarter of a halving is let pass: better 1.19 cells a pixel than 0.6.
    """
    found = []
    for name, size in zip(axis_names(ds), pixels, strict=False):
        values = axis_values(ds, name)
        log = is_log(ds, name)
        edges = edges_of(values, log)
        drawn = np.log(edges) if log and values[-1] / values[0] >= LOG_SPAN else edges
        cells = (drawn[-1] - drawn[0]) / np.diff(drawn).max()  # that would fit, were all as wide as the widest
        found.append(max(0, math.ceil(math.log2(cells / size) - 0.25)))
    return found[::-1]


def _fine(ds: "xr.Dataset", part: Part, names: Sequence[str]) -> "xr.Dataset":
    read = {name: part.pyramid.read(0, name, part.cells) for name in names}
    pending = read[REGIME.name] == PENDING
    for name in names:
        if pending.any() and name != REGIME.name:  # a worker may be at it: a cell without a regime has no result yet
            read[name][pending] = part.pyramid.array(0, name).fill_value
    arrays = {name: (ds[name].dims, values, ds[name].attrs) for name, values in read.items()}
    return _dataset(ds, arrays, {name: ds[name] for name in axis_names(ds)}, 0)


def _coarse(ds: "xr.Dataset", part: Part, names: Sequence[str], steps: list[int], marks: bool) -> "xr.Dataset":
    shown = [REGIME_SHOWN.name if marks and name == REGIME.name else name for name in names]
    cells, cuts = _coarsened(part, shown, steps)
    cells[REGIME.name] = cells[REGIME_SHOWN.name if marks else REGIME.name]
    if marks:
        _blank(cells)
    coords: dict[str, Any] = {}
    for axis, s, cut in zip(reversed(part.header.spec.axes), part.cells, cuts, strict=True):
        log = axis.scale == "log"
        edges = edges_of(np.array(axis.values), log)[np.clip(cut, s.start, s.stop)]
        bounds = bounds_name(axis.name)
        coords[axis.name] = (axis.name, centres(edges, log), {**ds[axis.name].attrs, "bounds": bounds})
        coords[bounds] = ((axis.name, "bound"), np.stack([edges[:-1], edges[1:]], axis=1))
    level = min(steps)
    return _dataset(ds, {name: (ds[name].dims, cells[name], ds[name].attrs) for name in names}, coords, level)


def _coarsened(part: Part, names: Sequence[str], steps: Sequence[int]) -> tuple[Cells, list[NDArray[np.intp]]]:
    """Variables of a part, each dimension halved so many times, and the cells of the atlas where theirs begin and end.

    What all dimensions have in common is read as a level. A plane long and narrow in pixels is halved further along
    one dimension, some rows at a time.
    """
    level = min(steps)
    more = [count - level for count in steps]
    whole = part.pyramid.levels.shape_of(level)
    ends = zip(part.cells, steps, more, whole, strict=True)
    piece = tuple(slice(s.start >> k << n, min(-(-s.stop >> k) << n, size)) for s, k, n, size in ends)
    cuts = [np.append(np.arange(p.start, p.stop, 2**n), p.stop) << level for p, n in zip(piece, more, strict=True)]
    if not any(more):
        return part.read(level, piece, names), cuts
    rows = math.lcm(part.pyramid.levels.chunk[0], 2 ** more[0])
    made = []
    for first in range(piece[0].start // rows * rows, piece[0].stop, rows):
        block = (slice(max(first, piece[0].start), min(first + rows, piece[0].stop)), *piece[1:])
        cells = part.read(level, block, part.closed(names))
        widths = [w[p] for w, p in zip(part.widths[level], block, strict=True)]
        for dim, count in enumerate(more):
            for _ in range(count):
                cells = coarsen(cells, tuple(widths), [dim])
                widths[dim] = halved(widths[dim])
        made.append({name: cells[name] for name in names})
    return {name: np.concatenate([cells[name] for cells in made]) for name in names}, cuts


def _blank(cells: Cells) -> None:
    """Take from cells what the class they are shown as does not have."""
    shown = cells[REGIME.name]
    for name in cells.keys() - {REGIME.name, REGIME_SHOWN.name, SHARE.name}:
        if name in CLASSES:
            cells[name] = np.where(shown == PERIODIC, cells[name], 0)
        elif cells[name].dtype == np.float64:
            without = _WITHOUT if name in _EXPONENTS else (PENDING, FAILED)
            cells[name] = np.where(np.isin(shown, without), np.nan, cells[name])
    if "period" in cells:
        cells["period"] = np.where(shown == NO_IMPACT, 1, cells["period"])  # by definition


def _dataset(ds: "xr.Dataset", arrays: dict[str, Any], axes: dict[str, Any], level: int) -> "xr.Dataset":
    import xarray

    fixed = {name: ds[name] for name in ds.coords if ds[name].ndim == 0}
    made = xarray.Dataset(arrays, {**axes, **fixed}, ds.attrs)
    made.encoding["level"] = level
    return made
