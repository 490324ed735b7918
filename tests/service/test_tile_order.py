import itertools

import numpy as np
import pytest

from atlas.service.tile_order import TileOrder


@pytest.mark.parametrize("shape", [(1, 1), (3,), (17,), (2, 9), (13, 11)])
def test_every_tile_due_comes_once_and_no_other(shape: tuple[int, ...]) -> None:
    due = np.random.default_rng(1).random(shape) < 0.7
    given = list(TileOrder(due))
    assert len(given) == due.sum()
    assert set(given) == {tuple(map(int, index)) for index in np.argwhere(due)}


def test_without_receipts_ever_finer_lattices_come_first() -> None:
    given = list(TileOrder(np.ones((8, 8), dtype=bool)))
    assert given[:4] == [(2, 2), (2, 6), (6, 2), (6, 6)]
    assert set(given[:16]) == set(itertools.product(range(0, 8, 2), repeat=2))


def test_what_is_known_late_still_counts() -> None:
    order = TileOrder(np.ones((16, 16), dtype=bool))
    given = iter(order)
    begun = [next(given) for _ in range(100)]
    for index in begun:
        order.record_cost(index, float(index[0]))
    rest = list(given)
    assert sum(index[0] for index in rest[:50]) > 1.5 * sum(index[0] for index in rest[-50:])
    assert len({*begun, *rest}) == 256


def test_after_a_coarse_lattice_the_costly_region_comes_first() -> None:
    def cost(index: tuple[int, ...]) -> float:
        return 100.0 if index[0] >= 8 and index[1] < 8 else 1.0

    order = TileOrder(np.ones((16, 16), dtype=bool))
    given = []
    for index in order:
        given.append(index)
        order.record_cost(index, cost(index))
    assert sum(cost(index) for index in given[:16]) == 4 * 100 + 12
    costly = [place for place, index in enumerate(given) if cost(index) > 1]
    assert max(costly) < 16 + 2 * len(costly)
    assert min(cost(index) for index in itertools.islice(given, 16, 40)) == 100.0


def test_of_the_tiles_of_known_cost_the_nearest_counts_most() -> None:
    order = TileOrder(np.ones((1, 16), dtype=bool))
    given = iter(order)
    for index in itertools.islice(given, 4):
        order.record_cost(index, 100.0 if index == (0, 14) else 1.0)
    assert [next(given), next(given)] == [(0, 15), (0, 13)]
