"""Cells side by side: each has the bits that it has alone, and follows the map that the kernels of one cell state."""

from collections.abc import Mapping

import numpy as np
import pytest

from tests import naive
from workers import Settings, solve_tile
from workers.cell.interval import batch_of, has_ended, run
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.lanes.layout import VECTOR_WIDTH, room_for_vectors
from workers.kernel.lanes.run import MotionBatch
from workers.kernel.motion import EVALUATIONS, FLIGHT, LOWER, RUNNING, STATUS, STUCK, UPPER, WORK, motions_at
from workers.kernel.period import advance
from workers.model.oscillator import Oscillator, map_fields
from workers.model.system import find_system
from workers.results import NO_REASON, UNDETERMINED, reason_counts

TWO_MASS = find_system("two-mass")

KEPT = 5


def oscillators_of(params: Mapping[str, np.ndarray], count: int) -> Oscillator:
    values = {p.name: np.broadcast_to(params.get(p.name, p.default), count) for p in TWO_MASS.parameters}
    oscillators, reasons = TWO_MASS.build_many(values)
    assert np.all(reasons == NO_REASON)
    return oscillators


def at_rest(oscillators: Oscillator, vectors: int, periods: int | np.ndarray) -> MotionBatch:
    """Cells that start with all masses in the middle, so many periods to go."""
    N, n = oscillators.gap_row.shape
    h = np.empty((N, n, 2))
    for k in range(N):
        h[k] = motion_from(map_fields(oscillators, lambda field: field[k]), np.zeros(2 * n)).h  # noqa: B023
    batch = batch_of(oscillators, motions_at(h, vectors=vectors), KEPT)
    batch.periods[:] = periods
    return batch


def family(figure: int, vectors: int, count: int, periods: int | np.ndarray) -> MotionBatch:
    """Cells near that of a figure, each with a b of its own."""
    params = naive.FIGURES[figure]
    return at_rest(
        oscillators_of(params | {"b": params["b"] * (1.0 + 1e-3 * np.arange(count))}, count), vectors, periods
    )


def random_cells(seed: int, count: int, vectors: int, periods: int) -> MotionBatch:
    """Cells of every kind: under- and overdamped, R from 0 to 1, sticking, chattering, free of impacts."""
    rng = np.random.default_rng(seed)
    params = {
        "omega": 10.0 ** rng.uniform(-1, 1.5, count),
        "b": 10.0 ** rng.uniform(-2.5, 0.5, count),
        "mu_m": 10.0 ** rng.uniform(-1, 1, count),
        "mu_k": 10.0 ** rng.uniform(-1, 1, count),
        "zeta": rng.choice([0.0, 1.0], count) * 10.0 ** rng.uniform(-3, 0.7, count),
        "R": rng.choice([0.0, 0.3, 0.6, 0.8, 0.95, 1.0], count),
        "f2": rng.uniform(-2, 5, count),
        "tau": rng.uniform(-4, 4, count),
    }
    return at_rest(oscillators_of(params, count), vectors, periods)


def part(batch: MotionBatch, cells: np.ndarray) -> MotionBatch:
    """A copy of some cells."""
    copied: MotionBatch = map_fields(batch, lambda field: field[cells].copy())
    return copied


def finish(batch: MotionBatch, **how: int) -> MotionBatch:
    run(batch, np.arange(len(batch.completed)), **how)
    return batch


def one_by_one(batch: MotionBatch) -> list[MotionBatch]:
    return [finish(part(batch, np.array([k]))) for k in range(len(batch.completed))]


def assert_same_bits(one: MotionBatch, other: MotionBatch, cells: np.ndarray) -> None:
    """Everything of ``other`` is what ``one`` has of these cells."""
    for name in ("completed", "levels", "weighted", "sections"):
        np.testing.assert_array_equal(getattr(one, name)[cells], getattr(other, name), err_msg=name)
    for name in ("h", "mode", "V", "growth", "tally"):
        found, expected = getattr(one.motions, name)[cells], getattr(other.motions, name)
        np.testing.assert_array_equal(found, expected, err_msg=name)


@pytest.mark.parametrize("vectors", [0, 1, 4])
@pytest.mark.parametrize("figure", [3, 4, 5])
def test_cells_side_by_side_have_the_bits_of_each_alone(figure: int, vectors: int) -> None:
    start = family(figure, vectors, 150, 40)
    together = finish(part(start, np.arange(150)))
    assert np.all(together.completed == 40)
    for k, alone in enumerate(one_by_one(start)):
        assert_same_bits(together, alone, np.array([k]))


@pytest.mark.parametrize("vectors", [0, 1, 4])
def test_cells_of_every_kind_have_the_bits_of_each_alone(vectors: int) -> None:
    """Those that rest on a stop or chatter leave their lane for some periods; overdamped ones have their own batch."""
    start = random_cells(7, 200, vectors, 30)
    together = finish(part(start, np.arange(200)))
    for k, alone in enumerate(one_by_one(start)):
        assert_same_bits(together, alone, np.array([k]))
    rest = np.sum(together.motions.mode != FLIGHT)
    assert 10 < rest < 150


@pytest.mark.parametrize("count", range(1, 3 * VECTOR_WIDTH))
def test_any_number_of_lanes_gives_the_same_bits(count: int) -> None:
    """Loops over lanes have vector bodies and remainders; one arithmetic."""
    start = family(5, 4, 3 * VECTOR_WIDTH, 20)
    whole = finish(part(start, np.arange(3 * VECTOR_WIDTH)))
    some = np.arange(3 * VECTOR_WIDTH)[-count:]
    assert_same_bits(whole, finish(part(start, some)), some)


def test_the_other_cells_and_the_order_do_not_matter() -> None:
    """A shuffled part of the cells, with stretches of other lengths between them, gives the same bits."""
    start = family(5, 1, 140, 60)
    whole = finish(part(start, np.arange(140)))
    order = np.random.default_rng(3).permutation(140)[:77]
    others = family(4, 1, 77, 7 + np.arange(77))
    mixed = each_pair(part(start, order), others)
    run(mixed, np.random.default_rng(4).permutation(154))
    assert_same_bits(whole, part(mixed, np.arange(77)), order)


def each_pair(one: MotionBatch, other: MotionBatch) -> MotionBatch:
    """Both batches in one."""

    def joined(a: object, b: object) -> object:
        if isinstance(a, tuple):
            return type(a)(*map(joined, a, b))  # type: ignore[call-overload]
        return None if a is None else np.concatenate([a, b])  # type: ignore[list-item]

    return joined(one, other)  # type: ignore[return-value]


def test_what_stops_for_others_to_take_its_place_goes_on_to_the_same_bits() -> None:
    """Stretches of 10 to 350 periods in 16 lanes until all have ended: each return leaves fewer of them under way."""
    start = family(5, 1, 18, 10 + 20 * np.arange(18))
    whole = finish(part(start, np.arange(18)))
    left = []
    while not np.all(has_ended(start)):
        run(start, np.flatnonzero(~has_ended(start)), to_end=False, lanes=16)
        left.append(int(np.sum(~has_ended(start))))
    assert_same_bits(whole, start, np.arange(18))
    assert len(left) > 2
    assert all(after <= before / 2 + 2 for before, after in zip([16, *left], left, strict=False))


def test_a_motion_that_is_out_of_work_stops_at_its_section() -> None:
    batch = family(3, 0, 8, 50)
    batch.motions.tally[:, WORK] = 40.0 * np.arange(8)
    finish(batch)
    assert 1 == batch.completed[0] < batch.completed[4] < 50
    assert np.all(batch.motions.tally[:, STATUS] == RUNNING)


@pytest.mark.parametrize("figure", [3, 4])
def test_side_by_side_cells_follow_the_map_of_one(figure: int) -> None:
    """The stroboscopic map as the kernels of one cell state it; on a stable orbit rounding does not grow."""
    batch = family(figure, 4, 20, 300)
    motions = [motion_from(map_fields(batch.oscillators, lambda f: f[k]), np.zeros(4), 4) for k in range(20)]  # noqa: B023
    finish(batch)
    for k, motion in enumerate(motions):
        osc = map_fields(batch.oscillators, lambda field: field[k])  # noqa: B023
        for _ in range(300):
            advance(osc, motion)
        assert batch.motions.h[k] == pytest.approx(motion.h, abs=1e-12)
        assert batch.motions.growth[k] == pytest.approx(motion.growth, rel=1e-9)
        assert batch.motions.tally[k, [UPPER, LOWER]].tolist() == motion.tally[[UPPER, LOWER]].tolist()


def test_one_period_of_every_kind_of_cell_is_that_of_the_map_of_one() -> None:
    """One period from a settled state, rest included; impacts that hardly touch amplify rounding in a few."""
    batch = random_cells(11, 300, 0, 20)
    finish(batch)
    sticks, away = 0, []
    before = part(batch, np.arange(300))
    batch.periods[:], batch.completed[:] = 1, 0
    finish(batch)
    for k in range(300):
        osc = map_fields(batch.oscillators, lambda field: field[k])  # noqa: B023
        motion = part(before, np.array([k])).motions
        alone = type(motion)(*(field[0] for field in motion))
        advance(osc, alone)
        here = type(motion)(*(field[k] for field in batch.motions))
        scale = 1.0 + np.abs(blocks_to_physical(osc, alone)).max()
        away.append(np.max(np.abs(here.h - alone.h)) / scale)
        sticks += here.tally[STUCK] > before.motions.tally[k, STUCK]
    assert sticks > 10
    assert np.mean(np.array(away) < 1e-10) > 0.9
    assert np.max(away) < 0.1


def test_a_period_of_very_many_impacts_is_left_to_the_bounded_march() -> None:
    """R = 1 and a gap of 1e-5 of the response: 10^5 impacts a period."""
    params = naive.FIGURES[3] | {"R": 1.0, "b": 1e-6 * (1.0 + 0.01 * np.arange(4)), "omega": 0.1}
    batch = finish(at_rest(oscillators_of(params, 4), 0, 3))
    assert np.max(batch.motions.tally[:, EVALUATIONS]) > 100_000
    assert np.all(batch.completed == 3)


@pytest.mark.slow
def test_a_mass_at_rest_but_for_rounding_is_given_up_for_its_cost_not_failed() -> None:
    """R = 1 and an overdamped mode: the bounces die away to speeds of 1e-17, where no certain step leads ahead."""
    cell = {
        "omega": 0.0016895232399086104, "mu_m": 0.0035662347271146633, "mu_k": 0.29801670113833517, "R": 1.0,
        "zeta": 4.137306294914946, "f2": 1.6806160435465856, "tau": 1.4203278275940434, "b": 0.2711590971746347,
    }  # fmt: skip
    solution = solve_tile("two-mass", cell, Settings(max_periods=400))
    assert solution["regime"] == UNDETERMINED
    (reason,) = reason_counts(solution["reason"])
    assert reason == "one forcing period takes more than a million evaluations of the motion"


@pytest.mark.parametrize("size", [0, 1, 136, 5000])
def test_memory_of_lanes_begins_on_a_line_of_memory(size: int) -> None:
    for room in [room_for_vectors(size) for _ in range(20)]:  # all kept: each lies elsewhere
        assert room.shape == (size,)
        assert not room.any()
        assert room.ctypes.data % 64 == 0
