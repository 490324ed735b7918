"""Attractors joined to branches along links: whole components, but never two attractors of one cell in a branch.

Round the end of a fold or a cusp two attractors of one cell may be joined by a chain of links through other cells, as
two sheets of one surface are. There the chain is cut: links are taken in the order of how little the orbit changes
along them, and one that would put two attractors of a cell on one branch is left out. So a branch is cut where its
orbit changes most.
"""

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


def branches(count: int, pairs: Rows, change: NDArray[np.float64], cell: Rows) -> tuple[Rows, int]:
    """The branch (count,) of each attractor, numbered by its first one, and how many links (L, 2) were left out.

    change (L,) along each link: those of the least are taken first, equal ones in their order; cell (count,) of each.

    >>> branches(3, np.array([[0, 1], [1, 2]]), np.array([0.1, 0.2]), np.array([0, 1, 0]))
    (array([0, 0, 1]), 1)
    """
    above = list(range(count))
    cells = [{int(c)} for c in cell]

    def root(k: int) -> int:
        while above[k] != k:
            above[k] = above[above[k]]
            k = above[k]
        return k

    cut = 0
    for a, b in pairs[np.argsort(change, kind="stable")].tolist():
        one, other = root(a), root(b)
        if one == other:
            continue
        small, large = sorted((one, other), key=lambda k: (len(cells[k]), k))
        if cells[small] & cells[large]:
            cut += 1
            continue
        above[small] = large
        cells[large] |= cells[small]
        cells[small] = set()
    _, first, found = np.unique([root(k) for k in range(count)], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[found.ravel()], cut
