"""Borrowed arrays: the same memory, and nobody's count of it changes."""

import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.borrow import borrow
from workers.kernel.jit import kernel


class Pair(NamedTuple):
    row: NDArray[np.float64]
    of_both: tuple[NDArray[np.float64], float]


@kernel
def add_up(pair, times):
    total = 0.0
    for _ in range(times):
        mine = borrow(pair)
        mine.row[0] += 1.0
        total += mine.row[0] * mine.of_both[0][1] * mine.of_both[1]
    return total


def test_a_borrowed_record_has_the_arrays_and_numbers_of_the_record() -> None:
    pair = Pair(np.zeros(2), (np.array([0.0, 10.0]), 0.5))
    assert add_up(pair, 3) == 5.0 * (1.0 + 2.0 + 3.0)
    assert pair.row[0] == 3.0


def test_borrowing_leaves_the_count_of_references_as_it_is() -> None:
    pair = Pair(np.zeros(2), (np.ones(2), 1.0))
    before = sys.getrefcount(pair.row), sys.getrefcount(pair.of_both[0])
    add_up(pair, 1000)
    assert (sys.getrefcount(pair.row), sys.getrefcount(pair.of_both[0])) == before


def test_outside_kernels_a_borrowed_array_is_that_array() -> None:
    array = np.zeros(1)
    assert borrow(array) is array
