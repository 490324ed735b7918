"""``solve_basins``: which attractor each of many initial states of one machine reaches, by one table of attractors.

The table is made first, from a set of initial states that depends on the parameters and ``Starts`` alone. What an
initial state reaches beyond it is told by ``added`` once all of them are solved. So labels depend neither on the tiles
in which they were solved nor on their order.
"""

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.attractors.known import Attractor, Known, attractor_of_orbit
from workers.attractors.search import Found, motions_at_once, search
from workers.attractors.starts import Starts
from workers.attractors.waves import STABLE, STATISTICAL, Coexistence
from workers.cell.cells import Array
from workers.cell.stretch import batch_of, run
from workers.kernel.cells import physical_states, start_motions
from workers.kernel.motion import motions_at
from workers.model.oscillator import Oscillator, taken
from workers.model.system import System, find_system
from workers.results import (
    BEYOND_TABLE,
    LABEL,
    REGIME,
    SETTLED,
    UNKNOWN_LABEL,
    empty_results,
    result_variables,
)
from workers.settings import Settings
from workers.tile import Solution


class Table:
    """The attractors that the reference set of one machine reaches, those of larger share first.

    cells     the machine as a cell, whose only entry of ``tallies`` has them
    """

    def __init__(self, record: System, values: Mapping[str, float], settings: Settings, starts: Starts) -> None:
        here = {name: np.array([value]) for name, value in values.items()}
        oscillators, reasons = record.build_many(here)
        own = np.array([[values[name] for name in record.states]])
        self.record, self.settings, self.values = record, settings, dict(values)
        self.cells = Coexistence(oscillators, reasons, own, settings, starts, record.states)
        self.cells.solve()
        tally = self.cells.tallies[0]
        tally.attractors.sort(key=lambda each: each.order)

    @property
    def attractors(self) -> list[Attractor]:
        """All of them; a label is a place in this list."""
        return self.cells.tallies[0].attractors

    @property
    def oscillator(self) -> Oscillator:
        """The machine, as a record of many."""
        return self.cells.oscillators

    def mirrors(self) -> NDArray[np.int64]:
        """The label of the mirror image of each attractor, -1 where none is known; of a symmetric one its own."""
        symmetric = bool(self.oscillator.symmetric[0] > 0.0)
        images = [each.image(symmetric) for each in self.attractors]
        places = [next((k for k, other in enumerate(self.attractors) if other is image), -1) for image in images]
        return np.array(places, dtype=np.int64)

    def known(self) -> Known:
        """The attractors as motions are compared with them."""
        return Known(self.oscillator, [self.attractors])


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
    given = {p.name: np.asarray(params.get(p.name, p.default), dtype=np.float64) for p in record.parameters}
    for name, value in given.items():
        if name not in record.states and value.size and np.ptp(value) > 0.0:
            raise ValueError(f"{name}: found {value.min():g} to {value.max():g}, basins are of one machine")
    shape = np.broadcast_shapes(*(value.shape for value in given.values()))
    states = np.stack([np.broadcast_to(given[name], shape).ravel() for name in record.states], axis=-1)
    table = reference_table(record, fixed_values(record, given), settings, starts)
    variables = result_variables(settings, basins=True)
    size = len(record.states)
    sizes = {"exponent": size, "state": size, "sample": settings.section_samples}
    found = empty_results(variables, (len(states),), sizes)
    at_once = motions_at_once(settings, size)
    for begin in range(0, len(states), at_once):
        part = slice(begin, begin + at_once)
        _label(table, states[part], {name: array[part] for name, array in found.items()})
    return Solution({name: array.reshape(shape + array.shape[1:]) for name, array in found.items()})


def fixed_values(record: System, given: Mapping[str, Any]) -> dict[str, float]:
    """The parameters of the one machine; its initial state is at rest, whatever the plane is of."""
    at_rest = {name: record.parameter(name).default for name in record.states}
    return {p.name: float(np.ravel(given[p.name])[0]) for p in record.parameters} | at_rest


def reference_table(record: System, values: Mapping[str, float], settings: Settings, starts: Starts) -> Table:
    """The table of a machine. One that was made is kept, for the other tiles that this process solves."""
    return _table(json.dumps(record.resolved()), tuple(values.items()), settings, starts)


@lru_cache(maxsize=4)
def _table(system: str, values: tuple[tuple[str, float], ...], settings: Settings, starts: Starts) -> "Table":
    return Table(System.from_resolved(json.loads(system)), dict(values), settings, starts)


def _label(table: Table, states: Array, found: dict[str, NDArray[Any]]) -> None:
    """Write the results of these initial states (N, 2n)."""
    N = len(states)
    all_one = np.zeros(N, dtype=np.int64)
    reached = search(
        taken(table.oscillator, all_one),
        table.cells.reasons[all_one],
        states,
        table.settings,
        table.known(),
        all_one,
        references=False,
    )
    for name, values in reached.arrays.items():
        found[name][:] = values
    for r in np.flatnonzero((reached.label < 0) & np.isin(found[REGIME.name], STABLE)):  # proved anew
        known = table.cells.same(0, attractor_of_orbit(table.oscillator, 0, reached, int(r)))
        if known is not None:
            reached.label[r] = table.attractors.index(known)
    for label, each in enumerate(table.attractors):
        rows = np.flatnonzero(reached.label == label)
        for name, value in each.result.items():
            found[name][rows] = value
    on_attractor = np.isin(found[REGIME.name], (*STABLE, *STATISTICAL))
    found["periods_used"][:] = reached.used
    found[SETTLED.name][on_attractor] = reached.settled[on_attractor]
    found[LABEL.name][:] = np.where(
        reached.label >= 0, reached.label, np.where(on_attractor, BEYOND_TABLE, UNKNOWN_LABEL)
    )


def added(table: Table, states: Array) -> NDArray[np.int64]:
    """Labels (N,) of what the table has not, given by states (N, 2n) on its attractors; it gets what it has not.

    The order of the states decides the order of new labels. UNKNOWN_LABEL where a state turns out to be on none.
    """
    alone, found = np.zeros(1, dtype=np.int64), []
    for k, state in enumerate(states):
        reached = search(
            table.oscillator, table.cells.reasons, state[None], table.settings, table.known(), alone, references=True
        )
        found.append(_place(table, reached, table.cells.starts.count + k))
    return np.array(found, dtype=np.int64)


def section_points(table: Table, count: int) -> Array:
    """Physical section states (A, count, 2n) of every attractor: of an orbit each once, the rest NaN."""
    N, size = len(table.attractors), table.oscillator.to_physical.shape[1]
    found = np.full((N, count, size), np.nan)
    if not N:
        return found
    rows = np.arange(N)
    oscillators = taken(table.oscillator, np.zeros(N, dtype=np.int64))
    motions = motions_at(np.zeros((N, size // 2, 2)))
    start_motions(oscillators, motions, np.stack([each.result["state"] for each in table.attractors]), rows)
    motions.contact[:, 0] = [each.contact for each in table.attractors]
    batch = batch_of(oscillators, motions)
    for k in range(count):
        found[:, k] = physical_states(oscillators, batch.motions, rows)
        batch.periods[:], batch.done[:] = 1, 0
        run(batch, rows)
    for each, points in zip(table.attractors, found, strict=True):
        if each.period:
            points[each.period :] = np.nan
    return found


def _place(table: Table, reached: Found, start: int) -> int:
    """The label of what a motion has reached; the table gets it where it has it not."""
    if reached.label[0] >= 0:
        return int(reached.label[0])
    table.cells.put(0, start, reached, 0)
    return next((k for k, each in enumerate(table.attractors) if start in each.starts), UNKNOWN_LABEL)
