"""Check overviews, the coarser copies of an atlas: each chunk is computed again from the level below and compared."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.check.metadata import ROUNDING
from atlas.check.report import CHUNK, StoreFault
from atlas.errors import ChunkError
from atlas.formatting import plural
from atlas.overview.coarsen import coarsen
from atlas.overview.levels import Index
from atlas.overview.pyramid import MARKS, Pyramid, level_key
from atlas.query.store_block import StoreBlock
from atlas.store.store import READERS, AtlasStore
from workers.results import REGIME


def check_overviews(
    handle: AtlasStore, bad: set[Index], on_level: Callable[[int], None]
) -> tuple[int, list[StoreFault]]:
    """Check every chunk of the overviews, and return the number of intact arrays of chunks, and the faults.

    handle    handle of the store
    bad       finished tiles with faults; chunks over them are not compared, since they are dropped with the tiles
    on_level  function called with each level before it is read
    """
    pyramid, chunks, faults = Pyramid(handle), 0, list[StoreFault]()
    if not pyramid.exists:
        return chunks, faults
    part = StoreBlock(handle, tuple(slice(0, n) for n in handle.spec.shape), pyramid)
    unsound: set[Index] = set()
    with ThreadPoolExecutor(READERS) as readers:
        for level in range(1, pyramid.levels.count + 1):
            on_level(level)
            complete, shown_chunks = (pyramid.stored(level, mark) for mark in MARKS)
            # A chunk over unsound cells cannot be computed, whether or not the chunks between the two are stored.
            over = {pyramid.levels.parent_chunk(index) for index in unsound}
            if level == 1:
                over = {pyramid.levels.chunk_over(tile) for tile in bad}
            indices = sorted(complete | shown_chunks)
            checks = [(part, level, index, index in complete, index in over) for index in indices]
            unsound = over
            results = readers.map(lambda arguments: _check(*arguments), checks)
            for index, (n_whole, texts) in zip(indices, results, strict=True):
                if texts:
                    unsound.add(index)
                chunks += n_whole
                faults += [StoreFault(None, text, (CHUNK, level, index)) for text in texts]
    return chunks, faults


def _check(part: StoreBlock, level: int, index: Index, complete: bool, over_unsound: bool) -> tuple[int, list[str]]:
    """Check a chunk of the overviews, coarser copies of the atlas.

    part          the store, for reading cells and overviews
    level, index  level and index of the chunk
    complete      True if the chunk has its ``regime``, which is written last
    over_unsound  True if the chunk covers faulty tiles or chunks, so that it cannot be compared

    Return the number of arrays of the chunk that are intact, and texts about its faults.
    """
    levels = part.pyramid.levels
    block = levels.block(level, index)
    variables = part.pyramid.variables
    stored, faults = {}, []
    for variable in variables:
        if variable.name == REGIME.name and not complete:
            continue  # written last: a kill may have left the chunk without it, and good all the same
        try:
            stored[variable] = part.pyramid.read(level, variable.name, block)
        except ChunkError as error:
            faults += error.lines
    undone = part.undone(level, block)
    if undone:
        key = level_key(level, MARKS[0] if complete else MARKS[1], index)
        faults.append(f"{key} covers tile {undone[0]}, which is not done")
    elif not over_unsound:
        finer = levels.finer(level, block)
        widths = tuple(width[f] for width, f in zip(part.pyramid.widths[level - 1], finer, strict=True))
        expected = coarsen(
            part.read(level - 1, finer, [variable.name for variable in variables]), widths, levels.coarsened
        )
        for variable, values in stored.items():
            wrong = int(np.count_nonzero(~_same(values, expected[variable.name])))
            if wrong:
                key = level_key(level, variable, index)
                faults.append(f"{key} differs from the cells below it: {plural(wrong, 'number')}")
    return len(stored), faults


def _same(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.bool_]:
    if one.dtype.kind != "f" or one.shape != two.shape:
        return np.asarray(one == two)
    return np.isclose(one, two, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)
