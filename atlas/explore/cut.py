"""A cut: the cells along a line over a plane, coarse first, with their section states."""

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
"""Number of steps between the ends of a fully solved line."""
COARSE = 8
"""Stride of the points that are solved first; then the stride is halved again and again."""
POINTS_PER_JOB = STEPS // COARSE + 1
"""Number of points in one job."""
SAMPLES = 48
"""Number of section states of a cell that is not periodic."""
SECTION_WORDS = "gap at t = kT"
"""The first choice of what a cut shows."""
Array = NDArray[np.float64]


@dataclass(frozen=True)
class CutLine:
    """A line over a plane of a subject, straight on the scales of its axes; its points are numbered from 0 to STEPS.

    subject   the subject
    plane     the plane
    ends      (x, y, x, y) of the two ends
    observe   observable of the cells that is shown; None for section states
    """

    subject: Subject
    plane: PlaneParameters
    ends: Cut
    observe: Observable | None = None

    @cached_property
    def axis(self) -> int:
        """The axis, 0 across or 1 up, along which the diagrams are drawn: the axis of which the line covers more."""
        x0, y0, x1, y1 = self.ends
        reach = []
        for lattice, ends in ((self.subject.x, (x0, x1)), (self.subject.y, (y0, y1))):
            low, high = lattice.positions(np.array(ends))
            reach.append(abs(high - low) / len(lattice.axis))
        return int(reach[1] > reach[0])

    @property
    def name(self) -> str:
        """The parameter of the diagrams' axis."""
        return self.subject.axes[self.axis]

    @property
    def level(self) -> bool:
        """True if the line runs along one axis, so that only one parameter changes."""
        return self.ends[1 - self.axis] == self.ends[3 - self.axis]

    def points(self, index: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the values of both axes at points, (N,) each."""
        share, (x0, y0, x1, y1) = index / STEPS, self.ends
        values = []
        for lattice, (begin, end) in ((self.subject.x, (x0, x1)), (self.subject.y, (y0, y1))):
            values.append(begin * (end / begin) ** share if lattice.log else begin + (end - begin) * share)
            values[-1][index == STEPS] = end
        return values[0], values[1]

    def batches(self) -> list[tuple[int, ...]]:
        """Return the points in the order in which they are solved, in batches of at most POINTS_PER_JOB."""
        parts, step, begin = [], COARSE, 0
        while step:
            index = list(range(begin, STEPS + 1, 2 * step if begin else step))
            parts += [tuple(index[k : k + POINTS_PER_JOB]) for k in range(0, len(index), POINTS_PER_JOB)]
            begin = step = step // 2
        return parts


@dataclass(frozen=True)
class CutCells:
    """Solved points of a line: their indices (N,), and results by name, including ``shown`` (N, SAMPLES)."""

    index: NDArray[np.int64]
    results: dict[str, NDArray[Any]]

    def merged_with(self, other: "CutCells | None") -> "CutCells":
        """Return these points and those of ``other``, each once, in the order of the line."""
        if other is None:
            return self
        index, order = np.unique(np.concatenate([self.index, other.index]), return_index=True)
        results = {name: np.concatenate([values, other.results[name]])[order] for name, values in self.results.items()}
        return CutCells(index, results)


def cut_computation(line: CutLine, part: tuple[int, ...]) -> Computation[CutCells]:
    """Return the computation that solves the points ``part`` of a line on a worker.

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
    """Return the largest exponent and its error along a line, as columns over ``x``; empty without exponents."""
    if LARGEST.name not in cells.results:
        return {"x": np.zeros(0), "largest": np.zeros(0), "low": np.zeros(0), "high": np.zeros(0)}
    x, largest, error = line.points(cells.index)[line.axis], cells.results[LARGEST.name], cells.results[ERROR.name]
    return {"x": x, "largest": largest, "low": largest - error, "high": largest + error}


def shown_points(line: CutLine, cells: CutCells) -> dict[str, NDArray[np.floating]]:
    """Return the gap coordinates or the observable of cells along a line, as columns over the parameter ``x``."""
    x, ordinates = line.points(cells.index)[line.axis], cells.results["shown"]
    known = np.isfinite(ordinates)
    return {"x": np.broadcast_to(x[:, None], ordinates.shape)[known], "y": ordinates[known].astype(np.float32)}


def to_observe(subject: Subject) -> dict[str, Observable | None]:
    """Return the choices of a cut, by their words.

    They are section states, impacts, maxima and minima of the gap coordinate, and energy losses.
    """
    definition = subject.system.definition
    names = [part.name for part in definition.contacts] if len(definition.contacts) > 1 else []
    texts = [":".join(filter(None, (kind, name))) for kind in OF_IMPACTS for name in ("", *names)]
    texts = texts if definition.contacts else []
    texts += [f"{kind}:{GAP}" for kind in (MAXIMUM, MINIMUM)] + [ENERGY_LOSS]
    observables = [Observable.parse(text, definition) for text in texts]
    return {SECTION_WORDS: None} | {part.words: part for part in observables}
