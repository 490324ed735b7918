"""Cells in a batch against one cell alone: the same bits, whatever else the batch holds."""

import numpy as np
import pytest

from tests import naive
from workers import Settings, solve_tile
from workers.kernel.averages import no_averages
from workers.kernel.stroboscopic import EVALUATIONS, FREE, RUNNING, STATUS, WORK, Motion, motion_from
from workers.model.oscillator import Oscillator
from workers.model.system import find_system
from workers.results import UNDETERMINED
from workers.solve import with_frame
from workers.stretch import Stretch, ended, run_stretch, run_stretches
from workers.tile import solve_cells

KEPT = 5


def stretch(osc: Oscillator, start: np.ndarray, vectors: int, periods: int) -> Stretch:
    motion = with_frame(motion_from(osc, start), vectors)
    return Stretch(osc, motion, periods, no_averages() if vectors else None, np.zeros((KEPT, *motion.h.shape)))


def family(figure: int, vectors: int, count: int, periods: int) -> list[Stretch]:
    """Cells near that of a figure, each with a b of its own."""
    params = naive.FIGURES[figure]
    cells = (naive.two_mass(**params | {"b": params["b"] * (1.0 + 1e-3 * k)}) for k in range(count))
    return [stretch(osc, start, vectors, periods) for osc, start in cells]


def copies(stretches: list[Stretch]) -> list[Stretch]:
    return [
        one._replace(
            motion=Motion(*(part.copy() for part in one.motion)),
            averages=one.averages and type(one.averages)(*(part.copy() for part in one.averages)),
            sections=one.sections.copy(),
        )
        for one in stretches
    ]  # fmt: skip


def same_bits(one: Stretch, other: Stretch) -> bool:
    pairs = [(one.sections, other.sections)]
    pairs += ((getattr(one.motion, name), getattr(other.motion, name)) for name in Motion._fields if name != "scratch")
    if one.averages and other.averages:
        pairs += zip(one.averages, other.averages, strict=True)
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


def random_cells(seed: int, count: int, vectors: int, periods: int) -> list[Stretch]:
    """Cells of every kind: under- and overdamped, R from 0 to 1, sticking, chattering, free of impacts."""
    rng = np.random.default_rng(seed)
    found: list[Stretch] = []
    while len(found) < count:
        params = {
            "omega": 10.0 ** rng.uniform(-1, 1.5),
            "b": 10.0 ** rng.uniform(-2.5, 0.5),
            "mu_m": 10.0 ** rng.uniform(-1, 1),
            "mu_k": 10.0 ** rng.uniform(-1, 1),
            "zeta": rng.choice([0.0, 1.0]) * 10.0 ** rng.uniform(-3, 0.7),
            "R": rng.choice([0.0, 0.3, 0.6, 0.8, 0.95, 1.0]),
            "f2": rng.uniform(-2, 5),
            "tau": rng.uniform(-4, 4),
        }
        system = find_system("two-mass")
        osc = system.build({p.name: p.default for p in system.parameters} | params)
        found.append(stretch(osc, np.zeros(4), vectors, periods))
    return found


@pytest.mark.parametrize("vectors", [0, 1, 4])
@pytest.mark.parametrize("figure", [3, 4, 5])
def test_a_batch_is_bit_for_bit_one_by_one(figure: int, vectors: int) -> None:
    together = family(figure, vectors, 150, 40)
    alone = copies(together)
    assert run_stretches(together, [0] * len(together)) == [run_stretch(one) for one in alone]
    assert all(same_bits(a, b) for a, b in zip(together, alone, strict=True))


@pytest.mark.parametrize("vectors", [0, 1, 4])
def test_cells_of_every_kind_have_the_bits_of_one_by_one(vectors: int) -> None:
    """Those that rest on a stop or chatter leave their lane on the way."""
    together = random_cells(7, 200, vectors, 30)
    alone = copies(together)
    assert run_stretches(together, [0] * len(together)) == [run_stretch(one) for one in alone]
    assert all(same_bits(a, b) for a, b in zip(together, alone, strict=True))
    rest = sum(one.motion.contact[0] != FREE for one in together)
    assert 10 < rest < 150


def test_the_other_cells_and_the_order_do_not_matter() -> None:
    """A shuffled part of the cells, with stretches of other lengths between them, gives the same bits."""
    whole = family(5, 1, 140, 60)
    order = np.random.default_rng(3).permutation(140)[:77]
    part = copies([whole[k] for k in order])
    others = [one._replace(periods=7 + k) for k, one in enumerate(family(4, 1, 77, 7))]
    run_stretches(whole, [0] * 140)
    mixed = [one for pair in zip(part, others, strict=True) for one in pair]
    run_stretches(mixed, [0] * 154)
    assert all(same_bits(whole[k], one) for k, one in zip(order, part, strict=True))


def test_what_stops_for_others_to_take_its_place_goes_on_to_the_same_bits() -> None:
    """Stretches of 10 to 350 periods in 16 lanes until all have ended: each return leaves fewer of them under way."""
    together = [one._replace(periods=10 + 20 * k) for k, one in enumerate(family(5, 1, 18, 1))]
    alone = copies(together)
    done, rounds = [0] * 18, []
    while any(not ended(one, count) for one, count in zip(together, done, strict=True)):
        done = run_stretches(together, done, to_end=False, lanes=16, fewest=1)
        rounds.append(sum(not ended(one, count) for one, count in zip(together, done, strict=True)))
    assert done == [run_stretch(one) for one in alone]
    assert all(same_bits(a, b) for a, b in zip(together, alone, strict=True))
    assert len(rounds) > 2
    assert all(after <= before / 2 + 2 for before, after in zip([16, *rounds], rounds, strict=False))


def test_a_motion_that_is_out_of_work_stops_where_it_would_alone() -> None:
    together = family(3, 0, 8, 50)
    for k, one in enumerate(together):
        one.motion.tally[WORK] = 40.0 * k
    alone = copies(together)
    done = run_stretches(together, [0] * len(together))
    assert done == [run_stretch(one) for one in alone]
    assert 1 == done[0] < done[4] < 50
    assert all(one.motion.tally[STATUS] == RUNNING for one in together)


def test_a_period_of_very_many_impacts_is_left_to_the_bounded_march() -> None:
    """R = 1 and a gap of 1e-5 of the response: 10^5 impacts a period."""
    cells = [
        naive.two_mass(**naive.FIGURES[3] | {"R": 1.0, "b": 1e-6 * (1.0 + 0.01 * k), "omega": 0.1}) for k in range(4)
    ]
    together = [stretch(osc, start, 0, 3) for osc, start in cells]
    alone = copies(together)
    assert run_stretches(together, [0] * len(together)) == [run_stretch(one) for one in alone]
    assert all(same_bits(a, b) for a, b in zip(together, alone, strict=True))
    assert max(one.motion.tally[EVALUATIONS] for one in together) > 100_000


def test_a_mass_at_rest_but_for_rounding_is_given_up_for_its_cost_not_failed() -> None:
    """R = 1 and an overdamped mode: the bounces die away to speeds of 1e-17, where no certain step leads ahead."""
    cell = {
        "omega": 0.0016895232399086104, "mu_m": 0.0035662347271146633, "mu_k": 0.29801670113833517, "R": 1.0,
        "zeta": 4.137306294914946, "f2": 1.6806160435465856, "tau": 1.4203278275940434, "b": 0.2711590971746347,
    }  # fmt: skip
    solution = solve_cells("two-mass", cell, Settings(max_periods=400))
    assert solution.arrays["regime"] == UNDETERMINED
    assert list(solution.reasons) == ["one period takes more than a million evaluations"]


def test_a_tile_has_the_bits_of_its_cells_alone() -> None:
    omega, b = np.linspace(1.0, 4.0, 7)[None, :], np.linspace(0.05, 0.4, 5)[:, None]
    settings = Settings(exponents="spectrum", tolerance=0.05, max_periods=3000)
    tile = solve_tile("two-mass", {"omega": omega, "b": b}, settings)
    for i, j in np.ndindex(5, 7):
        cell = solve_tile("two-mass", {"omega": omega[0, j], "b": b[i, 0]}, settings)
        for name, value in cell.items():
            assert np.array_equal(value, tile[name][i, j], equal_nan=True), name
