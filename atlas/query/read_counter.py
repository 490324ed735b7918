"""Counting what is read of an atlas: the number of chunks, and the resolution of the cells."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from atlas.formatting import plural


@dataclass
class ReadCounter:
    """What was read of atlases inside a ``with count_chunk_reads()`` block.

    chunks  number of chunks found and read
    level   coarsest overview level that was read; level 0 are the cells
    block   number of cells (x, y) of the atlas per cell of the coarsest view
    """

    chunks: int = 0
    level: int = 0
    block: tuple[int, ...] = (1,)

    def __str__(self) -> str:
        if not self.level:
            return f"{plural(self.chunks, 'chunk')} read from the store, at full resolution"
        block = " x ".join(map(str, self.block))
        return f"{plural(self.chunks, 'chunk')} read from the store, at reduced resolution: one value for {block} cells"

    def add(self, chunks: int, level: int = 0, block: tuple[int, ...] = (1,)) -> None:
        """Add a number of chunks, and note the level and the block size of what was read."""
        self.chunks, self.level = self.chunks + chunks, max(self.level, level)
        self.block = max(self.block, block, key=math.prod)


_reads: ContextVar[ReadCounter | None] = ContextVar("reads", default=None)


@contextmanager
def count_chunk_reads() -> Iterator[ReadCounter]:
    """Yield a counter of the chunks that are read inside the ``with`` block; outer ``with`` blocks count them too."""
    outer, reads = _reads.get(), ReadCounter()
    token = _reads.set(reads)
    try:
        yield reads
    finally:
        _reads.reset(token)
        if outer is not None:
            outer.add(reads.chunks, reads.level, reads.block)


def count_reads(chunks: int, level: int = 0, block: tuple[int, ...] = (1,)) -> None:
    """Add chunks to the counter of the surrounding ``with count_chunk_reads()`` block, if there is one.

    chunks   number of chunks read
    level    overview level that was read; level 0 are the cells
    block    number of cells (x, y) of the atlas per cell of that level
    """
    reads = _reads.get()
    if reads is not None:
        reads.add(chunks, level, block)
