"""Measures of a machine, results of its contacts and friction one by one, and losses of energy.

They need another pass over the motion of each cell: over one turn of its orbit, or WINDOW periods if the class of its
motion is known but no orbit. Cells without a class keep their fill values.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.cell.cell_batch import MIN_WORK, CellBatch
from workers.cell.outcome import write_results
from workers.kernel.cell_loops import physical_states
from workers.kernel.hybrid.measures import MeasurePlan, MeasureTotals, read_motions
from workers.kernel.motion import FLIGHT, RUNNING, motions_at
from workers.model.definition import Definition
from workers.model.elements import Contact, Friction, Spring
from workers.model.energy import energy
from workers.model.hybrid_modes import ON
from workers.model.machines import Machines, about_centre, is_mirror_symmetric, is_undriven
from workers.model.measures import LAW_ERROR, RANGE_SHARE
from workers.model.mode_table import build_hybrid
from workers.model.oscillator import Array, Mask, Oscillator, Rows, at_rows
from workers.results import (
    APERIODIC,
    CONSERVATIVE,
    DIES_AWAY,
    NEVER_RECURS,
    OF_MOTIONS,
    PERIODIC,
    PERIODS_SPENT,
    UNDETERMINED,
    WORK_SPENT,
)

WINDOW = 256
"""Number of periods, from ``state`` on, over which motion without an orbit is measured."""

WORK_PER_PERIOD = 2000
"""Number of evaluations allowed for each measured period, in addition to MIN_WORK; motion that costs more is not
measured."""

MACHINES_PER_BLOCK = 512
"""Number of machines measured together: each has a table of its modes."""

KNOWN = (*sorted(OF_MOTIONS), APERIODIC)
"""Classes of motion for which the results that only this system has are computed."""

MIRRORED = 1e-6
"""Maximum distance between a state and the mirror image of the state half an orbit later, as a share of both, on an
orbit that counts as symmetric."""


@np.errstate(all="ignore")
def measure(cells: CellBatch, definition: Definition, params: Mapping[str, Array]) -> None:
    """Write the results that only this system has, its measures, contacts and losses, of cells with a known class.

    ``params`` are the parameters (N,) of all cells by name.
    """
    hybrid = cells.oscillators.has_modes
    if not (hybrid or definition.measures):
        return
    rows = np.flatnonzero(np.isin(cells.results["regime"], KNOWN))
    for first in range(0, max(len(rows), hybrid), MACHINES_PER_BLOCK):
        some = rows[first : first + MACHINES_PER_BLOCK]
        values = {name: value[some] for name, value in params.items()}
        machines = with_modes(cells, some, definition, values)
        periods, closes = measured_periods(cells, some)
        states, codes = starts_of(cells, some, closes)
        meters = _meters(machines, definition, values)
        readings, complete = follow_motions(machines, meters, states, codes, periods, closes & hybrid)
        span = periods * machines.period
        variables = _of_measures(definition, definition.outputs(values)[2], readings, span)
        if hybrid:
            mode_machines = machines.table.machines
            variables |= _of_machine(mode_machines, readings, closes, periods)
            variables |= _of_elements(definition, mode_machines, readings, closes, periods)
            variables |= _of_laws(definition, mode_machines, readings, values)
            counted, lost = cells.results["impact_energy"][some], np.sum(readings.stop, axis=1) / periods
            variables["impact_energy"] = np.where(np.isnan(counted), lost, counted)
        write_results(cells, some[complete], **{name: value[complete] for name, value in variables.items()})


def explain(cells: CellBatch, definition: Definition, params: Mapping[str, Array]) -> None:
    """Replace the reason of undetermined cells whose class no number of periods would decide.

    Motion of a machine that loses nothing never settles; growth has a reason of its own. Other motion without a
    drive dies away. ``params`` are the parameters (N,) of all cells by name.
    """
    reason = cells.results["reason"]
    undecided = cells.results["regime"] == UNDETERMINED
    rows = np.flatnonzero(undecided & np.isin(reason, (PERIODS_SPENT, NEVER_RECURS, WORK_SPENT)))
    if len(rows):
        machines = definition.machines({name: value[rows] for name, value in params.items()})
        lossless = cells.conservative[rows]
        reason[rows[~lossless & is_undriven(machines)]] = DIES_AWAY
        reason[rows[lossless & (reason[rows] != NEVER_RECURS)]] = CONSERVATIVE


def measure_energy(cells: CellBatch) -> None:
    """Write the change of energy of all motion of known class of machines without a force that lose nothing."""
    rows = np.flatnonzero(np.isin(cells.results["regime"], KNOWN) & cells.conservative)
    if not cells.unforced or not len(rows):
        return
    machines, ends = at_rows(cells.oscillators.table.machines, rows), cells.batch.motions
    (before, size), (after, later) = (
        energy(machines, states) for states in (cells.starts[rows], physical_states(cells.oscillators, ends, rows))
    )
    write_results(cells, rows, energy_error=np.abs(after - before) / np.maximum(size, later))


def with_modes(cells: CellBatch, rows: Rows, definition: Definition, values: Mapping[str, Array]) -> Oscillator:
    """Return the machines of these cells in the form with modes, in which their measures are read.

    A mode is a set of linear equations between two events. ``values`` (N,) are the parameters of the cells.
    """
    oscillators = cells.oscillators
    return at_rows(oscillators, rows) if oscillators.has_modes else build_hybrid(definition.machines(values))[0]


def measured_periods(cells: CellBatch, rows: Rows) -> tuple[Rows, Mask]:
    """Return the periods (N,) over which these cells are measured, and the mask of cells whose motion closes.

    The periods of a motion that closes are one turn of its orbit.
    """
    period = cells.results["period"][rows].astype(np.int64)
    closes = period > 0
    if not cells.oscillators.has_modes:  # without damping, impact-free motion need not repeat
        gap = cells.oscillators.gap
        damped = np.all((gap.eta > 0.0) | (gap.lam == 0.0), axis=-1)
        closes &= (cells.results["regime"][rows] == PERIODIC) | damped[rows]
    return np.where(closes, period, WINDOW), closes


def starts_of(cells: CellBatch, rows: Rows, closes: Mask) -> tuple[Array, Rows]:
    """Return states (N, 2n) at a section t = k T, from which these cells are measured, and numbers (N, 1) of modes.

    A mode is a set of linear equations between two events. ``closes`` is the mask of cells whose motion closes.
    """
    states, mode = cells.results["state"][rows], cells.mode[rows]
    proved = closes & (cells.oscillators.has_modes | (cells.results["regime"][rows] == PERIODIC))
    orbits = motions_at(cells.orbits.h, cells.orbits.mode)
    states[proved] = physical_states(cells.oscillators, orbits, rows[proved])
    mode[proved] = cells.orbits.mode[rows[proved], 0]
    if not cells.oscillators.has_modes:  # a motion about to leave a stop leaves it at once
        mode = np.clip(mode, FLIGHT - ON, FLIGHT + ON)
    return states, mode[:, None]


def _meters(machines: Oscillator, definition: Definition, values: Mapping[str, Array]) -> MeasurePlan:
    """Return the quantities to measure: measures, arguments of force laws, and the range of the pictured coordinate."""
    rows, orders, _ = definition.outputs(values)
    mode_machines: Machines = machines.table.machines
    more = [*_arguments(definition, mode_machines), (machines.gap_row, 0.0)]
    peaks = [*("peak" in measure.report for _, measure in definition.measures), *(True for _ in more)]
    return MeasurePlan(
        rows=np.concatenate([rows, np.stack([row for row, _ in more], axis=1)], axis=1),
        orders=np.concatenate([orders, np.tile([order for _, order in more], (len(rows), 1))], axis=1),
        peaks=np.tile(np.array(peaks, dtype=np.float64), (len(rows), 1)),
        damping=mode_machines.damping,
        contact_constants=mode_machines.contact_constants,
        friction_constants=mode_machines.friction_constants,
        contact_laws=mode_machines.contact_laws,
        friction_laws=mode_machines.friction_laws,
    )


def _arguments(definition: Definition, machines: Machines) -> list[tuple[Array, float]]:
    """Return (row, order) of the argument of each friction law and each spring law that is an expression.

    row    (N, n) weights of the coordinates in the argument
    order  1 if the weights act on velocities, as those of friction; else 0

    The argument of a contact's law, its depth, is measured anyway.
    """
    first = len(definition.contacts)  # the rows of springs follow those of contacts
    frictions = [
        (machines.friction_rows[:, f], 1.0) for f, e in enumerate(definition.friction) if e in definition.fitted
    ]
    springs = [(machines.row[:, first + s], 0.0) for s, e in enumerate(definition.springs) if e in definition.fitted]
    return frictions + springs


def follow_motions(
    machines: Oscillator, meters: MeasurePlan, states: Array, codes: Rows, periods: Rows, closes: Mask
) -> tuple[MeasureTotals, Mask]:
    """Return the measured totals of motions over ``periods`` (N,), and the mask of motions that could be followed.

    machines  N machines with modes
    meters    measured quantities
    states    (N, 2n) physical states at the start
    codes     (N, 1) numbers of the modes, the linear equations, at the start
    periods   (N,) periods
    closes    (N,) mask of motions for which the periods are one turn of an orbit
    """
    N, readings = len(states), _nothing_read(meters)
    states, codes, completed, status = states.copy(), codes.copy(), np.zeros(N, dtype=np.int64), np.full(N, RUNNING)
    allowance, turns = MIN_WORK + WORK_PER_PERIOD * periods.astype(np.float64), closes.astype(np.int64)

    def read(some: Rows) -> None:
        motion = states, codes, completed, periods, turns, allowance, some
        status[some] = read_motions(machines, meters, readings, *motion)[some]

    machines.with_modes(read, np.arange(N))
    return readings, status == RUNNING


def _nothing_read(meters: MeasurePlan) -> MeasureTotals:
    (N, M), C, F = meters.orders.shape, meters.contact_constants.shape[2], meters.friction_constants.shape[2]
    outputs, contacts, frictions = np.zeros((4, N, M)), np.zeros((5, N, C)), np.zeros((2, N, F))
    outputs[2], outputs[3] = np.inf, -np.inf
    return MeasureTotals(
        first=outputs[0], square=outputs[1], low=outputs[2], high=outputs[3],
        hits=np.zeros((N, C, 2)), endless=contacts[0], touching=contacts[1], stop=contacts[2], depth=contacts[3],
        force=contacts[4], stuck=frictions[0], rubbed=frictions[1], damped=np.zeros((N, 1)),
        halves=np.full((N, 2, 2 * meters.rows.shape[2]), np.nan),
    )  # fmt: skip


def _of_measures(definition: Definition, weights: Array, readings: MeasureTotals, span: Array) -> dict[str, Array]:
    """Return the results of the definition's measures by name.

    weights   (N, M) weight of each of M measures, the factor of its mean square in its power
    readings  totals over each motion
    span      (N,) durations of the motions
    """
    variables: dict[str, Array] = {}
    for m, (name, measure) in enumerate(definition.measures):
        square = readings.square[:, m] / span
        values = {
            "mean": readings.first[:, m] / span,
            "rms": np.sqrt(square),
            "peak": np.maximum(-readings.low[:, m], readings.high[:, m]),
            "power": weights[:, m] * square,
        }
        variables |= {f"{name}_{report}": values[report] for report in measure.report}
    return variables


def _of_machine(machines: Machines, readings: MeasureTotals, closes: Mask, periods: Rows) -> dict[str, NDArray[Any]]:
    """Return the results of whole machines by name: mirror symmetry, range of the pictured coordinate, loss in dampers.

    machines  N machines
    readings  totals over each motion
    closes    (N,) mask of motions that close after ``periods`` (N,)
    """
    centred, centre = about_centre(machines)
    halves = readings.halves - np.concatenate([centre, np.zeros_like(centre)], axis=1)[:, None]
    if machines.drifting >= 0:  # the position of the drifting coordinate has no effect
        halves = np.delete(halves, machines.drifting, axis=2)
    early, late = halves[:, 0], halves[:, 1]
    away = np.linalg.norm(early + late, axis=1)
    size = np.linalg.norm(early, axis=1) + np.linalg.norm(late, axis=1)
    return {
        "symmetric": is_mirror_symmetric(centred) & closes & (periods % 2 == 1) & (away <= MIRRORED * size),
        "peak_to_peak": readings.high[:, -1] - readings.low[:, -1],
        "damper_loss": readings.damped[:, 0] / periods,
    }


def _of_elements(
    definition: Definition, machines: Machines, readings: MeasureTotals, closes: Mask, periods: Rows
) -> dict[str, NDArray[Any]]:
    """Return the results of contacts and friction by name. A spring returns all energy, up to rounding.

    machines  N machines
    readings  totals over each motion
    closes    (N,) mask of motions that close after ``periods`` (N,)
    """
    variables: dict[str, NDArray[Any]] = {}
    span, pad = periods * 2.0 * np.pi / machines.omega, machines.contact_constants
    springs = (machines.soft > 0.0) & (machines.by_force == 0.0) & np.all(pad[..., 1] == 0.0, axis=1)
    springs &= np.all(pad == pad[:, :1], axis=(1, 3))
    for c, contact in enumerate(definition.contacts):
        name, endless = contact.name, readings.endless[:, c] > 0.0
        for side, key in enumerate(("lower", "upper")):
            if getattr(contact, key) is not None:
                variables[f"{name}_{key}"] = np.where(closes, np.where(endless, -1, readings.hits[:, c, side]), 0)
        variables[f"{name}_fraction"] = np.minimum(readings.touching[:, c] / span, 1.0)
        variables[f"{name}_loss"] = np.where(springs[:, c], 0.0, readings.stop[:, c] / periods)
        variables[f"{name}_penetration"], variables[f"{name}_force"] = readings.depth[:, c], readings.force[:, c]
    for f, friction in enumerate(definition.friction):
        variables[f"{friction.name}_stuck"] = np.minimum(readings.stuck[:, f] / span, 1.0)
        variables[f"{friction.name}_loss"] = readings.rubbed[:, f] / periods
    return variables


def _of_laws(
    definition: Definition, machines: Machines, readings: MeasureTotals, values: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the results of force laws that are expressions, by name: how far their range was used, and error bounds.

    machines  N machines
    readings  totals over each motion
    values    parameters (N,) by name
    """
    variables: dict[str, Array] = {}
    m = len(definition.measures)
    for element in definition.fitted:
        name, low, high = element.name, readings.low[:, m], readings.high[:, m]
        if isinstance(element, Contact):
            low, high = np.zeros(len(low)), readings.depth[:, definition.contacts.index(element)]
        else:
            m += 1
        if isinstance(element, Friction):
            belt = machines.belt[:, definition.friction.index(element)]
            ends = np.abs(low - belt), np.abs(high - belt)
            low, high = np.where((low <= belt) & (belt <= high), 0.0, np.minimum(*ends)), np.maximum(*ends)
            variables[f"{name}_speed"] = high
        if isinstance(element, Spring):
            variables[f"{name}_reach"] = np.maximum(np.abs(low), np.abs(high))
        variables[name + RANGE_SHARE], variables[name + LAW_ERROR] = definition.law_use(element, values, low, high)
    return variables
