"""Values of observables, by another pass over each motion: see model/observables.py.

Cells of known class are followed once more, as for their measures: over one turn of their orbit, or WINDOW periods.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from workers.cell.cell_batch import MIN_WORK, CellBatch
from workers.cell.interval import begin
from workers.cell.measures import KNOWN, MACHINES_PER_BLOCK, WORK_PER_PERIOD, measured_periods, starts_of, with_modes
from workers.cell.outcome import write_results
from workers.kernel.hybrid.measures import MeasurePlan
from workers.kernel.motion import RUNNING
from workers.kernel.observables import COURSE, ObservableSelection, ObservedValues, observe_motions
from workers.model.definition import Definition
from workers.model.mode_table import build_hybrid
from workers.model.observables import IMPACT_PHASE, KINDS, MAXIMUM, MINIMUM, Observable, observables_of
from workers.model.oscillator import Array, Mask, Oscillator, Rows
from workers.results import NO_REASON

Values = dict[str, Any]
"""Values (N, K) and counts (N,) of observables, by the names of their results."""


@np.errstate(all="ignore")
def observe(cells: CellBatch, definition: Definition, params: Mapping[str, Array]) -> None:
    """Write the values of the requested observables, such as phases of impacts, of cells with a known class of motion.

    ``params`` are the parameters (N,) of all cells by name.
    """
    observables = observables_of(cells.settings.observe, definition)
    rows = np.flatnonzero(np.isin(cells.results["regime"], KNOWN))
    for first in range(0, len(rows) if observables else 0, MACHINES_PER_BLOCK):
        some = rows[first : first + MACHINES_PER_BLOCK]
        values = {name: value[some] for name, value in params.items()}
        machines = with_modes(cells, some, definition, values)
        periods, closes = measured_periods(cells, some)
        motions = *starts_of(cells, some, closes), periods, closes
        outputs = outputs_for(observables, definition, values)
        observed, complete = record_observables(
            machines, observables, outputs, motions, cells.settings.observe_values, definition.turns
        )
        write_results(cells, some[complete], **{name: value[complete] for name, value in observed.items()})


def record_observables(
    machines: Oscillator,
    observables: tuple[Observable, ...],
    outputs: tuple[Array, Array],
    motions: tuple[Array, Rows, Rows, Mask],
    limit: int,
    turns: int,
) -> tuple[Values, Mask]:
    """Return the first values of each observable of N motions, and the mask of motions that could be followed.

    machines     N machines with modes
    observables  M observables
    outputs      rows and derivatives of the observables, see outputs_for
    motions      physical states (N, 2n), numbers (N, 1) of modes (linear equations between events), periods
                 (N,), and a mask of motions that close
    limit        maximum number of values of an observable
    turns        periods 2 pi / omega in a period of the machine, see Definition

    The periods of a motion that closes are one turn of an orbit.
    """
    states, codes, periods, closes = motions
    N, M, mode_machines = len(states), len(observables), machines.table.machines
    selection = ObservableSelection(
        np.array([KINDS.index(observable.kind) for observable in observables]),
        np.array([observable.contact for observable in observables]),
        np.array([observable.side for observable in observables]),
    )
    counts, endless = np.zeros((2, N, M), dtype=np.int64)
    seen = ObservedValues(np.full((N, M, limit), np.nan), counts, endless, np.zeros((N, M, len(COURSE))))
    seen.course[..., COURSE.value] = np.nan
    starts, states, codes, status = (states, codes), states.copy(), codes.copy(), np.full(N, RUNNING)
    periods = periods.astype(np.int64)  # results have int32, for which kernels would be compiled again
    turns_of_outputs = any(observable.kind in (MAXIMUM, MINIMUM) for observable in observables)
    completed = np.where(closes & turns_of_outputs, -periods, 0)
    allowance = MIN_WORK + WORK_PER_PERIOD * (periods - completed).astype(np.float64)
    meters = MeasurePlan(
        *outputs,
        np.zeros_like(outputs[1]),
        mode_machines.damping,
        mode_machines.contact_constants,
        mode_machines.friction_constants,
        mode_machines.contact_laws,
        mode_machines.friction_laws,
    )

    def see(some: Rows) -> None:
        motion = starts, states, codes, completed, periods, closes.astype(np.int64), allowance, some
        status[some] = observe_motions(machines, meters, selection, seen, *motion)[some]

    machines.with_modes(see, np.arange(N))
    numbers, results = np.where(endless > 0, -1, counts), Values()
    for m, observable in enumerate(observables):
        column = seen.values[:, m]
        if observable.kind == IMPACT_PHASE:  # phase of the machine, with frequency omega / turns
            column = np.mod(turns * column, observable.modulus)
        results |= {observable.variable: column, observable.number: numbers[:, m]}
    return results, status == RUNNING


def outputs_for(
    observables: tuple[Observable, ...], definition: Definition, values: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return the weights (N, M, n) of the coordinates in M observables, and the derivatives (N, M) on which they act.

    A derivative is an index in model/measures.ORDERS; see Observable.row.
    """
    rows_of = [observable.row(definition, values) for observable in observables]
    rows = np.stack([row for row, _ in rows_of], axis=1)
    return rows, np.tile([order for _, order in rows_of], (len(rows), 1))


def observe_orbits(
    definition: Definition, values: Mapping[str, Array], states: Array, periods: Rows, observed_by: str, limit: int
) -> Values:
    """Return the values of observables on N orbits over one turn, from states at a section t = k T.

    definition   definition of the system
    values       parameters (N,) by name
    states       (N, 2n) physical section states
    periods      (N,) periods of the orbits
    observed_by  names of the observables, separated by commas
    limit        maximum number of values of an observable

    Values are NaN, and counts 0, if an orbit cannot be followed.
    """
    observables = observables_of(observed_by, definition)
    machines, reasons = build_hybrid(definition.machines(values))
    begun, reasons = begin(machines, reasons, states)
    motions = states, begun.mode, periods, np.ones(len(states), dtype=bool)
    observed, complete = record_observables(
        machines, observables, outputs_for(observables, definition, values), motions, limit, definition.turns
    )
    valid = complete & (reasons == NO_REASON)
    for observable in observables:
        observed[observable.variable][~valid], observed[observable.number][~valid] = np.nan, 0
    return observed
