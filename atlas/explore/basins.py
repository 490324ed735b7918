"""The basins of a cell that was clicked: which attractor each initial state of a plane of them reaches."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from atlas.explore.jobs import Computation
from atlas.explore.subject import Subject
from atlas.task.compile import ATTRACTORS, compile_once, kernels_for
from workers import Settings
from workers.attractors.initial_states import AttractorSettings, boxes
from workers.model.system import System
from workers.results import LABEL

SIDE = 96
"""Initial states along each axis."""
UNSOLVED = -9
"""The label of an initial state that is not solved yet."""
BAND = 8
"""Rows of them that a worker solves at a time."""


@dataclass(frozen=True, eq=False)
class BasinGrid:
    """A plane of initial states of one machine: a displacement across and its velocity up, (SIDE,) values of each."""

    system: System
    parameters: Mapping[str, float]
    settings: Settings
    starts: AttractorSettings
    x: tuple[str, NDArray[np.float64]]
    y: tuple[str, NDArray[np.float64]]

    @classmethod
    def from_cell(cls, subject: Subject, parameters: Mapping[str, float]) -> "BasinGrid":
        """The plane of the displacement that a stop limits, as far as initial states are sought there by default."""
        system, starts = subject.system, subject.starts
        oscillators, _ = system.build_many({name: np.array([value]) for name, value in parameters.items()})
        low, high = boxes(starts, oscillators, system)
        n = len(system.states) // 2
        k = int(np.flatnonzero(oscillators.gap_row[0])[0])
        sides = [(system.states[i], np.linspace(low[0, i], high[0, i], SIDE + 2)[1:-1]) for i in (k, n + k)]
        return cls(system, parameters, subject.settings, starts, *sides)

    @property
    def box(self) -> dict[str, list[float]]:
        """Where the picture lies whose pixels have the initial states at their centres."""
        (x, width), (y, height) = ((values[0], values[1] - values[0]) for _, values in (self.x, self.y))
        size = {"w": [width * self.x[1].size], "h": [height * self.y[1].size]}
        return {"x0": [x - 0.5 * width], "y0": [y - 0.5 * height]} | size


def label_computation(grid: BasinGrid, rows: slice) -> Computation[tuple[slice, NDArray[np.int32]]]:
    """Some rows of a plane of initial states to be solved."""
    count = len(grid.x[1]) * len(grid.y[1][rows])
    return Computation(solve_rows, (grid, rows), lambda labels: (rows, labels), count)


def solve_rows(given: tuple[BasinGrid, slice]) -> NDArray[np.int32]:
    """Labels (rows, SIDE) of the attractors that initial states reach; negative where none of the table is known."""
    from workers.attractors.basins import solve_basins

    grid, rows = given
    compile_once(*kernels_for(grid.system, ATTRACTORS))
    (x, across), (y, up) = grid.x, grid.y
    states = {x: across[None, :], y: up[rows, None]}
    return solve_basins(grid.system, {**grid.parameters, **states}, grid.settings, grid.starts)[LABEL.name]
