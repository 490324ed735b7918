"""A cut: cells along a line over a plane, whose states at t = k T are drawn as a bifurcation diagram.

The states are taken at the start of each forcing period T and are called section states. The cells are solved coarsely
first.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.explore.grid_patch import packed, solve_patch
from atlas.explore.jobs import Computation
from atlas.explore.subject import PlaneParameters, Subject
from atlas.explore.view_state import Cut
from atlas.query.machine import gap_rows
from workers.model.observables import ENERGY_LOSS, GAP, MAXIMUM, MINIMUM, OF_IMPACTS, Observable
from workers.results import ERROR, LARGEST, SECTION

STEPS = 256
"""Number of steps between the ends of a fully solved cut: it has one point more."""
COARSE = 8
"""Stride of the points of a cut that are solved first; the stride is then halved until all points are solved."""
POINTS_PER_JOB = STEPS // COARSE + 1
"""Number of points in one job."""
SAMPLES = 48
"""Maximum number of values that a cut shows of one cell, such as states at t = k T of a cell that is not periodic."""
SECTION_WORDS = "gap at t = kT"
"""Words in the menu for the quantity that a cut shows at first."""
Array = NDArray[np.float64]


@dataclass(frozen=True)
class CutLine:
    """The line of a cut over a plane, straight on the scales of the axes; its points are numbered from 0 to STEPS.

    subject   the subject that is explored
    plane     the fixed parameters
    ends      (x, y, x, y) of the two ends
    observe   observable of the cells that is shown; None to show the states at t = k T
    """

    subject: Subject
    plane: PlaneParameters
    ends: Cut
    observe: Observable | None = None

    @cached_property
    def axis(self) -> int:
        """The axis along which the diagrams are drawn, 0 across or 1 up.

        It is the axis of whose length the line spans the larger share.
        """
        x0, y0, x1, y1 = self.ends
        reach = []
        for lattice, ends in ((self.subject.x, (x0, x1)), (self.subject.y, (y0, y1))):
            low, high = lattice.positions(np.array(ends))
            reach.append(abs(high - low) / len(lattice.axis))
        return int(reach[1] > reach[0])

    @property
    def name(self) -> str:
        """The name of the parameter on the diagrams' horizontal axis."""
        return self.subject.axes[self.axis]

    @property
    def level(self) -> bool:
        """True if the line is parallel to an axis, so that only one parameter changes along it."""
        return self.ends[1 - self.axis] == self.ends[3 - self.axis]

    def points(self, index: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the values of both axes, (N,) each, at the points of the line with these numbers."""
        share, (x0, y0, x1, y1) = index / STEPS, self.ends
        values = []
        for lattice, (begin, end) in ((self.subject.x, (x0, x1)), (self.subject.y, (y0, y1))):
            values.append(begin * (end / begin) ** share if lattice.log else begin + (end - begin) * share)
            values[-1][index == STEPS] = end
        return values[0], values[1]

    def batches(self) -> list[tuple[int, ...]]:
        """Return the numbers of the points in the order of solving, coarse first, in batches.

        A batch has at most POINTS_PER_JOB points.
        """
        parts, step, begin = [], COARSE, 0
        while step:
            index = list(range(begin, STEPS + 1, 2 * step if begin else step))
            parts += [tuple(index[k : k + POINTS_PER_JOB]) for k in range(0, len(index), POINTS_PER_JOB)]
            begin = step = step // 2
        return parts


@dataclass(frozen=True)
class CutCells:
    """Solved cells of a cut.

    index     (N,) numbers of their points along the line
    results   results of the cells by name; ``shown`` (N, SAMPLES) are the values that the diagram draws
    """

    index: NDArray[np.int64]
    results: dict[str, NDArray[Any]]

    def merged_with(self, other: "CutCells | None") -> "CutCells":
        """Return these cells together with those of ``other``, each once, in the order of the line."""
        if other is None:
            return self
        index, order = np.unique(np.concatenate([self.index, other.index]), return_index=True)
        results = {name: np.concatenate([values, other.results[name]])[order] for name, values in self.results.items()}
        return CutCells(index, results)


def cut_computation(line: CutLine, part: tuple[int, ...]) -> Computation[CutCells]:
    """Return the computation that solves, on a worker, the cells at the points of a line with the numbers ``part``.

    The points are sent as the diagonal of a grid of their values on both axes.
    """
    subject, index = line.subject, np.array(part)
    points = line.points(index)
    grid = subject.grid(line.plane, *points, packed(np.eye(len(part), dtype=bool)))
    sampling: dict[str, Any] = {"section_samples": SAMPLES}
    if line.observe is not None:
        sampling = {"observe": line.observe.name, "observe_values": SAMPLES}
    patch = replace(grid, settings=replace(subject.settings, **sampling))

    def read(results: dict[str, NDArray[Any]]) -> CutCells:
        if line.observe is not None:
            samples, number = results.pop(line.observe.variable), results.pop(line.observe.number)
            more = (results["period"] > 0) & ((number > SAMPLES) | (number < 0))
            return CutCells(index, results | {"shown": samples, "more": more})
        values: dict[str, float | Array] = dict(line.plane.parameters)
        values.update(zip(subject.axes, points, strict=True))
        rows = gap_rows(subject.system, values)
        section = results.pop(SECTION.name)
        gap = np.einsum("ni,nki->nk", rows, section[..., : rows.shape[1]])
        period = results["period"][:, None]
        gap[(period > 0) & (np.arange(SAMPLES) < SAMPLES - period)] = np.nan  # each point of an orbit once
        return CutCells(index, results | {"shown": gap})

    return Computation(solve_patch, patch, read, len(part))


def exponents(line: CutLine, cells: CutCells) -> dict[str, Array]:
    """Return columns for the plot of the largest Lyapunov exponent, and of its error band, along a line.

    Column ``x`` is the parameter. All columns are empty if the cells have no exponents.
    """
    if LARGEST.name not in cells.results:
        return {"x": np.zeros(0), "largest": np.zeros(0), "low": np.zeros(0), "high": np.zeros(0)}
    x, largest, error = line.points(cells.index)[line.axis], cells.results[LARGEST.name], cells.results[ERROR.name]
    return {"x": x, "largest": largest, "low": largest - error, "high": largest + error}


def shown_points(line: CutLine, cells: CutCells) -> dict[str, NDArray[np.floating]]:
    """Return the columns ``x`` and ``y`` of a cut's diagram: the parameter, and gap coordinates or the observable."""
    x, ordinates = line.points(cells.index)[line.axis], cells.results["shown"]
    known = np.isfinite(ordinates)
    return {"x": np.broadcast_to(x[:, None], ordinates.shape)[known], "y": ordinates[known].astype(np.float32)}


def to_observe(subject: Subject) -> dict[str, Observable | None]:
    """Return the quantities that a cut can show, by their words in the menu.

    They are the gap coordinate at t = k T (as None), impacts, maxima and minima of the gap coordinate, and energy
    losses.
    """
    definition = subject.system.definition
    names = [part.name for part in definition.contacts] if len(definition.contacts) > 1 else []
    texts = [":".join(filter(None, (kind, name))) for kind in OF_IMPACTS for name in ("", *names)]
    texts = texts if definition.contacts else []
    texts += [f"{kind}:{GAP}" for kind in (MAXIMUM, MINIMUM)] + [ENERGY_LOSS]
    observables = [Observable.parse(text, definition) for text in texts]
    return {SECTION_WORDS: None} | {part.words: part for part in observables}
