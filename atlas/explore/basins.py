"""The basins of a clicked cell: the attractor that each initial state of a plane reaches."""

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
"""Number of initial states along each axis."""
UNSOLVED = -9
"""Label of an initial state that is not solved yet."""
BAND = 8
"""Number of rows of initial states in one job."""


@dataclass(frozen=True, eq=False)
class BasinGrid:
    """A plane of initial states of one machine.

    system       the system
    parameters   value of each parameter, by name
    settings     settings of the solver
    starts       settings of the attractor search
    x, y         name and values (SIDE,) of a displacement, across, and of its velocity, up
    """

    system: System
    parameters: Mapping[str, float]
    settings: Settings
    starts: AttractorSettings
    x: tuple[str, NDArray[np.float64]]
    y: tuple[str, NDArray[np.float64]]

    @classmethod
    def from_cell(cls, subject: Subject, parameters: Mapping[str, float]) -> "BasinGrid":
        """Return the plane of the displacement that a stop limits, over the range of initial states in the attractor
        search.
        """
        system, starts = subject.system, subject.starts
        oscillators, _ = system.build_many({name: np.array([value]) for name, value in parameters.items()})
        low, high = boxes(starts, oscillators, system)
        n = len(system.states) // 2
        k = int(np.flatnonzero(oscillators.gap_row[0])[0])
        sides = [(system.states[i], np.linspace(low[0, i], high[0, i], SIDE + 2)[1:-1]) for i in (k, n + k)]
        return cls(system, parameters, subject.settings, starts, *sides)

    @property
    def box(self) -> dict[str, list[float]]:
        """The rectangle of the picture whose pixels have the initial states at their centres."""
        (x, width), (y, height) = ((values[0], values[1] - values[0]) for _, values in (self.x, self.y))
        size = {"w": [width * self.x[1].size], "h": [height * self.y[1].size]}
        return {"x0": [x - 0.5 * width], "y0": [y - 0.5 * height]} | size


def label_computation(grid: BasinGrid, rows: slice) -> Computation[tuple[slice, NDArray[np.int32]]]:
    """Return the computation that solves some rows of a plane of initial states."""
    count = len(grid.x[1]) * len(grid.y[1][rows])
    return Computation(solve_rows, (grid, rows), lambda labels: (rows, labels), count)


def solve_rows(given: tuple[BasinGrid, slice]) -> NDArray[np.int32]:
    """Return the labels (rows, SIDE) of the attractors that initial states reach; negative for an unknown attractor."""
    from workers.attractors.basins import solve_basins

    grid, rows = given
    compile_once(*kernels_for(grid.system, ATTRACTORS))
    (x, across), (y, up) = grid.x, grid.y
    states = {x: across[None, :], y: up[rows, None]}
    return solve_basins(grid.system, {**grid.parameters, **states}, grid.settings, grid.starts)[LABEL.name]
