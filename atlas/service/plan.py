"""The plan: how an atlas is cut into tiles and what it will cost, as a value."""

import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from atlas.errors import InputError
from atlas.overview.coarsen import overview_bytes
from atlas.platform import processors
from atlas.spec.spec import MOST_AXES, Spec
from atlas.store.schema import extra_sizes
from atlas.store.tiling import Tiling
from atlas.text import byte_size, duration, plural

DEFAULT_TILE, LARGE_TILE = 64, 256
"""Cells along each side of a tile by default, and of one of a large atlas: an object store likes large objects."""
MANY_TILES, MOST_TILES = 1024, 50_000
"""Tiles are larger than the default where at least MANY_TILES remain, and larger still beyond MOST_TILES."""
TILES_PER_WORKER = 16
"""Costs of tiles differ a hundredfold; with fewer tiles the last ones keep one worker busy and the others waiting."""
CLEAR_RANGE = 1.5
"""From this ratio of its ends on an expected time is printed as a range."""
LARGEST_CHUNK = 2**31 - 1
"""Bytes that the codecs of a store take at once."""
FILE_BLOCK = 4096
"""Bytes that a small file takes on a disk."""
NO_BASINS = (
    "all axes are initial states, and each cell is solved by itself; for basins of attraction: "
    "atlas basins SPEC -o ANOTHER_STORE"
)
"""For a spec whose user may not know of basins: the store of a run cannot become one of basins."""


@dataclass(frozen=True)
class Probe:
    """Cells solved for their cost: how many, and what one of the atlas costs on average.

    periods_per_cell   forcing periods
    seconds_per_cell   processor seconds; between ``low`` and ``high`` as far as so few cells show
    """

    cells: int
    periods_per_cell: float
    seconds_per_cell: float
    low: float
    high: float


@dataclass(frozen=True)
class Plan:
    """Cells, tiles, bytes and time of an atlas. ``str(plan)`` is what a terminal shows.

    tiling    how the cells, along each of ``dims``, are cut into tiles
    workers   how many are to share the work
    bytes     an upper bound of the store's size: no compression assumed
    probe     measured time, or None
    note      what else its user may have meant, empty for most
    """

    dims: tuple[str, ...]
    axes: tuple[str, ...]
    tiling: Tiling
    workers: int
    bytes: int
    probe: Probe | None = None
    note: str = ""

    @property
    def seconds(self) -> float | None:
        """Expected seconds of the whole on these workers, a processor each, or None where nothing was probed."""
        return self._seconds(self.probe.seconds_per_cell) if self.probe else None

    @property
    def seconds_range(self) -> tuple[float, float] | None:
        """Where these seconds lie, or None where nothing was probed."""
        return (self._seconds(self.probe.low), self._seconds(self.probe.high)) if self.probe else None

    def _seconds(self, per_cell: float) -> float:
        return per_cell * self.tiling.cells / min(self.workers, self.tiling.count)

    def as_dict(self) -> dict[str, Any]:
        """What ``atlas plan --json`` prints."""
        return {
            "axes": self.axes,
            "dims": self.dims,
            "shape": self.tiling.shape,
            "cells": self.tiling.cells,
            "tile": self.tiling.tile,
            "tiles": self.tiling.count,
            "bytes": self.bytes,
            "workers": self.workers,
            "seconds": self.seconds,
            "seconds_range": self.seconds_range,
            "seconds_per_cell": self.probe and self.probe.seconds_per_cell,
            "processor_seconds": self.probe and self.probe.seconds_per_cell * self.tiling.cells,
            "periods": self.probe and self.probe.periods_per_cell * self.tiling.cells,
            "cells_probed": self.probe.cells if self.probe else 0,
            "note": self.note,
        }

    def __str__(self) -> str:
        shape, tile = (" x ".join(map(str, size)) for size in (self.tiling.shape, self.tiling.tile))
        cost = f"at most {byte_size(self.bytes)}"
        if self.probe and self.seconds is not None and self.seconds_range is not None:
            low, high = self.seconds_range
            wide = high > CLEAR_RANGE * low
            cost += f", {duration(low)} to {duration(high)}" if wide else f", about {duration(self.seconds)}"
            cost += f" on {plural(self.workers, 'worker')} (probed on {plural(self.probe.cells, 'cell')})"
        return (
            f"axes   {' x '.join(self.axes)}\n"
            f"cells  {self.tiling.cells} ({shape}; {', '.join(self.dims)}) in "
            f"{plural(self.tiling.count, 'tile')} of {tile}\n"
            f"cost   {cost}"
        ) + (f"\nnote   {self.note}" if self.note else "")


def make_plan(spec: Spec, workers: int | None = None, tile: tuple[int, ...] | None = None) -> Plan:
    """The plan of a spec for that many workers; ``tile`` is the shape that a store already has, and wins.

    Raises InputError where a tile is too large for a store.
    """
    count = processors() if workers is None else workers
    chosen = tile or spec.tile or _default_tile(spec, count)
    chosen = tuple(min(t, n) for t, n in zip(chosen, spec.shape, strict=True))
    _check_chunks(spec, chosen)
    tiling = Tiling(spec.shape, chosen)
    note = NO_BASINS if spec.of_states and spec.attractors is None else ""
    return Plan(spec.dims, spec.described, tiling, count, _bytes_needed(spec, tiling), note=note)


def disk_shortage(plan: Plan, target: Path, tiles: int | None = None) -> str:
    """What to say where the disk that is to hold ``target`` has no room for that many tiles, or for all; else empty."""
    home = next(folder for folder in (target, *target.absolute().parents) if folder.exists())
    free = shutil.disk_usage(home).free
    bytes_needed = plan.bytes if tiles is None else plan.bytes * tiles // plan.tiling.count
    if bytes_needed <= free:
        return ""
    needed, room = byte_size(bytes_needed), byte_size(free)
    return f"{target}: needs up to {needed}, {home} has {room} free; take fewer cells or another disk"


def _default_tile(spec: Spec, workers: int) -> tuple[int, ...]:
    """64 along each dimension, the longer side halved until there are 16 tiles a worker; lines continued are whole.

    128 or 256 where there are many tiles all the same, and twice as much again until there are at most MOST_TILES. No
    tile has cells of two planes of a stack.
    """
    shape = spec.shape
    fixed = {0: 1} if len(shape) == MOST_AXES else {}
    if spec.continuation is not None:
        place, _ = spec.continuation
        fixed[place] = shape[place]
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


def _bytes_needed(spec: Spec, tiling: Tiling) -> int:
    """Every chunk of every variable in whole file blocks, the coordinates, and the overviews."""
    total = 8 * sum(spec.shape) * (1 + len(spec.points))
    for chunk in _chunks(spec, tiling.tile).values():
        total += tiling.count * -(-chunk // FILE_BLOCK) * FILE_BLOCK
    return total + overview_bytes(spec, tiling.tile)


def _chunks(spec: Spec, tile: tuple[int, ...]) -> dict[str, int]:
    """Bytes of a chunk of each variable."""
    sizes = extra_sizes(spec)
    return {
        variable.name: np.dtype(variable.dtype).itemsize
        * math.prod(tile)
        * math.prod(sizes[dim] for dim in variable.extra)
        for variable in spec.variables
    }


def _check_chunks(spec: Spec, tile: tuple[int, ...]) -> None:
    name, size = max(_chunks(spec, tile).items(), key=lambda item: item[1])
    if size > LARGEST_CHUNK:
        raise InputError(
            f"store.tile: the values of {name} in tiles of {' x '.join(map(str, tile))} take {size} bytes a chunk, "
            f"at most {LARGEST_CHUNK} are possible; choose smaller tiles or fewer solve.section_samples"
        )
