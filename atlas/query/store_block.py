"""The block of a store that a dataset shows, and reading it at any level of the overviews.

Overviews are copies of the cells at ever lower resolution. Queries and pictures read them instead of cells wherever a
dataset is still an unmodified selection of a store.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, InputError
from atlas.overview.coarsen import CODES, SHARE, Cells, coarsen, from_cells, required_variables
from atlas.overview.pyramid import MARKS, Pyramid, pyramid_of
from atlas.query.open import LAYERS, handle_of
from atlas.query.window import axis_values
from atlas.spec.axis import Axis
from atlas.spec.spec import MAX_AXES, Slices
from atlas.store.store import AtlasStore
from atlas.store.tile_records import TileRecords
from workers.results import PENDING, REGIME

if TYPE_CHECKING:
    import xarray as xr

PENDING_SHARE = CODES.tolist().index(PENDING)
"""Index of the regime pending among the shares of the regimes in a coarse cell."""


def find_part(ds: "xr.Dataset", names: Iterable[str]) -> "StoreBlock | None":
    """Return the block of a store that a dataset shows.

    Return None if one of the named variables is not as ``atlas.open`` returned it. Selections of consecutive cells
    qualify; computed, modified, loaded or concatenated variables do not.
    """
    try:
        handle = handle_of(ds)
    except InputError:
        return None
    dims, spec = ds[REGIME.name].dims, handle.spec
    if dims != spec.dims and not (len(spec.dims) == MAX_AXES and dims == spec.dims[1:] and spec.dims[0] in ds.coords):
        return None
    axes = reversed(spec.axes)
    cells = [_neighbours(np.array(axis.values), np.atleast_1d(axis_values(ds, axis.name))) for axis in axes]
    if any(run is None for run in cells) or not all(_is_untouched(ds, name, handle) for name in names):
        return None
    runs, pyramid = tuple(run for run in cells if run is not None), pyramid_of(handle)
    return StoreBlock(handle, runs, pyramid, dims != spec.dims, pyramid.chunks_read)


def _neighbours(full: NDArray[np.float64], values: NDArray[np.float64]) -> slice | None:
    """Return the slice that ``values`` take among all values ``full`` of an axis; None if they are not consecutive."""
    first = int(np.searchsorted(full, values[0])) if values.size else full.size
    section = full[first : first + values.size]
    return slice(first, first + values.size) if values.size and np.array_equal(section, values) else None


def _is_untouched(ds: "xr.Dataset", name: str, handle: AtlasStore) -> bool:
    """Return True if a variable is still the lazily opened array of the store, with all its inner dimensions.

    To find out, the first value of the variable is requested while chunk reads are skipped. An unmodified variable asks
    for the stored array; a computed, loaded or assigned variable does not. A Dask array is recognized by its graph.
    """
    from atlas.overview.verifying_store import skip_chunk_reads  # imports Zarr, which is slow

    stored = handle.nodes.get(name)
    if name not in ds or stored is None:
        return False
    variable = ds[name].variable
    if variable.chunks is not None:
        untouched = _is_selected(variable.data, ds.encoding.get(LAYERS, {}).get(name))
    else:
        with skip_chunk_reads() as requested:
            _ = variable[(0,) * variable.ndim].values
        untouched = requested == {(handle.backend, name)}
    inner = list(variable.shape[ds[REGIME.name].ndim :])
    return untouched and inner == list(stored["shape"][len(handle.spec.shape) :])


def _is_selected(array: Any, opened: list[str] | None) -> bool:
    """Return True if a Dask array is a stored array as it was opened, or a selection of it.

    ``opened`` are the layers of the graph that the array had when it was opened.
    """
    layers = set(array.dask.layers)
    if opened is None or not layers.issuperset(opened):
        return False
    return all(layer.startswith("getitem-") for layer in layers.difference(opened))


@dataclass(frozen=True)
class StoreBlock:
    """A block of cells of a store, and how to read it at each level of the overviews.

    handle           handle of the store
    cells            slices of the block along the dimensions of the store
    pyramid          the store's overviews
    drops_stack_dim  True if the dataset is one plane of a stack and lacks the stack dimension, which the block has
    chunks_before    number of chunks that the pyramid had read when the block was found

    Level 0 are the cells themselves; each further level halves their number along the dimensions. A ``piece`` is a
    rectangular part of the cells of one level, given by slices.
    """

    handle: AtlasStore
    cells: Slices
    pyramid: Pyramid = field(repr=False)
    drops_stack_dim: bool = False
    chunks_before: int = field(default=0, repr=False)

    @property
    def chunks_read(self) -> int:
        """Number of chunks found and read since the block was found."""
        return self.pyramid.chunks_read - self.chunks_before

    def as_given(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return an array over the cells of the block, with the dataset's dimensions instead of the store's."""
        return values[0] if self.drops_stack_dim else values

    @property
    def axes(self) -> tuple[tuple[Axis, slice], ...]:
        """The axes of the dataset, in the order of its dimensions, with the slice of the block's cells along each."""
        axes = zip(reversed(self.handle.spec.axes), self.cells, strict=True)
        return tuple(axes)[1 if self.drops_stack_dim else 0 :]

    @cached_property
    def records(self) -> TileRecords:
        """The tile records of the store: digest and counts of each tile."""
        return TileRecords(self.handle)

    @property
    def finished_mask(self) -> NDArray[np.bool_]:
        """The mask of the store's tiles that are solved and written."""
        return self.records.finished_mask

    def required_variables(self, names: Iterable[str]) -> list[str]:
        """Return the names of all variables that are needed to compute coarser values of the variables ``names``."""
        return required_variables(self.pyramid.variables, names)

    def undone(self, level: int, piece: Slices) -> list[tuple[int, ...]]:
        """Return the indices of the unfinished tiles below the cells ``piece`` of an overview level."""
        tiles = self.pyramid.levels.tiles_below(level, piece)
        return [
            tuple(s.start + i for s, i in zip(tiles, at, strict=True))
            for at in np.argwhere(~self.finished_mask[tiles]).tolist()
        ]

    def read(self, level: int, piece: Slices, names: Iterable[str]) -> Cells:
        """Read variables of the cells ``piece`` of an overview level, by name; ``names`` must contain a regime.

        Level 0 are the stored cells, each further level is a copy at lower resolution. Chunks of an overview that are
        missing, damaged or older than their tiles are recomputed from the level below, down to the cells. Cells of
        unfinished tiles are pending. Raise ChunkError if a chunk of the cells themselves is missing or damaged.
        """
        requested = list(names)
        if level == 0:
            return self._read_cells(piece, requested)
        arrays, missing = self.read_stored(level, piece, requested)
        for block in missing:
            at = relative_slices(piece, block)
            if self.finished_mask[self.pyramid.levels.tiles_below(level, block)].any():
                computed = self._compute(level, block, requested)
                for name in requested:
                    arrays[name][at] = computed[name]
            elif SHARE.name in arrays:
                arrays[SHARE.name][(*at, PENDING_SHARE)] = 1.0
        return arrays

    def read_stored(self, level: int, piece: Slices, names: Sequence[str]) -> tuple[Cells, list[Slices]]:
        """Return stored variables of the cells ``piece`` of an overview level, and the slices that must not be used.

        Variables are given by name. A slice must not be used if its data are missing, damaged or older than the tiles
        below it.
        """
        blocks = list(self._blocks(level, piece))
        if not self.pyramid.exists:
            return self._pending(piece, names), blocks
        mark = next(mark.name for mark in MARKS if mark.name in names)
        try:
            # Marks are read first: data older than a mark are complete, even if a run is writing now.
            arrays = {name: self.pyramid.read(level, name, piece) for name in dict.fromkeys((mark, *names))}
        except ChunkError:
            return self._read_each(level, piece, names, blocks)
        return arrays, [
            block for block in blocks if not self._is_current(level, block, arrays[mark][relative_slices(piece, block)])
        ]

    def _read_each(
        self, level: int, piece: Slices, names: Sequence[str], blocks: list[Slices]
    ) -> tuple[Cells, list[Slices]]:
        """Return stored variables of cells of an overview level with a damaged chunk, and the slices not to be used.

        Arguments and results are those of ``read_stored``. ``blocks`` are the parts of ``piece`` in each chunk. Each is
        read by itself, which finds the damaged ones.
        """
        arrays, missing = self._pending(piece, names), blocks
        if len(blocks) > 1:
            missing = []
            for block in blocks:
                alone, bad = self.read_stored(level, block, names)
                missing += bad
                for name in names:
                    arrays[name][relative_slices(piece, block)] = alone[name]
        return arrays, missing

    def _read_cells(self, piece: Slices, names: list[str]) -> Cells:
        """Read variables of the stored cells ``piece``, given by slices, and return them by name."""
        stored = {variable.name for variable in self.handle.variables}
        base = stored & {*names, *(name.removesuffix("_count") for name in names), REGIME.name}
        return from_cells({name: self.pyramid.read(0, name, piece) for name in base}, names)

    def _compute(self, level: int, piece: Slices, names: list[str]) -> Cells:
        """Compute variables of the cells ``piece`` of an overview level from those of the finer level below.

        Return them by name.
        """
        finer = self.pyramid.levels.finer(level, piece)
        widths = tuple(w[f] for w, f in zip(self.pyramid.widths[level - 1], finer, strict=True))
        below = self.read(level - 1, finer, self.required_variables(names))
        return coarsen(below, widths, self.pyramid.levels.coarsened)

    def _pending(self, piece: Slices, names: Iterable[str]) -> Cells:
        """Return variables, by name, for cells ``piece`` of an overview level none of which is solved yet."""
        requested, arrays = set(names), {}
        for variable in self.pyramid.variables:
            if variable.name in requested:
                shape = tuple(p.stop - p.start for p in piece) + tuple(CODES.size for _ in variable.extra_dims)
                arrays[variable.name] = np.full(shape, variable.fill, dtype=variable.dtype)
        return arrays

    def _is_current(self, level: int, block: Slices, marks: NDArray[Any]) -> bool:
        """Return True if an overview has all cells of a block, and every tile below the block is still finished.

        level   level of the overview
        block   slices of the cells
        marks   regimes of the cells; a cell that is not written has the regime pending
        """
        tiles = self.pyramid.levels.tiles_below(level, block)
        return not (marks == PENDING).any() and bool(self.finished_mask[tiles].all())

    def _blocks(self, level: int, piece: Slices) -> Iterator[Slices]:
        """Yield the parts of the cells ``piece`` of an overview level that lie in one stored chunk each, as slices."""
        along = []
        for p, c in zip(piece, self.pyramid.levels.chunk, strict=True):
            cuts = [p.start, *range((p.start // c + 1) * c, p.stop, c), p.stop]
            along.append([slice(a, b) for a, b in itertools.pairwise(cuts)])
        yield from itertools.product(*along)


def relative_slices(piece: Slices, block: Slices) -> Slices:
    """Return the slices of cells ``block``, which are part of ``piece``, counted from the first cell of ``piece``."""
    return tuple(slice(b.start - p.start, b.stop - p.start) for p, b in zip(piece, block, strict=True))
