"""Claims about arrays that count no references: none of them reaches Python, which would read freed memory."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import workers
from atlas.task.compile import WITH_MODES
from workers import Settings, solve_tile
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.kernel import jit
from workers.kernel.borrow import borrow
from workers.kernel.jit import kernel
from workers.model.system import System

LENT = {"seen_later"}
"""Kernels that return what they borrow: parts of others, which nothing in workers calls from Python."""

BORROWING = ("borrowed(", "lend(", "row_of(", "whole(", "with_phase(")
"""What gives a kernel arrays that count no references."""


@kernel
def lend(values):
    """What must not be."""
    return borrow(values[1:])


@kernel
def give(values):
    """What may be."""
    return values[1:]


def arrays_of(found: Any) -> Iterator[np.ndarray]:
    if isinstance(found, np.ndarray):
        yield found
    elif isinstance(found, tuple):
        for array in found:
            yield from arrays_of(array)


def is_borrowed(array: np.ndarray) -> bool:
    """An array of Numba's that has no owner: neither itself nor a base."""
    return not array.flags.owndata and array.base is None


def test_an_array_without_an_owner_is_told_from_others() -> None:
    values = np.arange(3.0)
    assert is_borrowed(lend(values))
    assert not is_borrowed(give(values)) and not is_borrowed(values[1:])


def test_no_kernel_that_python_calls_returns_a_borrowed_array(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all that a tile of each exponent, a rest, and attractors call."""
    called: set[str] = set()
    run = jit.Kernel.__call__

    def watched(self: jit.Kernel, *given: Any) -> Any:
        found = run(self, *given)
        called.add(self.py_func.__name__)
        assert not any(is_borrowed(array) for array in arrays_of(found)), self.py_func
        return found

    monkeypatch.setattr(jit.Kernel, "__call__", watched)
    brief = Settings(max_periods=2000, survival=500, tolerance=0.1, section_samples=2)
    cells = {"omega": np.linspace(2.0, 4.0, 6), "b": np.linspace(0.1, 0.5, 6)}
    solve_tile("two-mass", cells, brief)
    solve_tile("bouncing-ball", {}, Settings(max_periods=500, survival=100, exponents="spectrum"))
    solve_attractors("two-mass", {"omega": 4.0, "b": 0.1}, brief, AttractorSettings(4))
    solve_tile(System.from_mapping(WITH_MODES), {"omega": [0.8, 1.2]}, brief)
    assert {"run_batch", "take_along", "settle_cells", "start_motions", "physical_states"} <= called
    assert not LENT & called


def returned_names(function: ast.FunctionDef) -> set[str]:
    """Names that a function returns, or a part of: x of ``x``, ``x.y`` and ``x[i]``, alone and in tuples."""
    returns = [node.value for node in ast.walk(function) if isinstance(node, ast.Return) and node.value]
    parts = [value.elts if isinstance(value, ast.Tuple) else [value] for value in returns]
    found = set()
    for part in (value for group in parts for value in group):
        while isinstance(part, ast.Attribute | ast.Subscript):
            part = part.value
        if isinstance(part, ast.Name):
            found.add(part.id)
    return found


def borrows(function: ast.FunctionDef) -> set[str]:
    """Names that hold what one of BORROWING gives, and "borrowed" where that is returned at once."""
    found = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Return) and node.value and ast.unparse(node.value).startswith(BORROWING):
            found.add("borrowed")
        if isinstance(node, ast.Assign) and any(word in ast.unparse(node.value) for word in BORROWING):
            for target in node.targets:
                found |= {name.id for name in ast.walk(target) if isinstance(name, ast.Name)}
    return found


def test_no_function_of_workers_returns_what_it_borrows_but_those_that_lend() -> None:
    guilty = set()
    for source in Path(workers.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.FunctionDef) and source.name not in ("borrow.py", "by_reference.py"):
                names = borrows(node)
                if "borrowed" in names or names & returned_names(node):
                    guilty.add(node.name)
    assert guilty == LENT
