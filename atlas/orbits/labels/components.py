"""Attractors joined to branches along links: whole components, but never two attractors of one cell in a branch.

Round the end of a fold or a cusp two attractors of one cell may be joined by a chain of links through other cells, as
two sheets of one surface are. There the chain is cut: links are taken in the order of how little the orbit changes
along them, and one that would put two attractors of a cell on one branch is left out. So a branch is cut where its
orbit changes most. A link and its mirror image are taken together or not at all, so that branches have mirror images.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


def branches(count: int, pairs: Rows, change: NDArray[np.float64], cell: Rows, image: Rows) -> tuple[Rows, int]:
    """The branch (count,) of each attractor, numbered by its first one, and how many links (L, 2) were omitted.

    change (L,)    along each link: links of the least change are taken first, equal ones in their order
    cell (count,)  of each; image (count,) its mirror image, -1 where there is none

    >>> branches(3, np.array([[0, 1], [1, 2]]), np.array([0.1, 0.2]), np.array([0, 1, 0]), np.array([-1, -1, -1]))
    (array([0, 0, 1]), 1)
    """
    above = list(range(count))
    cells = [{int(c)} for c in cell]

    def root(k: int) -> int:
        while above[k] != k:
            above[k] = above[above[k]]
            k = above[k]
        return k

    def join(roots: set[int]) -> None:
        large, *others = sorted(roots, key=lambda k: (-len(cells[k]), -k))
        for small in others:
            above[small] = large
            cells[large] |= cells[small]
            cells[small] = set()

    cut = 0
    for link in pairs[np.argsort(change, kind="stable")]:
        mirrored = image[link]
        one = {root(k) for k in link.tolist()}
        other = {root(k) for k in mirrored.tolist()} if (mirrored >= 0).all() else set()
        joined = [one | other] if one & other else [one, other]
        if any(cells[a] & cells[b] for roots in joined for a, b in combinations(roots, 2)):
            cut += 1
            continue
        for roots in joined:
            if len(roots) > 1:
                join(roots)
    _, first, part = np.unique([root(k) for k in range(count)], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[part.ravel()], cut
