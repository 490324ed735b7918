"""The plan: how an atlas is cut into tiles and what it will cost, as a value."""

import itertools
import math
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from atlas.errors import InputError
from atlas.overview.coarsen import overview_bytes
from atlas.spec.spec import Slices, Spec
from workers.results import result_variables

DEFAULT_TILE = 64
TILES_PER_WORKER = 16
"""Costs of tiles differ a hundredfold; with fewer tiles the last ones keep one worker busy and the others waiting."""
CLEAR_RANGE = 1.5
"""From this ratio of its ends on an expected time is printed as a range."""
LARGEST_CHUNK = 2**31 - 1
"""Bytes that the codecs of a store take at once."""
FILE_BLOCK = 4096
"""Bytes that a small file takes on a disk."""


@dataclass(frozen=True)
class Tile:
    """A block of cells: its index along each dimension, and the cells it covers."""

    index: tuple[int, ...]
    slices: Slices


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

    shape, tile   cells along each dimension, of the whole and of one tile (the last tiles may hold fewer)
    workers       how many are to share the work
    bytes         an upper bound of the store's size: no compression assumed
    probe         measured time, or None
    """

    dims: tuple[str, ...]
    axes: tuple[str, ...]
    shape: tuple[int, ...]
    tile: tuple[int, ...]
    workers: int
    bytes: int
    probe: Probe | None = None

    @property
    def cells(self) -> int:
        """Cells in all."""
        return math.prod(self.shape)

    @property
    def grid(self) -> tuple[int, ...]:
        """Tiles along each dimension."""
        return tuple(-(-n // t) for n, t in zip(self.shape, self.tile, strict=True))

    @property
    def tile_count(self) -> int:
        """Tiles in all."""
        return math.prod(self.grid)

    @property
    def seconds(self) -> float | None:
        """Expected seconds of the whole on these workers, a processor each, or None where nothing was probed."""
        return self._seconds(self.probe.seconds_per_cell) if self.probe else None

    @property
    def seconds_range(self) -> tuple[float, float] | None:
        """Where these seconds lie, or None where nothing was probed."""
        return (self._seconds(self.probe.low), self._seconds(self.probe.high)) if self.probe else None

    def _seconds(self, per_cell: float) -> float:
        return per_cell * self.cells / min(self.workers, self.tile_count)

    def tiles(self) -> Iterator[Tile]:
        """All tiles, row by row."""
        for index in itertools.product(*(range(n) for n in self.grid)):
            yield self.at(index)

    def at(self, index: tuple[int, ...]) -> Tile:
        """The tile of that index."""
        parts = zip(index, self.tile, self.shape, strict=True)
        return Tile(index, tuple(slice(i * t, min((i + 1) * t, n)) for i, t, n in parts))

    def size(self, index: tuple[int, ...]) -> int:
        """Cells of the tile of that index."""
        return math.prod(part.stop - part.start for part in self.at(index).slices)

    def as_dict(self) -> dict[str, Any]:
        """What ``atlas plan --json`` prints."""
        return {
            "axes": self.axes,
            "dims": self.dims,
            "shape": self.shape,
            "cells": self.cells,
            "tile": self.tile,
            "tiles": self.tile_count,
            "bytes": self.bytes,
            "workers": self.workers,
            "seconds": self.seconds,
            "seconds_range": self.seconds_range,
            "seconds_per_cell": self.probe and self.probe.seconds_per_cell,
            "processor_seconds": self.probe and self.probe.seconds_per_cell * self.cells,
            "periods": self.probe and self.probe.periods_per_cell * self.cells,
            "cells_probed": self.probe.cells if self.probe else 0,
        }

    def __str__(self) -> str:
        shape, tile = " x ".join(map(str, self.shape)), " x ".join(map(str, self.tile))
        cost = f"at most {_bytes(self.bytes)}"
        if self.probe and self.seconds is not None and self.seconds_range is not None:
            low, high = self.seconds_range
            wide = high > CLEAR_RANGE * low
            cost += f", {duration(low)} to {duration(high)}" if wide else f", about {duration(self.seconds)}"
            cost += f" on {plural(self.workers, 'worker')} (probed on {plural(self.probe.cells, 'cell')})"
        return (
            f"axes   {' x '.join(self.axes)}\n"
            f"cells  {self.cells} ({shape}; {', '.join(self.dims)}) in {plural(self.tile_count, 'tile')} of {tile}\n"
            f"cost   {cost}"
        )


def make_plan(spec: Spec, workers: int | None = None, tile: tuple[int, ...] | None = None) -> Plan:
    """The plan of a spec for that many workers; ``tile`` is the shape that a store already has, and wins.

    Raises InputError where a tile is too large for a store.
    """
    count = default_workers() if workers is None else workers
    chosen = tile or spec.tile or _default_tile(spec, count)
    chosen = tuple(min(t, n) for t, n in zip(chosen, spec.shape, strict=True))
    _check_chunks(spec, chosen)
    plan = Plan(spec.dims, tuple(str(axis) for axis in spec.axes), spec.shape, chosen, count, bytes=0)
    return replace(plan, bytes=_bytes_needed(spec, plan))


def default_workers() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_disk(plan: Plan, target: Path, tiles: int | None = None) -> None:
    """Raise InputError where the disk that is to hold ``target`` has no room for that many tiles, or for all."""
    home = next(folder for folder in (target, *target.absolute().parents) if folder.exists())
    free = shutil.disk_usage(home).free
    bytes_needed = plan.bytes if tiles is None else plan.bytes * tiles // plan.tile_count
    if bytes_needed > free:
        needed, room = _bytes(bytes_needed), _bytes(free)
        raise InputError(f"{target}: needs up to {needed}, {home} has {room} free; take fewer cells or another disk")


def _default_tile(spec: Spec, workers: int) -> tuple[int, ...]:
    """64 along each dimension, the longer side halved until there are 16 tiles a worker; lines continued are whole."""
    shape = spec.shape
    tile = [min(DEFAULT_TILE, n) for n in shape]
    free = list(range(len(shape)))
    if spec.continuation is not None:
        place, _ = spec.continuation
        tile[place] = shape[place]
        free.remove(place)
    while math.prod(-(-n // t) for n, t in zip(shape, tile, strict=True)) < TILES_PER_WORKER * workers:
        longest = max(free, key=tile.__getitem__, default=None)
        if longest is None or tile[longest] == 1:
            break
        tile[longest] = -(-tile[longest] // 2)
    return tuple(tile)


def _bytes_needed(spec: Spec, plan: Plan) -> int:
    """Every chunk of every variable in whole file blocks, the coordinates, and the overviews."""
    total = 8 * sum(spec.shape)
    for chunk in _chunks(spec, plan.tile).values():
        total += plan.tile_count * -(-chunk // FILE_BLOCK) * FILE_BLOCK
    return total + overview_bytes(spec, plan.tile)


def _chunks(spec: Spec, tile: tuple[int, ...]) -> dict[str, int]:
    """Bytes of a chunk of each variable."""
    states = len(spec.record.states)
    sizes = {"exponent": states, "state": states, "sample": spec.settings.section_samples}
    items = {"bool": 1, "int8": 1, "int32": 4, "float64": 8}
    return {
        variable.name: items[variable.dtype] * math.prod(tile) * math.prod(sizes[dim] for dim in variable.extra)
        for variable in result_variables(spec.settings)
    }


def _check_chunks(spec: Spec, tile: tuple[int, ...]) -> None:
    name, size = max(_chunks(spec, tile).items(), key=lambda item: item[1])
    if size > LARGEST_CHUNK:
        raise InputError(
            f"store.tile: the values of {name} in tiles of {' x '.join(map(str, tile))} take {size} bytes a chunk, "
            f"at most {LARGEST_CHUNK} are possible; choose smaller tiles or fewer solve.section_samples"
        )


def duration(seconds: float) -> str:
    """Seconds in words for a person: 0.4 s, 12 s, 3 min 20 s, 5 h 10 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def plural(count: int, noun: str) -> str:
    """A count with its noun: 1 tile, 2 tiles."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _bytes(count: int) -> str:
    size = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"
