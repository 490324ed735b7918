"""Overviews held against the cells that they stand for: each chunk computed again from the level before."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.coarsen import coarsen, level_variables
from atlas.errors import ChunkError
from atlas.levels import Index
from atlas.overview import MARKS, Pyramid, level_key, stored_chunks
from atlas.part import Part
from atlas.plan import plural
from atlas.store import READERS, Header
from workers.results import REGIME

ROUNDING = 1e-9
"""By how much numbers may differ, relatively or absolutely: widths of cells on log axes depend on the machine."""


@dataclass(frozen=True)
class CheckedChunk:
    """A chunk of a level that was read: its arrays that are whole, and what is wrong with it.

    ``sound`` tells whether it may stay; one over what is not sound may not, though nothing can be said of it.
    """

    level: int
    index: Index
    arrays: int
    faults: tuple[str, ...]
    sound: bool


def check_overviews(header: Header, bad: set[Index], tell: Callable[[int], None]) -> Iterator[CheckedChunk]:
    """Every chunk of every level, from the first level on; ``bad`` are the finished tiles that are not sound.

    ``tell`` is called with each level before it is read.
    """
    pyramid = Pyramid(header)
    if not pyramid.made:
        return
    whole = tuple(slice(0, n) for n in header.spec.shape)
    part = Part(header, whole, pyramid)
    unsound: set[Index] = set()
    with ThreadPoolExecutor(READERS) as readers:
        for level in range(1, pyramid.levels.count + 1):
            tell(level)
            complete, shown = (stored_chunks(header, level, mark) for mark in MARKS)
            # Over what is not sound nothing can be computed, whether or not a chunk between the two is stored.
            over = {tuple(i // 2 for i in index) for index in unsound}
            if level == 1:
                over = {pyramid.levels.over(tile) for tile in bad}
            indices = sorted(complete | shown)
            checks = [(part, level, index, index in complete, index in over) for index in indices]
            unsound = over
            for checked in readers.map(lambda given: _check(*given), checks):
                if not checked.sound:
                    unsound.add(checked.index)
                yield checked


def _check(part: Part, level: int, index: Index, complete: bool, over_unsound: bool) -> CheckedChunk:
    levels = part.pyramid.levels
    place = levels.block(level, index)
    variables = level_variables(part.header.spec.settings)
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
        faults.append(f"{key} stands for tile {undone[0]}, which is not done")
    elif not over_unsound:
        finer = levels.finer(level, place)
        widths = tuple(width[f] for width, f in zip(part.widths[level - 1], finer, strict=True))
        made = coarsen(part.read(level - 1, finer, [variable.name for variable in variables]), widths)
        for variable, values in stored.items():
            wrong = int(np.count_nonzero(~_same(values, made[variable.name])))
            if wrong:
                key = level_key(level, variable, index)
                faults.append(f"{key} is not what the cells below it give: {plural(wrong, 'number')}")
    return CheckedChunk(level, index, len(stored), tuple(faults), sound=not faults and not over_unsound)


def _same(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.bool_]:
    if one.dtype.kind != "f":
        return np.asarray(one == two)
    return np.isclose(one, two, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)
