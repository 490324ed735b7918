"""The plan of an atlas: its tiles, its size on disk and its expected cost."""

import math
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from atlas.errors import InputError, brief_repr
from atlas.formatting import PrintableResult, byte_size, count_of, duration, plural
from atlas.overview.coarsen import level_variables
from atlas.overview.levels import OverviewLevels
from atlas.platform import processors
from atlas.spec.laws import check_steps
from atlas.spec.spec import MAX_AXES, Spec
from atlas.spec.system import unused_lines
from atlas.store.object_backend import StoreBackend
from atlas.store.record_format import WIDTH
from atlas.store.schema import LARGEST_CHUNK, coordinate_names
from atlas.store.store import AtlasStore
from atlas.store.tiling import Index, Tiling
from workers.results import REGIMES

DEFAULT_TILE, LARGE_TILE = 64, 256
"""Number of cells along a side of a tile: by default, and in a large atlas.

Tiles of a large atlas are larger, since object stores work best with large objects.
"""
MANY_TILES, MOST_TILES = 1024, 50_000
"""Numbers of tiles above which tiles are made larger: than DEFAULT_TILE, and even than LARGE_TILE."""
TILES_PER_WORKER = 16
"""Minimum number of tiles per worker.

Costs of tiles differ a hundredfold; with fewer tiles, one worker is busy with the last tile while others wait.
"""
CLEAR_RANGE = 1.5
"""Minimum ratio of the upper to the lower expected time at which both are printed, as a range."""
FILE_BLOCK = 4096
"""Bytes that a small file or folder takes on a disk."""
NAME_BYTES = 64
"""Bytes that the name of a file takes in a large folder."""
COPIED_BYTES = 3 * FILE_BLOCK
"""Maximum size, in bytes, of the copies of one array's metadata that a store has.

They are in the root's metadata, in their backup, and in those of an overview's level.
"""
OTHER_BYTES = 32 * FILE_BLOCK
"""Maximum size, in bytes, of everything else in a store: groups, the root's own attributes, and records of hosts."""
MANY_OBJECTS = 10_000_000
"""Number of objects in a bucket beyond which some providers refuse further objects, or advise against them."""
NO_BASINS = (
    "all axes are initial states, and each cell is solved by itself; for basins of attraction "
    "add a table [attractors] and choose another store"
)
"""Hint for a spec whose user may not know of basins: the store of a run cannot become a store of basins."""


@dataclass(frozen=True)
class ProbeResult:
    """The expected cost of an atlas, measured by solving some of its cells.

    cells             number of cells solved
    periods_per_cell  average number of forcing periods of a cell of the atlas
    seconds_per_cell  average processor seconds of a cell of the atlas
    low, high         limits of ``seconds_per_cell``, which few cells leave uncertain
    """

    cells: int
    periods_per_cell: float
    seconds_per_cell: float
    low: float
    high: float


@dataclass(frozen=True, repr=False)
class Plan(PrintableResult):
    """The plan of an atlas: its numbers of cells and tiles, its bytes, and its expected time.

    spec     spec of the atlas
    tiling   tiles of the atlas
    workers  number of workers that share the jobs
    probe    measured cost of a cell, or None

    ``str(plan)`` is the text for a terminal.
    """

    spec: Spec
    tiling: Tiling
    workers: int
    probe: ProbeResult | None = None

    @cached_property
    def bytes(self) -> int:
        """An upper bound of the store's size on a disk as ``du`` reports it, with files and folders in whole blocks.

        The store is not packed. The size includes results, tile records, coordinates, overviews, and the metadata and
        folders of all of these.
        """
        spec, tiling = self.spec, self.tiling
        results = _chunks(spec, tiling.tile)
        sizes = {v.name: len(v.extra_dims) for v in spec.variables}
        total = sum(_array_bytes(tiling.grid, size, sizes[name]) for name, size in results.items())
        total += _array_bytes((1,), 8 * WIDTH * tiling.count)
        coordinates = len(coordinate_names(spec))
        total += coordinates * _array_bytes((1,), 0) + 2 * 8 * sum(spec.shape) * (1 + len(spec.points))  # and copies
        levels = self._levels
        for level in range(1, levels.count + 1):
            cells = math.prod(map(min, levels.chunk, levels.shape_of(level)))
            for variable in level_variables(spec.variables):
                size = cells * np.dtype(variable.dtype).itemsize * len(REGIMES) ** len(variable.extra_dims)
                total += _array_bytes(levels.grid(level), size, len(variable.extra_dims))
            total += (coordinates + 2 * len(spec.axes)) * _array_bytes((1,), 0) + 3 * 8 * sum(levels.shape_of(level))
        return total + OTHER_BYTES

    @cached_property
    def objects(self) -> int:
        """Approximate number of files or objects of the store: chunks of tiles and of overviews."""
        chunks = sum(math.prod(self._levels.grid(level)) for level in range(1, self._levels.count + 1))
        return self.tiling.count * self.objects_per_tile + chunks * len(level_variables(self.spec.variables))

    @property
    def _levels(self) -> OverviewLevels:
        return OverviewLevels(self.spec.shape, self.tiling.tile, n_uncoarsened=self.spec.n_uncoarsened_dims)

    @property
    def objects_per_tile(self) -> int:
        """Number of objects of a finished tile: one for each variable.

        A tile with uncertain results has one more, with their reasons.
        """
        return sum(not variable.sparse for variable in self.spec.variables)

    @property
    def note(self) -> str:
        """Hints, as text, at other specs that the user may have meant; empty for most specs."""
        notes = [NO_BASINS] if self.spec.has_state_axes and self.spec.attractors is None else []
        if self.objects > MANY_OBJECTS:
            notes.append(
                f"about {count_of(self.objects)} objects are more than some providers take in a bucket: larger tiles "
                "(store.tile) make fewer"
            )
        return "; ".join([*notes, *unused_lines(self.spec.system_def)])

    @property
    def seconds(self) -> float | None:
        """Expected seconds that the whole atlas takes, if each worker has a processor; None if nothing was probed."""
        return self._seconds(self.probe.seconds_per_cell) if self.probe else None

    @property
    def seconds_range(self) -> tuple[float, float] | None:
        """Lower and upper limit of the expected seconds; None if nothing was probed."""
        return (self._seconds(self.probe.low), self._seconds(self.probe.high)) if self.probe else None

    def _seconds(self, per_cell: float) -> float:
        return per_cell * self.tiling.cells / min(self.workers, self.tiling.count)

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas plan --json`` prints."""
        return {
            "axes": self.spec.axis_descriptions,
            "dims": self.spec.dims,
            "shape": self.tiling.shape,
            "cells": self.tiling.cells,
            "tile": self.tiling.tile,
            "tiles": self.tiling.count,
            "bytes": self.bytes,
            "objects": self.objects,
            "objects_per_tile": self.objects_per_tile,
            "workers": self.workers,
            "seconds": self.seconds,
            "seconds_range": self.seconds_range,
            "seconds_per_cell": self.probe and self.probe.seconds_per_cell,
            "processor_seconds": self.probe and self.probe.seconds_per_cell * self.tiling.cells,
            "periods": self.probe and self.probe.periods_per_cell * self.tiling.cells,
            "cells_probed": self.probe.cells if self.probe else 0,
            "note": self.note,
        }

    @property
    def rows(self) -> list[tuple[str, str]]:
        """The facts of the plan as pairs of a name and a text."""
        shape, tile = (" x ".join(map(str, size)) for size in (self.tiling.shape, self.tiling.tile))
        objects = f"{count_of(self.objects)} files or objects, {self.objects_per_tile} a tile"
        cost = f"at most {byte_size(self.bytes)} in about {objects}"
        if self.probe and self.seconds is not None and self.seconds_range is not None:
            low, high = self.seconds_range
            wide = high > CLEAR_RANGE * low
            cost += f", {duration(low)} to {duration(high)}" if wide else f", about {duration(self.seconds)}"
            cost += f" on {plural(self.workers, 'worker')} (probed on {plural(self.probe.cells, 'cell')})"
        tiles = f"{plural(self.tiling.count, 'tile')} of {tile}"
        cells = f"{self.tiling.cells} ({shape}; {', '.join(self.spec.dims)}) in {tiles}"
        facts = [("axes", " x ".join(self.spec.axis_descriptions)), ("cells", cells), ("cost", cost)]
        return [*facts, ("note", self.note)] if self.note else facts


def make_plan(spec: Spec, workers: int | None = None, tile: tuple[int, ...] | None = None) -> Plan:
    """Return the plan of a spec.

    workers  number of workers, by default the number of processors
    tile     shape of the tiles in an existing store, which takes precedence over that of the spec

    Raise InputError if a tile is too large for a store, or if a store of the spec could not be read.
    """
    spec.check_stored_form()
    count = processors() if workers is None else workers
    tile_shape = tile or spec.tile or _default_tile(spec, count)
    tile_shape = tuple(min(t, n) for t, n in zip(tile_shape, spec.shape, strict=True))
    name, size = max(_chunks(spec, tile_shape).items(), key=lambda item: item[1])
    if size > LARGEST_CHUNK:
        raise InputError(
            f"store.tile: found {' x '.join(map(str, tile_shape))}, in which a chunk of {name} has {size} bytes, must "
            f"be at most {LARGEST_CHUNK}; choose smaller tiles or fewer solve.section_samples"
        )
    return Plan(spec, Tiling(spec.shape, tile_shape), count)


def plan_of_run(spec: Spec, backend: StoreBackend, handle: AtlasStore | None, workers: int, tile: Index | None) -> Plan:
    """Return the plan of a run that creates the store of ``backend``, or completes it if there is one.

    spec     spec of the atlas
    backend  backend of the store
    handle   handle of the existing store, None if there is none
    workers  number of workers
    tile     index of a tile to be solved alone, None to solve all

    Raise InputError if a new store cannot be created, if its disk is too small, if smooth coefficients have too few
    steps, or if ``tile`` is not the index of a tile.
    """
    plan = make_plan(spec, workers, None if handle is None else handle.tile)
    if handle is None:
        check_steps(spec)
    if handle is None and backend.local is not None:
        check_free_space(plan, backend.local)
    grid = plan.tiling.grid
    if tile is not None and not (len(tile) == len(grid) and all(0 <= i < n for i, n in zip(tile, grid, strict=True))):
        index_text, most = brief_repr(tuple(tile)), ", ".join(f"0 to {n - 1}" for n in grid)
        raise InputError(f"tile: found {index_text}, must be the index of a tile: {most}")
    return plan


def check_free_space(plan: Plan, target: Path, tiles: int | None = None) -> None:
    """Raise InputError if the disk of ``target`` has too little free space for ``tiles`` tiles.

    By default, these are all tiles of the plan.
    """
    home = next(folder for folder in (target, *target.absolute().parents) if folder.exists())
    free = shutil.disk_usage(home).free
    needed = plan.bytes if tiles is None else plan.bytes * tiles // plan.tiling.count
    if needed > free:
        shortage = f"needs up to {byte_size(needed)}, {home} has {byte_size(free)} free"
        raise InputError(f"{target}: {shortage}; take fewer cells or another disk")


def _default_tile(spec: Spec, workers: int) -> tuple[int, ...]:
    """Return the default shape of tiles, in cells: a side of 64 along each dimension, with the following exceptions.

    The longer side is halved until there are 16 tiles per worker. If there are many tiles nevertheless, the side is 128
    or 256, doubled again until there are at most MOST_TILES. In a continued sweep, in which each cell starts from the
    cell before it, a tile contains whole lines. No tile has cells of two planes of a stack.
    """
    shape = spec.shape
    fixed = {0: 1} if len(shape) == MAX_AXES else {}
    if spec.continuation is not None:
        continued_dim, _ = spec.continuation
        fixed[continued_dim] = shape[continued_dim]
    free = [dim for dim in range(len(shape)) if dim not in fixed]

    def tiling(side: int) -> Tiling:
        return Tiling(shape, tuple(fixed.get(dim, min(side, n)) for dim, n in enumerate(shape)))

    side, enough = DEFAULT_TILE, max(MANY_TILES, TILES_PER_WORKER * workers)
    while side < LARGE_TILE and tiling(2 * side).count >= enough:
        side *= 2
    while tiling(side).count > MOST_TILES and any(side < shape[dim] for dim in free):
        side *= 2
    tile = list(tiling(side).tile)
    while Tiling(shape, tuple(tile)).count < TILES_PER_WORKER * workers:
        longest = max(free, key=tile.__getitem__, default=None)
        if longest is None or tile[longest] == 1:
            break
        tile[longest] = -(-tile[longest] // 2)
    return tuple(tile)


def _array_bytes(grid: Index, chunk: int, inner: int = 0) -> int:
    """Return the maximum bytes of an array on a disk: its chunks, in files of their own, its folders and its metadata.

    grid   number of chunks along each dimension of the grid of tiles
    chunk  bytes of a chunk
    inner  number of further dimensions, by which the path of a chunk is longer
    """
    files, path = math.prod(grid), (*grid, *(1,) * inner)
    folders = 2 + sum(math.prod(path[:depth]) for depth in range(1, len(path)))
    names = NAME_BYTES * (files + folders)
    return files * -(-chunk // FILE_BLOCK) * FILE_BLOCK + (folders + 1) * FILE_BLOCK + names + COPIED_BYTES


def _chunks(spec: Spec, tile: tuple[int, ...]) -> dict[str, int]:
    """Return the size, in bytes, of a tile's chunk of each variable, by name."""
    sizes = spec.extra_sizes
    return {
        variable.name: np.dtype(variable.dtype).itemsize
        * math.prod(tile)
        * math.prod(sizes[dim] for dim in variable.extra_dims)
        for variable in spec.variables
    }
