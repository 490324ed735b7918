"""The cost of reading an atlas: chunks read, and the level of the cells that answered."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from atlas.formatting import plural


@dataclass
class ReadCounter:
    """The reads inside ``counted``.

    chunks   how many were found and read
    level    the coarsest that a view was read from, 0 the cells themselves
    block    cells of the atlas, (x, y), for which a cell of the coarsest view stands
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
        """Count some more."""
        self.chunks, self.level = self.chunks + chunks, max(self.level, level)
        self.block = max(self.block, block, key=math.prod)


_reads: ContextVar[ReadCounter | None] = ContextVar("reads", default=None)


@contextmanager
def counted() -> Iterator[ReadCounter]:
    """Count the chunks that views and shares read inside the ``with`` block; a block around it counts them too."""
    outer, reads = _reads.get(), ReadCounter()
    token = _reads.set(reads)
    try:
        yield reads
    finally:
        _reads.reset(token)
        if outer is not None:
            outer.add(reads.chunks, reads.level, reads.block)


def count_reads(chunks: int, level: int = 0, block: tuple[int, ...] = (1,)) -> None:
    """Add to what the ``counted`` block around counts, if there is one."""
    reads = _reads.get()
    if reads is not None:
        reads.add(chunks, level, block)
