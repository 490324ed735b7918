"""Stable orbits of cells: orbits proved to attract the motion, and known coexisting ones."""

from typing import Any

import numpy as np

from workers.cell.cell_batch import CellBatch
from workers.cell.interval import batch_of, run
from workers.cell.outcome import put_periodic
from workers.model.hybrid_modes import OPEN, SIGNALS, ModeCode, build_modes
from workers.model.machines import Machines
from workers.model.oscillator import COLUMN, NUMBER, Array, Mask, Oscillator, Rows, at_rows
from workers.orbit.newton import settle_cells
from workers.orbit.rest import rest_to_rest

NEAR_RETURN = 1e-2
"""Maximum distance of a state from an earlier one, relative to the motion's scale, at which a stable orbit is sought.
"""

LONG_PERIOD, LONG_ORBIT_BATCH = 1000, 64
"""Longest period sought if an average indicates an orbit; number of cells whose section states are stored together
then."""


def end_on_orbits(cells: CellBatch, rows: Rows, budget: Rows, near: Array) -> Rows:
    """Write the results of cells proved to converge to a stable orbit; return the other cells.

    rows    cells at the end of an interval
    budget  (N,) periods that may be spent on the search
    near    (N,) distance from a former state, relative to the motion, below which an orbit is sought
    """
    spent = np.zeros_like(cells.periods_used)
    proved = _settled(
        rows, cells.oscillators, cells.bare.motions, cells.batch.sections, cells.known_section_count(), near,
        cells.settings.max_period, budget, cells.orbits, spent,
    )  # fmt: skip
    cells.periods_used[rows] += spent[rows]
    put_periodic(cells, rows[proved])
    return rows[~proved]


def _settled(rows: Rows, oscillators: Oscillator, *arguments: Any) -> Mask:
    """Return the mask of cells ``rows`` that are proved to converge to an orbit, by ``settle_cells``.

    The further arguments are those of settle_cells. If a mode, a set of linear equations between events, was missing,
    it is built, and the cells are tried again.
    """
    *inputs, orbits, spent = arguments
    proved = np.zeros(len(oscillators.tau), dtype=np.bool_)

    def settle(tried: Rows) -> None:
        proved[tried] = settle_cells(oscillators, *inputs, tried, orbits, spent)

    if len(rows):
        oscillators.with_modes(settle, rows)
    return proved[rows]


def end_on_long_orbits(cells: CellBatch, rows: Rows) -> Rows:
    """Write the results of cells proved to converge to orbits of up to LONG_PERIOD periods; return the other cells.

    Each motion is simulated for as many periods, after which such an orbit would close. Cells without the budget for
    these periods are not tried.
    """
    tried = rows[cells.budget()[rows] > LONG_PERIOD + 1]
    for first in range(0, len(tried), LONG_ORBIT_BATCH):
        some = tried[first : first + LONG_ORBIT_BATCH]
        put_periodic(cells, some[_prove_long(cells, some)])
    return rows[cells.is_active[rows]]


def _prove_long(cells: CellBatch, rows: Rows) -> Mask:
    """Return the mask of cells that are proved to converge to an orbit of up to LONG_PERIOD periods.

    Motions that rest are compared after a rest, where rounding has grown least.
    """
    every, length, budget = np.arange(len(rows)), LONG_PERIOD + 1, cells.budget()[rows]
    batch = batch_of(at_rows(cells.oscillators, rows), at_rows(cells.bare.motions, rows), length)
    orbits, spent, proved = at_rows(cells.orbits, rows), 0 * every, np.zeros(len(rows), np.bool_)
    batch.periods[:] = length
    resting = cells.is_at_rest(rows)
    run(batch, every[~resting])
    counts = np.where(batch.completed == length, length, 0)
    flown = batch.completed + rest_to_rest(batch.oscillators, batch.motions, every[resting], batch.sections, counts)
    through = every[counts > 0]
    proved[through] = _settled(
        through, batch.oscillators, batch.motions, batch.sections, counts, np.full(len(rows), NEAR_RETURN), LONG_PERIOD,
        budget - flown, orbits, spent,
    )  # fmt: skip
    cells.periods_used[rows] += flown + spent
    for mine, new in zip(cells.orbits, orbits, strict=True):
        mine[rows] = new
    return proved


def has_coexisting_orbit(cells: CellBatch, rows: Rows) -> Mask:
    """Return the mask of cells with a known stable orbit apart from their motion.

    Motion without impact is such an orbit if the forced response stays inside the stops, every mode of vibration is
    damped and no load moves a rigid mode. An orbit that the motion came near and left again is another. A single mass
    also has an orbit if a stop can hold it at some phase of the force: the motion after a release repeats after the
    next rest.
    """
    if cells.oscillators.has_modes:
        machines = at_rows(cells.oscillators.table.machines, rows)
        return np.asarray(cells.orbits.near[rows] | moves_freely(machines) | rests_alone(machines))
    osc = at_rows(cells.oscillators, rows)
    damped = np.all((osc.gap.eta > 0.0) & (osc.gap.load == 0.0), axis=-1) & (osc.growth == 0.0)
    stays_inside = osc.gap.amplitude < np.minimum(osc.b_upper, osc.b_lower)
    can_rest = (cells.directions == 2) & (osc.R < 1.0) & np.any(most_on_stops(osc) > 0.0, axis=1)
    return np.asarray(cells.orbits.near[rows] | (damped & stays_inside) | can_rest)


def moves_freely(machines: Machines) -> Mask:
    """Return the mask of machines with a damped steady motion inside all stops.

    The mask is False for machines with friction, or with phases that change more than contacts, since their motion is
    no sum of harmonics.
    """
    P, C, F = machines.sizes
    if F > 0 or machines.drifting >= 0:
        return np.zeros(len(machines.omega), dtype=np.bool_)
    (pieces, wrong), *others = (build_modes(machines, ModeCode(p, (OPEN,) * C, ())) for p in range(P))
    free = (wrong == 0) & np.all(pieces.blocks[:, 0, :, COLUMN.slow] > 0.0, axis=1)
    for other, _ in others:
        free &= np.all(other.acceleration == pieces.acceleration, axis=(1, 2))
        free &= np.all(other.drive == pieces.drive, axis=(1, 2, 3))
    signals = SIGNALS * np.arange(C)
    reach, offset = pieces.numbers[:, signals, NUMBER.amplitude], pieces.offset[:, signals]
    ends = pieces.ends[:, signals]
    inside = (offset + reach < ends[..., 1]) & (offset - reach > ends[..., 0])
    return np.asarray(free & np.all(inside, axis=1))


def rests_alone(machines: Machines) -> Mask:
    """Return the mask of single masses to which a rigid stop can stick.

    Force and load press the mass on the stop at some phase, or springs may do so.
    """
    harmonics = np.hypot(machines.force_sin, machines.force_cos).sum(axis=2)[..., 0]  # (N, P)
    if machines.dimension > 2:
        return np.zeros(len(machines.omega), dtype=np.bool_)
    row, stops = machines.row[..., 0], machines.stops  # (N, C), (N, C, 2)
    stands = np.isfinite(stops) & ((machines.soft == 0.0) & (machines.R < 1.0))[..., None]
    x = (np.where(stands, stops, 0.0) / row[..., None])[:, None]
    pull = machines.load[:, :, 0, None, None] - machines.stiffness[:, :, 0, 0, None, None] * x  # (N, P, C, 2)
    press = np.sign(row)[:, None, :, None] * np.array([-1.0, 1.0]) * pull + harmonics[..., None, None]
    pressed = np.any(press > 0.0, axis=1) | np.any(machines.soft > 0.0, axis=1)[:, None, None]
    return np.asarray(np.any(stands & pressed, axis=(1, 2)))


def most_on_stops(oscillators: Oscillator) -> Array:
    """Return the largest force (N, 2) that presses a single mass on the upper and on the lower stop.

    It is -infinity if the stop is missing.
    """
    sticking, stops = oscillators.sticking, np.stack([oscillators.b_upper, -oscillators.b_lower], axis=1)
    level = sticking.offset[:, 0] + sticking.blocks[:, 0, 0, -1, COLUMN.c0, None] * stops
    return np.where(
        np.isfinite(stops), sticking.numbers[:, 0, :, NUMBER.amplitude] - np.array([1.0, -1.0]) * level, -np.inf
    )
