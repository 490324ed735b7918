"""The labels of an atlas as a data class, and their group in its store.

A label is the number of a branch. A branch is a set of attractors of neighbouring cells that are one orbit, followed
from cell to cell. Branches are numbered by the sum of their basin shares over all cells, the largest first, equal ones
by their first cell.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.labels.attractor_orbits import attractors_of
from atlas.orbits.labels.components import branches
from atlas.orbits.labels.links import find_links
from atlas.orbits.orbit_table import Array, Rows, current_group
from atlas.store.groups import LABELS, write_table
from atlas.store.schema import StoredArray, variable_attributes
from atlas.store.store import AtlasStore
from workers import SOLVER_VERSION
from workers.results import ATTRACTOR, LABEL, REGIME, UNKNOWN_LABEL, Variable, result_named

VERSION = 4
"""Version of the method that finds labels; incremented whenever any label may change."""

BRANCH = "branch"
"""Name of the dimension, with one entry per label, of the stored table of labels."""

OF_ALL = replace(LABEL, long_name="branch that the attractor is on; -1 if none")
KINDS = (REGIME.name, "period", "impacts_upper", "impacts_lower", "symmetric")
OF_BRANCHES = (
    Variable("cells", "int32", 0, "cells that have an attractor on the branch"),
    Variable("total_share", "float64", 0.0, "sum of their shares"),
    Variable("mirror", "int32", -1, "label of the branch of mirror images; its own where it is symmetric; -1 if none"),
    *map(result_named, KINDS),
)
"""Columns of the stored table of labels: size, sum of basin shares, label of the mirror images, and the results that
all orbits of a branch have in common.
"""


@dataclass(frozen=True)
class LabelCounts:
    """Counts of the attractors of an atlas and of their labels.

    attractors  number of stored attractors
    orbits      number of attractors that are periodic orbits; chaos and tori are not
    followed    number of orbits that Newton's method finds; other attractors have no label
    branches    number of labels
    alone       number of labels with a single cell
    links       number of pairs in neighbouring cells that are one orbit
    cut         number of links left out, since they would put two attractors of one cell on a branch
    one_way     number of pairs that are not linked, since the orbit of one cell becomes that of the other, but not the
                reverse
    """

    attractors: int
    orbits: int
    followed: int
    branches: int
    alone: int
    links: int
    cut: int
    one_way: int


@dataclass(frozen=True, eq=False)
class AttractorLabels:
    """The label of every attractor of every cell, and a table of the B branches by label.

    values (cells..., keep)  label of each attractor, -1 for none
    cells (B,)               number of cells of each branch
    total (B,)               sum of its basin shares over all cells
    mirror (B,)              label of its mirror image, its own if it is symmetric, -1 if there is none
    kinds                    results that all orbits of a branch have in common, (B,) each
    count                    counts of attractors and labels
    """

    values: Rows
    cells: Rows
    total: Array
    mirror: Rows
    kinds: Mapping[str, NDArray[Any]]
    count: LabelCounts


def labels_of(handle: AtlasStore) -> AttractorLabels:
    """Find the labels of a finished atlas of all attractors. Errors are those of ``attractors_of``."""
    every, n_attractors = attractors_of(handle)
    links = find_links(every)
    branch, cut = branches(len(links.cell), links.pairs, links.change, links.cell, links.image)
    number, total = _numbered(np.where(links.known, branch[: len(every)], -1), every.share)
    cells = np.bincount(number[number >= 0], minlength=len(total))
    values = np.full((len(every.points), every.keep), UNKNOWN_LABEL, dtype=np.int64)
    values[every.cell, every.rank] = number
    labelled_rows = np.flatnonzero(number >= 0)
    first = labelled_rows[np.unique(number[labelled_rows], return_index=True)[1]]
    count = LabelCounts(
        attractors=n_attractors,
        orbits=len(every),
        followed=int(links.known.sum()),
        branches=len(total),
        alone=int(np.sum(cells == 1)),
        links=len(links.pairs),
        cut=cut,
        one_way=links.one_way,
    )
    return AttractorLabels(
        values=values.reshape(*every.shape, every.keep),
        cells=cells,
        total=total,
        mirror=mirror_labels(number, branch, links.image),
        kinds={name: getattr(every, name)[first] for name in KINDS},
        count=count,
    )


def _numbered(branch: Rows, share: Array) -> tuple[Rows, Array]:
    """Number branches anew by the sum of their shares, the largest first.

    branch (A,)  branch of each orbit, -1 for none
    share (A,)   basin share of each orbit

    Return the new numbers (A,) and the sums (B,).
    """
    known = branch >= 0
    _, first, inverse = np.unique(branch[known], return_index=True, return_inverse=True)
    total = np.bincount(inverse, weights=share[known], minlength=len(first))
    order = np.lexsort((first, -total))
    number = np.full(len(branch), UNKNOWN_LABEL, dtype=np.int64)
    number[known] = np.argsort(order)[inverse]
    return number, np.asarray(total[order], dtype=np.float64)


def mirror_labels(number: Rows, branch: Rows, image: Rows) -> Rows:
    """Return the label of the mirror image of each branch: its own if symmetric, -1 if there is none or no cell has it.

    number (A,)  label of every orbit, -1 for none
    branch (N,)  branch of each of these orbits, and of images that no cell has
    image (N,)   row of the mirror image of each

    The mirror image of a branch is a branch, so the image of any of its orbits determines it. The relation is mutual:
    ``mirror_labels(...)[m] == k`` wherever ``mirror_labels(...)[k] == m >= 0``.
    """
    labelled_rows = np.flatnonzero(number >= 0)
    label = np.full(branch.max(initial=-1) + 1, -1)
    label[branch[labelled_rows]] = number[labelled_rows]
    first = labelled_rows[np.unique(number[labelled_rows], return_index=True)[1]]
    return np.where(image[first] >= 0, label[branch[image[first]]], -1)


def write_labels(handle: AtlasStore, labels: AttractorLabels) -> None:
    """Write the labels of an atlas into its store, as a table, replacing any earlier labels."""
    rows = {"cells": labels.cells, "total_share": labels.total, "mirror": labels.mirror} | dict(labels.kinds)
    label = StoredArray(labels.values.astype(LABEL.dtype), (*handle.spec.dims, ATTRACTOR), variable_attributes(OF_ALL))
    about = {
        variable.name: StoredArray(rows[variable.name].astype(variable.dtype), (BRANCH,), variable_attributes(variable))
        for variable in OF_BRANCHES
    }
    attributes = {"title": "labels of attractors", "version": VERSION, "solver_version": SOLVER_VERSION}
    write_table(handle, LABELS, {LABEL.name: label} | about, attributes | {"count": asdict(labels.count)})


def stored_count(handle: AtlasStore) -> LabelCounts | None:
    """Return the counts of the stored labels; None if there are none, or another version of the method found them."""
    stored = current_group(handle, LABELS, VERSION)
    return None if stored is None else LabelCounts(**stored[1]["count"])
