"""Recurrence of motions: the amplitude of a torus or of chaos recurs, a growing amplitude does not."""

import numpy as np

from workers.cell.averages import counts
from workers.cell.cell_batch import RETURNS, CellBatch
from workers.cell.exponents import impact_count
from workers.model.oscillator import COLUMN, Array, Mask, Rows

FEWEST_HITS = 0.5
"""Minimum number of impacts in an interval of periods at which impacts count as continuing. The unit is the number
expected from the impacts so far."""

ENERGY_ROUNDING = 1e-6
"""Change of the energy of a machine that loses nothing, as a share of it, that may be due to rounding."""


class Recurrence:
    """History of N motions, which shows if they recur: energies at sections t = k T, and impacts.

    low, high    (N,) range of the energies seen so far
    hits, until  (N,) impacts and periods counted up to the last update
    struck       (N,) True if there has been an impact
    same         (N,) True if the energies of the last update were in the range of all earlier ones
    recurred     (N,) True if ``same`` was True in any update that counted, or if no update has counted yet
    counted      (N,) True if an update has counted
    strikes      (N,) True if impacts have continued at the expected rate, or if there never were any
    """

    def __init__(self, count: int) -> None:
        self.low, self.high = np.full(count, np.inf), np.full(count, -np.inf)
        self.hits, self.until = np.zeros((2, count))
        self.struck = np.zeros(count, dtype=np.bool_)
        self.same, self.strikes = np.ones((2, count), dtype=np.bool_)
        self.recurred, self.counted = np.ones(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)

    def update(self, cells: CellBatch, rows: Rows, settled: Mask) -> None:
        """Compare the last interval of these cells with earlier ones.

        The update counts once the transient is over (``settled``).

        The ranges of the energy of a torus, over any RETURNS sections t = k T, overlap. Decaying motion impacts ever
        more rarely: a single flight may last longer than all of the motion before it.
        """
        low, high = _energy_ranges(cells, rows)
        tally, periods = counts(cells, rows)
        hits = impact_count(tally)
        room = np.where(cells.conservative[rows], ENERGY_ROUNDING * high, 0.0)
        self.same[rows] = (low <= self.high[rows] + room) & (high >= self.low[rows] - room)
        fresh = periods <= self.until[rows]  # a new count
        before, since = np.where(fresh, 0.0, self.hits[rows]), np.where(fresh, 0.0, self.until[rows])
        due = hits / np.maximum(periods, 1) * (periods - since)
        self.struck[rows] |= hits > 0.0
        self.recurred[rows] = self.same[rows] | (self.recurred[rows] & (self.counted[rows] | ~settled))
        self.counted[rows] |= settled
        self.strikes[rows] = (hits - before >= FEWEST_HITS * due) & ((hits > before) | ~self.struck[rows])
        self.low[rows], self.high[rows] = np.minimum(self.low[rows], low), np.maximum(self.high[rows], high)
        self.hits[rows], self.until[rows] = hits, periods


def _energy_ranges(cells: CellBatch, rows: Rows) -> tuple[Array, Array]:
    """Return the minimum and the maximum energy (rows,) of these cells at their last sections t = k T.

    Rigid motions count with their kinetic energy.
    """
    blocks, sections = cells.oscillators.gap.blocks[rows], cells.batch.sections[rows, -RETURNS:]
    weight = np.where(blocks[..., COLUMN.lam] != 0.0, blocks[..., COLUMN.metric], 0.0)
    if cells.drifts:
        weight[:, -1] = 1.0  # the first number of this block is the velocity
    energy = np.sum(weight[:, None] * sections[..., 0] ** 2 + sections[..., 1] ** 2, axis=-1)
    known = np.arange(energy.shape[1]) >= energy.shape[1] - cells.known_section_count()[rows, None]
    return np.where(known, energy, np.inf).min(axis=1), np.where(known, energy, -np.inf).max(axis=1)
