"""The kernels' compilation, by one process of a machine."""

import threading
import time
from pathlib import Path

import pytest

from atlas.task import compile as warm
from tests.test_systems import MACHINE
from workers import Settings, System, solve_tile
from workers.kernel import jit
from workers.model.system import find_system, system_names

COMPILING, LOADING = "compiling the kernels (kept for the next run)", "loading the kernels"


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What has been compiled, into a folder that holds nothing at first."""
    done: list[str] = []

    def slowly(system: str, settings: Settings) -> bool:
        time.sleep(0.2)
        done.append(settings.exponents)
        return True

    monkeypatch.setattr(jit, "CACHE", tmp_path)
    monkeypatch.setattr(warm, "warm_up_in_child", slowly)
    return done


def test_of_many_that_need_the_kernels_one_compiles_them(compiled: list[str]) -> None:
    asking = [threading.Thread(target=warm.compile_once, args=("two-mass", Settings())) for _ in range(8)]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert compiled == ["largest"]


def test_all_exponents_take_the_same_kernels(compiled: list[str]) -> None:
    for exponents in ("largest", "spectrum", "none"):
        warm.compile_once("two-mass", Settings(exponents=exponents))
    assert compiled == ["largest"]


def test_kernels_are_compiled_once_for_each_number_of_coordinates(compiled: list[str]) -> None:
    """A system of one's own takes those of the packaged one with as many, whatever its default cell is."""
    for system in ("two-mass", "impact-damper", System.from_toml(MACHINE), "chain-3", "bouncing-ball", "impact-pair"):
        warm.compile_once(system, Settings())
    assert len(compiled) == 3


@pytest.mark.parametrize("name", system_names())
def test_the_system_that_stands_in_has_as_many_coordinates(name: str) -> None:
    assert len(find_system(warm.stand_in(name)).states) == len(find_system(name).states)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({warm.stand_in(name) for name in system_names()}))
def test_the_default_cell_of_a_system_that_stands_in_has_impacts(name: str) -> None:
    """Compiled anew for each number of coordinates, which takes its time."""
    assert solve_tile(name, {}, Settings(max_periods=200, survival=0))["impacts_per_period"] > 0.0


def test_who_is_stopped_while_compiling_leaves_it_to_the_next(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(system: str, settings: Settings) -> bool:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(warm, "warm_up_in_child", stopped)
        warm.compile_once("two-mass", Settings())
    assert warm.warming() == COMPILING
    warm.compile_once("two-mass", Settings())
    assert compiled == ["largest"]


def test_the_user_reads_of_a_compilation_where_there_is_one(compiled: list[str]) -> None:
    assert warm.warming() == COMPILING
    warm.compile_once("two-mass", Settings())
    assert warm.warming() == LOADING


def test_without_a_folder_for_them_nothing_is_compiled_beforehand(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jit, "CACHE", None)
    warm.compile_once("two-mass", Settings())
    assert compiled == []


def test_the_child_compiles_what_it_is_given() -> None:
    """Run for real, the kernels being there: whatever it cannot do ends it with an error."""
    assert warm.warm_up_in_child("two-mass", Settings(max_period=8))
    assert not warm.warm_up_in_child("three-mass", Settings())
