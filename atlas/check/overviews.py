"""Overviews compared with the cells below them: each chunk computed again from the level before."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError
from atlas.overview.coarsen import CODES, coarsen
from atlas.overview.coordinates import level_coordinates
from atlas.overview.levels import Index
from atlas.overview.pyramid import (
    GROUP,
    MARKS,
    Pyramid,
    drop_all,
    level_key,
)
from atlas.query.source import Part
from atlas.store.store import READERS, ROOT, Atlas
from atlas.text import plural
from workers.results import REGIME

ROUNDING = 1e-9
"""By how much numbers may differ, relatively or absolutely: widths of cells on log axes depend on the machine."""


@dataclass(frozen=True)
class OverviewReport:
    """The faults of a store's overviews: chunks that were read whole, faults, each in a line.

    unsound     chunks, by level and index, that must not stay: with faults, or over what is not sound
    misformed   metadata or coordinates are damaged: no chunk was read, and none may stay
    """

    chunks: int
    faults: tuple[str, ...]
    unsound: tuple[tuple[int, Index], ...]
    misformed: bool = False


@dataclass(frozen=True)
class _CheckedChunk:
    """A chunk of a level that was read: its arrays that are whole, its faults, and whether it may stay."""

    index: Index
    arrays: int
    faults: tuple[str, ...]
    sound: bool


def check_overviews(handle: Atlas, bad: set[Index], on_level: Callable[[int], None]) -> OverviewReport:
    """Read every chunk of every level, from the first level on; ``bad`` are the finished tiles that are not sound.

    ``on_level`` is called with each level before it is read.
    """
    if misformed := _form_faults(handle):
        return OverviewReport(0, tuple(misformed), (), misformed=True)
    chunks = 0
    faults: list[str] = []
    dropped: list[tuple[int, Index]] = []
    for level, checked in _checked(handle, bad, on_level):
        chunks += checked.arrays
        faults += checked.faults
        dropped += [] if checked.sound else [(level, checked.index)]
    return OverviewReport(chunks, tuple(faults), tuple(dropped))


def drop_unsound(handle: Atlas, report: OverviewReport) -> None:
    """Drop what must not stay, and all that lies over it; the next run makes it anew."""
    if report.misformed:
        drop_all(handle)
    Pyramid(handle).drop_chunks(report.unsound)


def _form_faults(handle: Atlas) -> list[str]:
    """What of the metadata and coordinates of overviews cannot be read, or is not as new ones have it."""
    pyramid, faults = Pyramid(handle), []
    levels = pyramid.levels
    for level in range(1, levels.count + 1) if pyramid.made else ():
        shape = levels.shape_of(level)
        shapes = {v.name: shape + (CODES.size,) * len(v.extra) for v in pyramid.variables}
        for name, expected in shapes.items():
            try:
                found = pyramid.array(level, name).shape
                if found != expected:
                    faults.append(f"{GROUP}/{level}/{name}/{ROOT}: shape {found}, must be {expected}")
            except ChunkError as error:
                faults += [f"{key} {what}" for key, what in error.faults.items()]
        for name, coordinate in level_coordinates(handle, level).items():
            try:
                found = pyramid.read(level, name, tuple(slice(0, n) for n in coordinate.values.shape))
                if not np.all(_same(found, coordinate.values)):
                    faults.append(f"{GROUP}/{level}/{name} is not the spec's, or missing")
            except ChunkError as error:
                faults += [f"{key} {what}" for key, what in error.faults.items()]
    return faults


def _checked(handle: Atlas, bad: set[Index], on_level: Callable[[int], None]) -> Iterator[tuple[int, _CheckedChunk]]:
    pyramid = Pyramid(handle)
    if not pyramid.made:
        return
    whole = tuple(slice(0, n) for n in handle.spec.shape)
    part = Part(handle, whole, pyramid)
    unsound: set[Index] = set()
    with ThreadPoolExecutor(READERS) as readers:
        for level in range(1, pyramid.levels.count + 1):
            on_level(level)
            complete, shown = (pyramid.stored(level, mark) for mark in MARKS)
            # Over what is not sound nothing can be computed, whether or not a chunk between the two is stored.
            over = {pyramid.levels.above(index) for index in unsound}
            if level == 1:
                over = {pyramid.levels.over(tile) for tile in bad}
            indices = sorted(complete | shown)
            checks = [(part, level, index, index in complete, index in over) for index in indices]
            unsound = over
            for checked in readers.map(lambda given: _check(*given), checks):
                if not checked.sound:
                    unsound.add(checked.index)
                yield level, checked


def _check(part: Part, level: int, index: Index, complete: bool, over_unsound: bool) -> _CheckedChunk:
    levels = part.pyramid.levels
    place = levels.block(level, index)
    variables = part.pyramid.variables
    stored, faults = {}, []
    for variable in variables:
        if variable.name == REGIME.name and not complete:
            continue  # written last: a kill may have left the chunk without it, and good all the same
        try:
            stored[variable] = part.pyramid.read(level, variable.name, place)
        except ChunkError as error:
            faults += [f"{key} {what}" for key, what in error.faults.items()]
    undone = part.undone(level, place)
    if undone:
        key = level_key(level, MARKS[0] if complete else MARKS[1], index)
        faults.append(f"{key} covers tile {undone[0]}, which is not done")
    elif not over_unsound:
        finer = levels.finer(level, place)
        widths = tuple(width[f] for width, f in zip(part.pyramid.widths[level - 1], finer, strict=True))
        made = coarsen(part.read(level - 1, finer, [variable.name for variable in variables]), widths, levels.coarsened)
        for variable, values in stored.items():
            wrong = int(np.count_nonzero(~_same(values, made[variable.name])))
            if wrong:
                key = level_key(level, variable, index)
                faults.append(f"{key} differs from the cells below it: {plural(wrong, 'number')}")
    return _CheckedChunk(index, len(stored), tuple(faults), sound=not faults and not over_unsound)


def _same(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.bool_]:
    if one.dtype.kind != "f" or one.shape != two.shape:
        return np.asarray(one == two)
    return np.isclose(one, two, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)
