"""Machines with modes side by side: each has the bits that it has alone, and follows the map of one motion."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.oracle.piecewise import PiecewiseMachine
from tests.support.oracle.piecewise.random_machines import random_machine, random_state
from tests.support.solver_bridge import machines_of
from tests.workers.kernel.test_batch import assert_same_bits
from workers.cell.interval import batch_of, begin, has_ended, run
from workers.kernel.cell_loops import reset_frames
from workers.kernel.lanes.run import MotionBatch
from workers.kernel.motion import LOST, RUNNING, STATUS
from workers.kernel.period import advance
from workers.model.mode_table import build_hybrid
from workers.model.oscillator import COLUMN, map_fields, take_one
from workers.results import NO_REASON

CELLS, PERIODS, KEPT = 12, 6, 3

SEEDS = range(24)

SENSITIVE = 1e3
"""Growth of errors beyond which states are not compared any more."""


def family(seed: int) -> list[PiecewiseMachine]:
    """Machines of one random kind, each with a frequency of its own."""
    machine = random_machine(seed, switched_elements=seed % 2 == 1)
    return [replace(machine, omega=machine.omega * (1.0 + 1e-3 * k)) for k in range(CELLS)]


def starting(seed: int, cells: np.ndarray, vectors: bool = True) -> MotionBatch:
    """These machines of a family, on their way from one state."""
    machines = family(seed)
    oscillators, reasons = build_hybrid(machines_of([machines[k] for k in cells]))
    assert np.all(reasons == NO_REASON)
    states = np.tile(random_state(machines[0], seed), (len(cells), 1))
    motions, reasons = begin(oscillators, reasons, states, vectors=states.shape[1] if vectors else 0)
    assert np.all(reasons == NO_REASON)
    batch = batch_of(oscillators, motions, KEPT)
    batch.periods[:] = PERIODS
    return batch


def finished(batch: MotionBatch, cells: np.ndarray, **how: int) -> MotionBatch:
    run(batch, cells, **how)
    return batch


@pytest.mark.parametrize("seed", SEEDS)
def test_cells_of_every_kind_have_the_bits_of_each_alone(seed: int) -> None:
    together = finished(starting(seed, np.arange(CELLS)), np.arange(CELLS))
    for k in range(CELLS):
        alone = finished(starting(seed, np.array([k])), np.array([0]))
        assert_same_bits(together, alone, np.array([k]))


@pytest.mark.parametrize("seed", SEEDS)
def test_order_and_number_of_lanes_do_not_matter(seed: int) -> None:
    order = np.random.default_rng(seed).permutation(CELLS)
    whole = finished(starting(seed, np.arange(CELLS)), np.arange(CELLS))
    few = finished(starting(seed, order), np.arange(CELLS - 1, -1, -1), lanes=3)
    assert_same_bits(whole, few, order)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_stops_for_others_to_take_its_place_goes_on_to_the_same_bits(seed: int) -> None:
    whole = finished(starting(seed, np.arange(CELLS)), np.arange(CELLS))
    parts = starting(seed, np.arange(CELLS))
    while not np.all(has_ended(parts)):
        run(parts, np.flatnonzero(~has_ended(parts)), to_end=False, lanes=8)
    assert_same_bits(whole, parts, np.arange(CELLS))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_period_is_that_of_the_map_of_one_motion(seed: int) -> None:
    """As far as errors do not grow too much: both search for the same events on other ways."""
    together, single = starting(seed, np.arange(CELLS)), starting(seed, np.arange(CELLS))
    together.periods[:] = 1
    run(together, np.arange(CELLS))

    def go_on(rows: np.ndarray) -> None:
        for k in rows:
            motion = map_fields(single.motions, lambda field: field[k])  # noqa: B023
            motion.tally[STATUS] = RUNNING
            advance(take_one(single.oscillators, k), motion)

    single.oscillators.with_modes(go_on, np.arange(CELLS))
    np.testing.assert_array_equal(together.motions.tally[:, STATUS], single.motions.tally[:, STATUS])
    runs = together.motions.tally[:, STATUS] == RUNNING
    growth = np.max(single.motions.growth, axis=1, where=np.isfinite(single.motions.growth), initial=0.0)
    tame = runs & (np.exp(growth) < SENSITIVE)
    scale = 1.0 + np.max(np.abs(single.motions.h[tame]), axis=(1, 2), initial=0.0)
    away = np.max(np.abs(together.motions.h - single.motions.h)[tame], axis=(1, 2), initial=0.0)
    assert np.all(away <= 1e-10 * scale * SENSITIVE)
    np.testing.assert_array_equal(together.motions.mode[tame], single.motions.mode[tame])


def grown(seed: int, periods: list[int]) -> MotionBatch:
    """Machines of a family after these periods; after each of them, frames are made orthonormal."""
    every = np.arange(CELLS)
    batch = starting(seed, every)
    for some in periods:
        batch.periods[:], batch.completed[:] = some, 0
        run(batch, every)
        reset_frames(batch.oscillators.gap.blocks, batch.motions, every)
    return batch


@pytest.mark.parametrize("seed", SEEDS)
def test_frames_made_orthonormal_when_spread_grow_like_those_made_so_often(seed: int) -> None:
    """Gram-Schmidt factors multiply, so that growth does not depend on where frames were made orthonormal."""
    seldom, often = grown(seed, [PERIODS]), grown(seed, [1] * PERIODS)
    whole = (seldom.motions.tally[:, STATUS] == RUNNING) & (seldom.motions.tally[:, LOST] == 0.0)
    np.testing.assert_array_equal(seldom.motions.h, often.motions.h)
    np.testing.assert_allclose(seldom.motions.growth[whole], often.motions.growth[whole], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_mode_changes_the_norm_of_states_more_unevenly_than_its_skew(seed: int) -> None:
    oscillators = finished(starting(seed, np.arange(CELLS)), np.arange(CELLS)).oscillators
    table, n = oscillators.table, oscillators.gap_row.shape[1]
    built = table.codes >= 0
    energy = np.stack([np.sqrt(table.pieces.blocks[:, :, 0, :, COLUMN.metric]), np.ones((*built.shape, n))], axis=-1)
    speed = np.repeat(np.stack([table.omega, np.ones(CELLS)], axis=1), n, axis=1)[:, None, None]
    change = energy.reshape(*built.shape, 2 * n, 1) * table.pieces.to_blocks / speed
    assert np.all(np.log(np.linalg.cond(change[built])) <= table.pieces.skew[built] + 1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_impacts_stretch_deviations_no_more_unevenly_than_their_bound(seed: int) -> None:
    oscillators, _ = build_hybrid(machines_of(family(seed)))
    elements, one = oscillators.table.elements, np.eye(oscillators.gap_row.shape[1])
    hard = (elements.soft == 0.0) & (elements.R > 0.0)
    kick, row, R = elements.kick[hard], elements.row[hard], elements.R[hard]
    impact = one - (1.0 + R)[:, None, None] * kick[:, :, None] * row[:, None, :]
    assert np.all(np.log(np.linalg.cond(impact)) <= elements.turned[hard] + 1e-9)
