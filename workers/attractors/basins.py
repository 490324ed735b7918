"""``solve_basins``: which attractor each of many initial states of one machine reaches, by one table of attractors.

The table is made first, from a set of initial states that depends on the parameters and ``Starts`` alone. What an
initial state reaches beyond it is told by ``added`` once all of them are solved. So labels depend neither on the tiles
in which they were solved nor on their order.
"""

import json
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.attractors.cell import attractor_of_orbit
from workers.attractors.record import STABLE, STATISTICAL, Attractor, Found
from workers.attractors.search import motions_at_once
from workers.attractors.starts import Starts
from workers.attractors.waves import Coexistence
from workers.cell.cells import Array
from workers.cell.stretch import sections_from
from workers.kernel.cells import start_motions
from workers.kernel.motion import motions_at
from workers.model.oscillator import Oscillator, taken
from workers.model.system import System, find_system
from workers.results import BEYOND_TABLE, LABEL, SETTLED, UNKNOWN_LABEL, result_variables
from workers.settings import Settings
from workers.tile import Solution, initial_state, solve_parts


class Table:
    """The attractors that the reference set of one machine reaches, those of larger share first."""

    def __init__(self, record: System, values: Mapping[str, float], settings: Settings, starts: Starts) -> None:
        self.machine = Coexistence(record, {k: np.array([value]) for k, value in values.items()}, settings, starts)
        self.machine.solve()
        (self.cell,) = self.machine.cells
        self.record, self.settings, self.starts = record, settings, starts
        self.attractors.sort(key=lambda each: each.order)

    @property
    def attractors(self) -> list[Attractor]:
        """All of them; a label is a place in this list."""
        return self.cell.attractors

    @property
    def oscillator(self) -> Oscillator:
        """The machine, as a record of many."""
        return self.cell.oscillator

    def mirrors(self) -> NDArray[np.int64]:
        """The label of the mirror image of each attractor, -1 where none is known; of a symmetric one its own."""
        return np.array([self.label(each.image(self.cell.symmetric)) for each in self.attractors], dtype=np.int64)

    def search(self, states: Array, references: bool) -> Found:
        """What motions from physical states (N, 2n) come to, compared with the attractors of the table."""
        return self.machine.search(np.zeros(len(states), dtype=np.int64), states).solve(references)

    def label(self, attractor: Attractor | None) -> int:
        """The label of an attractor of the table."""
        return UNKNOWN_LABEL if attractor is None else self.attractors.index(attractor)


def solve_basins(
    system: str | System,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    starts: Starts | None = None,
) -> Solution:
    """What every initial state reaches, as arrays of the broadcast shape of the initial states; as solve_cells else.

    Only components of the initial state may have several values. Results are those of the attractor, and besides
    ``label``, its place in the table, and ``settled``, the periods until the motion is on it. BEYOND_TABLE is the label
    of what is on an attractor that the table has not: its results are its own. UNKNOWN_LABEL: no attractor is known.
    Raises ValueError for a parameter, other than an initial state, of several values.
    """
    record, settings, starts = find_system(system), settings or Settings(), starts or Starts()
    for name, value in params.items():
        if name not in record.states and np.size(value) and np.ptp(value) > 0.0:
            raise ValueError(f"{name}: found {np.min(value):g} to {np.max(value):g}, basins are of one machine")
    machine = tuple(fixed_values(record, params).items())
    table = reference_table(json.dumps(record.resolved()), machine, settings, starts)
    variables, at_once = result_variables(settings, basins=True), motions_at_once(settings, len(record.states))
    return solve_parts(record, params, settings, variables, at_once, partial(_solve_part, table))


def fixed_values(record: System, given: Mapping[str, Any]) -> dict[str, float]:
    """The parameters of the one machine; its initial state is at rest, whatever the plane is of."""
    at_rest = {name: record.parameter(name).default for name in record.states}
    return {p.name: float(np.ravel(given.get(p.name, p.default))[0]) for p in record.parameters} | at_rest


@lru_cache(maxsize=4)
def reference_table(system: str, values: tuple[tuple[str, float], ...], settings: Settings, starts: Starts) -> Table:
    """The table of a machine, kept for other tiles that this process solves; ``system`` is System.resolved as JSON."""
    return Table(System.from_resolved(json.loads(system)), dict(values), settings, starts)


def _solve_part(table: Table, params: Mapping[str, Array], arrays: dict[str, NDArray[Any]]) -> None:
    """Write the results of the initial states among these parameters (N,)."""
    found = table.search(initial_state(table.record, params), references=False)
    label, regime = found.label.copy(), found.regime
    for r in np.flatnonzero((label < 0) & np.isin(regime, STABLE)).tolist():  # proved anew
        label[r] = table.label(table.cell.same(attractor_of_orbit(table.oscillator, found, r)))
    for name, values in found.cells.found.items():
        arrays[name][:] = values
    for k, each in enumerate(table.attractors):
        for name, value in each.result.items():
            arrays[name][label == k] = value
    on_attractor = (label >= 0) | np.isin(regime, (*STABLE, *STATISTICAL))
    arrays["periods_used"][:] = found.cells.used
    arrays[SETTLED.name][on_attractor] = found.settled[on_attractor]
    arrays[LABEL.name][:] = np.where(label >= 0, label, np.where(on_attractor, BEYOND_TABLE, UNKNOWN_LABEL))


def added(table: Table, states: Array) -> NDArray[np.int64]:
    """Labels (N,) of what the table has not, given by states (N, 2n) on its attractors; it gets what it has not.

    The order of the states decides the order of new labels. UNKNOWN_LABEL where a state turns out to be on none.
    """
    labels = np.full(len(states), UNKNOWN_LABEL, dtype=np.int64)
    for k in range(len(states)):
        found = table.search(states[k : k + 1], references=True)
        known = int(found.label[0])
        labels[k] = known if known >= 0 else table.label(table.cell.put(table.starts.count + k, found, 0))
    return labels


def section_points(table: Table, count: int) -> Array:
    """Physical section states (A, count, 2n) of every attractor: of an orbit each once, the rest NaN."""
    N, size = len(table.attractors), table.oscillator.to_physical.shape[1]
    oscillators, motions = taken(table.oscillator, np.zeros(N, dtype=np.int64)), motions_at(np.zeros((N, size // 2, 2)))
    states = np.array([each.result["state"] for each in table.attractors]).reshape(N, size)
    start_motions(oscillators, motions, states, np.arange(N))
    motions.contact[:, 0] = [each.contact for each in table.attractors]
    found = np.full((N, count, size), np.nan)
    counts = np.array([min(each.period or count, count) for each in table.attractors], dtype=np.int64)
    points = sections_from(oscillators, motions, counts)
    found[:, : points.shape[1]] = points
    return found
