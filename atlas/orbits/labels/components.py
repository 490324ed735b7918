"""Group attractors into branches: connected components along links, but never with two attractors of one cell.

Around the end of a fold or a cusp, a chain of links through other cells may join two attractors of one cell, like two
sheets of one surface. There the chain is cut. Links are taken in ascending order of the change of their orbit. A link
that would put two attractors of a cell on one branch is left out. A branch is therefore cut where its orbit changes
most. A link and its mirror image are taken together or not at all, so that branches have mirror images.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


def branches(count: int, pairs: Rows, change: NDArray[np.float64], cell: Rows, image: Rows) -> tuple[Rows, int]:
    """Group attractors that are connected by links into branches, without two attractors of one cell on a branch.

    count           number of attractors
    pairs (L, 2)    links
    change (L,)     change of the orbit along each link: the least change is taken first, equal ones in order
    cell (count,)   cell of each attractor
    image (count,)  mirror image of each attractor, -1 if there is none

    Return the branch (count,) of each attractor, numbered by its first attractor, and the number of omitted links.

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
        root_sets = [one | other] if one & other else [one, other]
        if any(cells[a] & cells[b] for roots in root_sets for a, b in combinations(roots, 2)):
            cut += 1
            continue
        for roots in root_sets:
            if len(roots) > 1:
                join(roots)
    _, first, part = np.unique([root(k) for k in range(count)], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[part.ravel()], cut
