"""Claims about records that a kernel passes on by where they lie, and about rows of records."""

import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import types
from numba.core.errors import TypingError
from numpy.typing import NDArray

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference, by_value
from workers.kernel.external import FLOATS, external
from workers.kernel.jit import kernel


class Inner(NamedTuple):
    row: NDArray[np.float64]
    factor: float


class Outer(NamedTuple):
    number: float
    inner: Inner
    matrix: NDArray[np.float64]


OUTER = types.NamedTuple([types.float64, types.NamedTuple([FLOATS[1], types.float64], Inner), FLOATS[2]], Outer)


def outer() -> Outer:
    return Outer(3.0, Inner(np.array([1.0, 2.0]), 0.5), np.eye(2))


@kernel
def weigh(record):
    """Reads a field of each depth, and writes into the arrays."""
    record.inner.row[0] += record.number
    record.matrix[1, 0] = record.inner.row[0] * record.inner.factor
    return record.matrix[1, 0] + record.inner.row[1]


@kernel
def weigh_lent(record):
    return weigh(by_reference(record))


@kernel
def weigh_changed(record):
    """A record made of the fields of one that is lent, lent again."""
    mine = by_value(by_reference(record))
    return weigh(by_reference(Outer(10.0, mine.inner, mine.matrix)))


@external(OUTER, types.int64, result=types.float64)
def weigh_apart(record, times):
    total = 0.0
    for _ in range(times):
        total += weigh(record)
    return total


@kernel
def weigh_apart_both(record):
    """A function apart is given a record by value, and one that is lent already."""
    return weigh_apart(record, 1) + weigh_apart(by_reference(record), 1)


@kernel
def weigh_row(records, r):
    return weigh(by_reference(row_of(records, r)))


@kernel
def read_missing(record):
    return by_reference(record).missing


def test_a_lent_record_has_the_fields_of_the_record_at_each_depth() -> None:
    mine, other = outer(), outer()
    assert weigh_lent(mine) == weigh(other) == 4.0
    assert mine.inner.row.tolist() == other.inner.row.tolist() == [4.0, 2.0]
    assert mine.matrix.tolist() == other.matrix.tolist() == [[1.0, 0.0], [2.0, 1.0]]


def test_a_lent_record_is_had_by_value_again_with_its_fields() -> None:
    assert weigh_changed(outer()) == 0.5 * 11.0 + 2.0


def test_a_function_apart_takes_a_record_by_value_and_one_that_is_lent() -> None:
    assert weigh_apart_both(outer()) == 4.0 + 5.5


def test_lending_leaves_the_count_of_references_as_it_is() -> None:
    mine = outer()
    before = sys.getrefcount(mine.inner.row), sys.getrefcount(mine.matrix)
    for _ in range(10):
        weigh_lent(mine)
        weigh_changed(mine)
        weigh_apart_both(mine)
    assert (sys.getrefcount(mine.inner.row), sys.getrefcount(mine.matrix)) == before


def many() -> Outer:
    """Two records as one, the first of which is ``outer()``."""
    inner = Inner(np.array([[1.0, 2.0], [-1.0, 7.0]]), np.array([0.5, 0.25]))
    return Outer(np.array([3.0, 4.0]), inner, np.stack([np.eye(2), 2.0 * np.eye(2)]))


def test_a_row_of_a_record_of_many_has_their_memory_in_a_kernel_as_outside() -> None:
    mine, other = many(), many()
    found = [weigh_row(mine, np.int64(r)) for r in range(2)]
    assert found == [weigh(row_of(other, r)) for r in range(2)] == [4.0, 0.25 * 3.0 + 7.0]
    assert np.array_equal(mine.inner.row, other.inner.row) and np.array_equal(mine.matrix, other.matrix)


def test_taking_rows_leaves_the_count_of_references_as_it_is() -> None:
    mine = many()
    before = sys.getrefcount(mine.inner.row), sys.getrefcount(mine.matrix)
    for _ in range(10):
        weigh_row(mine, np.int64(1))
    assert (sys.getrefcount(mine.inner.row), sys.getrefcount(mine.matrix)) == before


def test_a_field_that_a_lent_record_lacks_is_not_compiled() -> None:
    with pytest.raises(TypingError, match="missing"):
        read_missing(outer())


def test_outside_kernels_what_is_lent_is_the_record() -> None:
    mine = outer()
    assert by_reference(mine) is mine and by_value(mine) is mine
