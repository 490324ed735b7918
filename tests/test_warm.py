"""The kernels' compilation, by one process of a machine."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from atlas.task import compile as warm
from tests.test_attractors import CHAOTIC_TWINS, TWINS
from workers import Settings, identity, solve_tile
from workers.attractors import solve_attractors
from workers.basins import solve_basins
from workers.identity import batch_moments, orbits_reached, periods_to_settle, turn
from workers.kernel import cells, jit
from workers.kernel.batch import run
from workers.orbit import newton
from workers.starts import Starts

KERNELS = [value for module in (cells, run, newton) for value in vars(module).values() if isinstance(value, jit.Kernel)]
"""What Python calls, among others."""
OF_ATTRACTORS = [*KERNELS, *(value for value in vars(identity).values() if isinstance(value, jit.Kernel))]

COMPILING, LOADING = "compiling the kernels (kept for the next run)", "loading the kernels"


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What has been compiled, into a folder that holds nothing at first."""
    done: list[str] = []

    def slowly(settings: Settings, attractors: bool) -> bool:
        time.sleep(0.2)
        done.append(settings.exponents + (" and attractors" if attractors else ""))
        return True

    monkeypatch.setattr(jit, "CACHE", tmp_path)
    monkeypatch.setattr(warm, "warm_up_in_child", slowly)
    return done


def test_of_many_that_need_the_kernels_one_compiles_them(compiled: list[str]) -> None:
    asking = [threading.Thread(target=warm.compile_once, args=(Settings(),)) for _ in range(8)]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert compiled == ["largest"]


def test_all_exponents_take_the_same_kernels(compiled: list[str]) -> None:
    for exponents in ("largest", "spectrum", "none"):
        warm.compile_once(Settings(exponents=exponents))
    assert compiled == ["largest"]


@pytest.mark.parametrize("name", ["bouncing-ball", "impact-damper", "chain-3", "chain-8"])
def test_no_system_has_kernels_of_its_own(name: str) -> None:
    """Of one, two and more coordinates, with rigid modes and loads: none compiles what others have compiled."""
    solve_tile("two-mass", {}, Settings(exponents="spectrum", survival=0))
    before = {kernel: len(kernel.alone.signatures) for kernel in KERNELS}
    solve_tile(name, {}, Settings(exponents="spectrum", survival=0, max_periods=500))
    assert {kernel: len(kernel.alone.signatures) for kernel in KERNELS} == before


def test_who_is_stopped_while_compiling_leaves_it_to_the_next(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(settings: Settings, attractors: bool) -> bool:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(warm, "warm_up_in_child", stopped)
        warm.compile_once(Settings())
    assert warm.warming() == COMPILING
    warm.compile_once(Settings())
    assert compiled == ["largest"]


def test_what_tells_attractors_is_compiled_where_a_spec_asks_for_them(compiled: list[str]) -> None:
    for attractors in (False, True, True):
        warm.compile_once(Settings(), attractors)
    assert compiled == ["largest", "largest and attractors"]
    assert warm.warming(attractors=True) == LOADING


def test_no_attractor_has_kernels_of_its_own() -> None:
    """Twins, chaos and its twin, basins: none compiles what was not compiled beforehand."""
    warm.warm_up(Settings(), attractors=True)
    before = {kernel: len(kernel.alone.signatures) for kernel in OF_ATTRACTORS}
    brief = Settings(max_periods=4000, survival=8000, tolerance=0.05)
    for cell in (TWINS, CHAOTIC_TWINS):
        solve_attractors("two-mass", cell, brief, Starts(8))
    solve_basins("two-mass", {"omega": 4.0, "b": 0.1, "x1": np.array([0.0, 0.05])}, brief, Starts(2))
    assert {kernel: len(kernel.alone.signatures) for kernel in OF_ATTRACTORS} == before
    assert all(before[kernel] for kernel in (orbits_reached, periods_to_settle, turn, batch_moments))


def test_the_user_reads_of_a_compilation_where_there_is_one(compiled: list[str]) -> None:
    assert warm.warming() == COMPILING
    warm.compile_once(Settings())
    assert warm.warming() == LOADING


def test_without_a_folder_for_them_nothing_is_compiled_beforehand(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jit, "CACHE", None)
    warm.compile_once(Settings())
    assert compiled == []


def test_the_child_compiles_what_it_is_given() -> None:
    """Run for real, the kernels being there: whatever it cannot do ends it with an error."""
    assert warm.warm_up_in_child(Settings(max_period=8))
    wrong = Settings()
    object.__setattr__(wrong, "exponents", "some")
    assert not warm.warm_up_in_child(wrong)
