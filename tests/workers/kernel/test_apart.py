"""Claims about functions that kernels call where they lie."""

import math
import threading
from typing import Any

import numpy as np
import pytest
from numba import typeof, types
from numba.core.errors import TypingError

from workers.kernel.by_reference import by_value
from workers.kernel.external import FLOATS, _loading, external, load
from workers.kernel.jit import kernel
from workers.model.system import find_system


@external(FLOATS[2], types.float64, types.boolean, result=types.float64)
def norm(matrix: Any, power: float, rooted: bool) -> float:
    matrix = by_value(matrix)
    total = 0.0
    for row in matrix:
        for entry in row:
            total += abs(entry) ** power
    return total ** (1.0 / power) if rooted else total


@external(FLOATS[1], types.int64)
def fill(row: Any, value: int) -> None:
    row = by_value(row)
    for k in range(len(row)):
        row[k] = value


@kernel
def norms_after_filling(matrix, value):
    """Two functions apart in one kernel, one of them called twice."""
    fill(matrix[0], value)
    return norm(matrix, 2.0, True), norm(matrix, 2.0, False)


@kernel
def norm_of_a_row(row):
    """An argument that norm does not take."""
    return norm(row, 2.0, True)


def test_a_function_apart_reads_and_writes_the_arrays_of_the_kernel_that_calls_it() -> None:
    matrix = np.ones((2, 2))
    assert norms_after_filling(matrix, 2) == pytest.approx((math.sqrt(10.0), 10.0), rel=1e-15)
    assert matrix.tolist() == [[2.0, 2.0], [1.0, 1.0]]


def test_python_gets_the_same_bits_from_a_function_apart_as_a_kernel_does() -> None:
    matrix = np.linspace(0.1, 0.9, 9).reshape(3, 3)
    matrix[0] = 1.0
    assert norms_after_filling(matrix.copy(), 1) == (norm(matrix, 2.0, True), norm(matrix, 2.0, False))


def test_a_kernel_that_gives_a_function_apart_another_type_is_not_compiled() -> None:
    with pytest.raises(TypingError, match="norm"):
        norm_of_a_row(np.ones(3))


def test_a_function_of_machines_with_modes_is_compiled_when_a_kernel_first_sees_one() -> None:
    @external(FLOATS[1], result=types.float64, modes=True)
    def first(row: Any) -> float:
        return float(by_value(row)[0])

    typeof(find_system("two-mass").build(defaults("two-mass")))
    load()
    assert first.pointer.value is None
    typeof(find_system("soft-impact").build(defaults("soft-impact")))
    assert first.pointer.value is not None


def test_a_thread_that_needs_nothing_compiled_does_not_wait_for_one_that_compiles() -> None:
    """It may hold the compiler's own lock, for which the other one waits."""
    load(modes=True)
    waiting = threading.Thread(target=load, daemon=True)
    with _loading:
        waiting.start()
        waiting.join(30.0)
        assert not waiting.is_alive()


def defaults(name: str) -> dict[str, float]:
    return {parameter.name: parameter.default for parameter in find_system(name).parameters}
