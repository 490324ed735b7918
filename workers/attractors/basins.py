"""``solve_basins``: which attractor each of many initial states of one machine reaches, by one table of attractors.

The table is made first, from a set of initial states that depends only on the parameters and ``AttractorSettings``.
Attractors beyond the table are labelled by ``labels_beyond`` once all initial states are solved. Labels therefore
depend neither on the tiles in which the states were solved nor on their order.
"""

import json
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.attractors.attractor import ON_ATTRACTOR, SHOWN, Attractor
from workers.attractors.cell_attractors import attractor_of
from workers.attractors.coexistence import CoexistenceSearch
from workers.attractors.initial_states import AttractorSettings
from workers.attractors.search import MotionSearch, motions_at_once
from workers.cell.cell_batch import Results
from workers.cell.interval import begin, sections_from
from workers.model.natural_period import set_period
from workers.model.oscillator import Array, at_rows
from workers.model.system import System, find_system
from workers.results import BEYOND_TABLE, LABEL, NO_REASON, SETTLED, UNKNOWN_LABEL
from workers.settings import Settings
from workers.tile import initial_state, solve_parts


class AttractorTable(CoexistenceSearch):
    """The attractors of one machine that a fixed set of initial states reaches, the largest share first.

    A label is an index into ``attractors``.
    """

    def __init__(
        self, system: System, values: Mapping[str, float], settings: Settings, starts: AttractorSettings
    ) -> None:
        super().__init__(system, {name: np.array([value]) for name, value in values.items()}, settings, starts)
        self.solve()
        (self.cell,) = self.cells
        self.attractors = self.cell.attractors
        self.attractors.sort(key=lambda attractor: attractor.order)

    def mirror_labels(self) -> NDArray[np.int64]:
        """Return the labels of the mirror images, -1 if one is unknown; a symmetric attractor has its own label."""
        return np.array([self.label(self.cell.image(attractor)) for attractor in self.attractors], dtype=np.int64)

    def search_from(self, states: Array, references: bool) -> MotionSearch:
        """Simulate motions from physical states (N, 2n), and return the search with the attractors that they reach.

        The motions are compared with the attractors of the table. With ``references`` the statistics of new chaos and
        tori are collected.
        """
        search = self.search(np.zeros(len(states), dtype=np.int64), states)
        search.solve(references)
        return search

    def label(self, attractor: Attractor | None) -> int:
        """Return the label of an attractor of the table, UNKNOWN_LABEL for None."""
        return UNKNOWN_LABEL if attractor is None else self.attractors.index(attractor)


def solve_basins(
    system: str | System,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    starts: AttractorSettings | None = None,
) -> Results:
    """Return the attractor that every initial state reaches, as arrays of the initial states' broadcast shape.

    system    as for ``solve_tile``
    params    as for ``solve_tile``; only components of the initial state may have several values
    settings  as for ``solve_tile``
    starts    the initial states that find the attractors

    The results describe the attractor. ``label`` is its index in the table, and ``settled`` the number of periods until
    the motion is on it. A motion on an attractor beyond the table has the label BEYOND_TABLE and its own results;
    UNKNOWN_LABEL means that no attractor is known. Raise the errors of ``solve_tile``, and ValueError if a parameter
    other than an initial state has several values.
    """
    record, settings, starts = find_system(system), settings or Settings(), starts or AttractorSettings()
    for name, value in params.items():
        array = np.asarray(value, dtype=np.float64)
        if name not in record.states and array.size and np.ptp(array) > 0.0:
            raise ValueError(
                f"{name}: found {array.min():g} to {array.max():g}, must be one value: a basin is of one machine"
            )
    machine = tuple(fixed_values(record, params).items())
    table = reference_table(json.dumps(record.to_resolved()), machine, settings, starts)
    variables, at_once = record.variables(settings, basins=True), motions_at_once(settings, len(record.states))
    return solve_parts(record, params, settings, variables, at_once, partial(_solve_part, table))


def fixed_values(system: System, params: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters of the machine by name, with defaults for the components of its initial state.

    All initial states of a plane of basins thus give the same result.
    """
    given = {name: float(np.ravel(value)[0]) for name, value in params.items() if name not in system.states}
    return {name: float(value) for name, value in system.complete(given).items()}


@lru_cache(maxsize=4)
def reference_table(
    system: str, values: tuple[tuple[str, float], ...], settings: Settings, starts: AttractorSettings
) -> AttractorTable:
    """Return the table of a machine, kept for other tiles that this process solves.

    ``system`` is ``System.to_resolved`` as JSON.
    """
    return AttractorTable(System.from_resolved(json.loads(system)), dict(values), settings, starts)


def _solve_part(table: AttractorTable, params: Mapping[str, Array], arrays: Results) -> None:
    """Write the results of N initial states into ``arrays``: the attractor that each reaches, and how soon.

    table   the attractors of the machine
    params  parameters (N,) by name, with the components of the initial states
    arrays  result arrays (N, ...) by name
    """
    search = table.search_from(initial_state(table.record, params), references=False)
    label, regime = search.label.copy(), search.regime
    for r in np.flatnonzero((label < 0) & np.isin(regime, SHOWN)).tolist():  # solved in full
        new = attractor_of(table.oscillators, search, r)
        label[r] = table.label(table.cell.find_same(new)[0] if new else None)
    for name, values in search.cells.results.items():
        arrays[name][:] = values
    for k, attractor in enumerate(table.attractors):
        for name, value in attractor.result.items():
            arrays[name][label == k] = value
    on_attractor = (label >= 0) | np.isin(regime, ON_ATTRACTOR)
    arrays["periods_used"][:] = search.cells.periods_used
    settled = np.where(search.arrival >= 0, search.arrival, search.cells.periods_flown)
    arrays[SETTLED.name][on_attractor] = settled[on_attractor]
    arrays[LABEL.name][:] = np.where(label >= 0, label, np.where(on_attractor, BEYOND_TABLE, UNKNOWN_LABEL))


def labels_beyond(table: AttractorTable, states: Array) -> NDArray[np.int64]:
    """Return the labels (N,) of states (N, 2n) on attractors beyond the table, and add new attractors to the table.

    The order of the states decides the order of new labels. A state that is on no attractor after all has
    UNKNOWN_LABEL.
    """
    labels = np.full(len(states), UNKNOWN_LABEL, dtype=np.int64)
    for k in range(len(states)):
        search = table.search_from(states[k : k + 1], references=True)
        labels[k] = table.label(table.cell.assign(table.starts.count + k, search, 0))
    return labels


def section_points(table: AttractorTable, count: int) -> Array:
    """Return states (A, count, 2n) of all A attractors at sections t = k T, T the forcing period.

    An orbit has each of its states once, the rest NaN. States of a limit cycle without a force lie evenly in time along
    the cycle.
    """
    N, size = len(table.attractors), table.oscillators.to_physical.shape[1]
    states = np.array([attractor.result["state"] for attractor in table.attractors]).reshape(N, size)
    mode = np.array([attractor.mode for attractor in table.attractors], dtype=np.int64)
    oscillators = at_rows(table.oscillators, np.zeros(N, dtype=np.int64))
    lengths = np.array([attractor.cycle.period if attractor.cycle else np.nan for attractor in table.attractors])
    cycles = np.flatnonzero(~np.isnan(lengths))
    if len(cycles):
        set_period(oscillators, cycles, lengths[cycles] / count)
    motions, _ = begin(oscillators, np.full(N, NO_REASON, dtype=np.int8), states, mode)
    sections = np.full((N, count, size), np.nan)
    counts = np.array([min(attractor.period or count, count) for attractor in table.attractors], dtype=np.int64)
    counts[cycles] = count
    points = sections_from(oscillators, motions, counts)
    sections[:, : points.shape[1]] = points
    return sections
