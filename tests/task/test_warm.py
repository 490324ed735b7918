"""The kernels' compilation, by one process of a machine."""

import io
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas.cli.progress import LogReporter
from atlas.service.progress import prepare_kernels
from atlas.spec.examples import example_text
from atlas.task import compile as warm
from tests.paths import ROOT
from tests.reference_machines import bouncing_ball, impact_pair
from tests.support.faults import ATLAS
from tests.workers.attractors.test_attractors import CHAOTIC_TWINS, TWINS
from tests.workers.continuation.test_branches import ball_orbit, pair_orbit
from workers import Settings, solve_tile
from workers.attractors import cell_attractors, matching
from workers.attractors.basins import solve_basins
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.attractors.matching import orbits_reached
from workers.continuation import admissibility, branch, curve, legs, shooting
from workers.kernel import cache, cell_loops, jit
from workers.kernel.hybrid import motion
from workers.kernel.lanes import run
from workers.model.system import find_system
from workers.orbit import newton
from workers.orbit.map import iterate

KERNELS = [
    value for module in (cell_loops, run, newton) for value in vars(module).values() if isinstance(value, jit.Kernel)
]
"""What Python calls, among others."""
OF_ATTRACTORS = [
    *KERNELS,
    *(
        value
        for module in (cell_attractors, matching)
        for value in vars(module).values()
        if isinstance(value, jit.Kernel)
    ),
]

OLDEST = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
"""Numba compiles for the oldest 64-bit processor of this architecture, without AVX and fused multiply-add."""

BITS = """
import hashlib
import sys
import numpy as np
from atlas.task import compile as warm
from workers import Settings, solve_tile
del sys.argv[1:]
warm.main()
omega, b = np.meshgrid(np.linspace(2.0, 4.0, 12), np.linspace(0.05, 0.5, 8))
found = solve_tile("two-mass", {"omega": omega, "b": b}, Settings(exponents="spectrum", survival=1000))
bits = b"".join(np.ascontiguousarray(found[name]).tobytes() for name in sorted(found))
print(hashlib.sha256(bits).hexdigest())
"""
WINDOW = {"A": (0.5, 4.0), "R": (0.3, 0.7)}

COMPILING = "compiling the kernels, once for this version"
LOADING = "loading the kernels"


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What has been compiled, into a folder that holds nothing at first."""
    done: list[str] = []

    def slowly(parts: tuple[str, ...], report: warm.Report | None) -> bool:
        time.sleep(0.2)
        done.extend(part or "cells" for part in parts)
        return True

    monkeypatch.setattr(cache, "CACHE", tmp_path)
    monkeypatch.setattr(warm, "warm_up_in_child", slowly)
    monkeypatch.setattr(warm, "TICK", 0.01)
    return done


def test_of_many_that_need_the_kernels_one_compiles_them(compiled: list[str]) -> None:
    asking = [threading.Thread(target=warm.compile_once) for _ in range(8)]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert compiled == ["cells"]


def test_a_kernel_costs_nothing_until_it_is_called() -> None:
    """Numba looks at the sources and at the disk for each function that it is to compile, or to load."""

    @jit.kernel
    def half(x: float) -> float:
        return 0.5 * x

    assert not {"python_kernel", "inner_kernel"} & vars(half).keys()
    assert half(3.0) == 1.5
    assert "python_kernel" in vars(half) and "inner_kernel" not in vars(half)


@pytest.mark.parametrize("name", ["bouncing-ball", "impact-damper", "chain-3", "chain-8"])
def test_no_system_has_kernels_of_its_own(name: str) -> None:
    """Of one, two and more coordinates, with rigid modes and loads: none compiles what others have compiled."""
    warm.warm_up()
    before = {kernel: len(kernel.python_kernel.signatures) for kernel in KERNELS}
    solve_tile(name, {}, Settings(exponents="spectrum", survival=0, max_periods=500))
    assert {kernel: len(kernel.python_kernel.signatures) for kernel in KERNELS} == before


def test_who_is_stopped_while_compiling_leaves_it_to_the_next(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(parts: tuple[str, ...], report: warm.Report | None) -> bool:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(warm, "warm_up_in_child", stopped)
        warm.compile_once()
    assert warm.compile_notice() == COMPILING
    warm.compile_once()
    assert compiled == ["cells"]


def test_what_attractors_and_orbits_take_is_compiled_where_it_is_asked_for_and_once(compiled: list[str]) -> None:
    for more in ((), (warm.ATTRACTORS,), (warm.ORBITS, warm.ATTRACTORS), (warm.ORBITS,)):
        warm.compile_once(*more)
    assert compiled == ["cells", "attractors", "orbits"]
    assert warm.compile_notice(warm.ATTRACTORS, warm.ORBITS) == LOADING


def test_no_attractor_has_kernels_of_its_own() -> None:
    """Twins, chaos and its twin, basins: none compiles what was not compiled beforehand."""
    warm.warm_up(warm.ATTRACTORS)
    before = {kernel: len(kernel.python_kernel.signatures) for kernel in OF_ATTRACTORS}
    brief = Settings(max_periods=4000, survival=8000, tolerance=0.05)
    for twins in (TWINS, CHAOTIC_TWINS):
        solve_attractors("two-mass", twins, brief, AttractorSettings(8))
    solve_basins("two-mass", {"omega": 4.0, "b": 0.1, "x1": np.array([0.0, 0.05])}, brief, AttractorSettings(2))
    assert {kernel: len(kernel.python_kernel.signatures) for kernel in OF_ATTRACTORS} == before
    assert all(before[kernel] for kernel in (orbits_reached, iterate))


def test_the_user_reads_of_a_compilation_where_there_is_one(compiled: list[str]) -> None:
    assert warm.compile_notice() == COMPILING
    warm.compile_once()
    assert warm.compile_notice() == LOADING


def test_without_a_folder_for_them_nothing_is_compiled_beforehand(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "CACHE", None)
    warm.compile_once()
    assert compiled == []


def test_the_child_compiles_what_it_is_given() -> None:
    """Run for real, the kernels being there: whatever it cannot do ends it with an error."""
    assert warm.warm_up_in_child((warm.CELLS,))


def test_who_waits_for_another_process_hears_of_it_too(compiled: list[str]) -> None:
    heard: list[int | None] = []
    first = threading.Thread(target=warm.compile_once)
    first.start()
    time.sleep(0.05)
    warm.compile_once(report=lambda functions, seconds: heard.append(functions))
    first.join()
    assert compiled == ["cells"]
    assert heard and set(heard) == {None}


def test_a_log_shows_how_far_a_compilation_is_and_how_long_it_has_taken(
    compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def reports(parts: tuple[str, ...], report: warm.Report) -> bool:
        for done in (43, 86):
            report(done, done / 4.3)
        return True

    monkeypatch.setattr(warm, "warm_up_in_child", reports)
    log = io.StringIO()
    with LogReporter(log, interval=0.0) as show:
        prepare_kernels(show)
    assert log.getvalue().splitlines() == [
        COMPILING,
        f"{COMPILING}: 43 functions after 10 s",
        f"{COMPILING}: 86 functions after 20 s",
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for compiled kernels, empty at first."""
    return tmp_path_factory.mktemp("kernels")


@pytest.fixture(scope="module")
def said_in_turn(folder: Path) -> list[tuple[list[str], float]]:
    """Lines of a process that compiles the kernels, into an empty folder, and of one that loads them; their seconds.

    How many functions are compiled by then, about every second, and last the bits of cells. Compiled for another kind
    of processor than this one.
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(ROOT)} | OLDEST
    found = []
    for _ in "12":
        begin = time.monotonic()
        done = subprocess.run([sys.executable, "-c", BITS], env=environment, capture_output=True, text=True, check=True)
        found.append((done.stdout.splitlines(), time.monotonic() - begin))
    assert any(folder.rglob("*.nbc"))
    return found


@pytest.mark.slow
def test_a_process_that_compiles_says_how_far_it_is_once_a_tick_and_of_no_function_twice(
    said_in_turn: list[tuple[list[str], float]],
) -> None:
    (*said, _), seconds = said_in_turn[0]
    counts = [int(line) for line in said]
    assert len(set(counts)) == len(counts) and counts == sorted(counts)
    assert 3 <= len(counts) <= seconds / warm.TICK


def test_who_waits_for_a_compilation_hears_what_the_child_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = tmp_path / "python"
    child.write_text("#!/bin/sh\necho 43\necho 86\n")
    child.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(child))
    heard: list[tuple[int | None, float]] = []
    assert warm.warm_up_in_child((warm.CELLS,), lambda functions, seconds: heard.append((functions, seconds)))
    assert [functions for functions, _ in heard] == [43, 86]
    assert 0.0 <= heard[0][1] <= heard[1][1]


@pytest.mark.slow
def test_a_process_that_compiles_the_kernels_gets_the_bits_of_those_that_load_them(
    said_in_turn: list[tuple[list[str], float]],
) -> None:
    assert len({said[-1] for said, _ in said_in_turn}) == 1


@pytest.mark.slow
def test_kernels_compiled_for_another_kind_of_processor_give_the_same_bits(
    said_in_turn: list[tuple[list[str], float]], folder: Path, tmp_path: Path
) -> None:
    """7 x 5 cells of the packaged plane."""
    spec = tmp_path / "plane.toml"
    spec.write_text(re.sub(r"(?m)^num = (\d+)", lambda found: f"num = {int(found[1]) // 40}", example_text("omega-b")))
    found = []
    for name, variables in (("own", {}), ("oldest", OLDEST | {"NUMBA_CACHE_DIR": str(folder)})):
        command = [*ATLAS, "run", str(spec), "-o", str(tmp_path / f"{name}.zarr")]
        environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
        subprocess.run(command, env=environment, capture_output=True, check=True)
        ds = atlas.open(tmp_path / f"{name}.zarr")
        found.append({name: values.values.tobytes() for name, values in ds.data_vars.items()})
    assert ds["regime"].size == 35
    assert found[0] == found[1]


@pytest.mark.slow
def test_after_the_warm_up_no_branch_and_no_curve_compiles_anything() -> None:
    """Of a ball, whose orbit folds and doubles, and of a pair, whose orbit breaks symmetry: most events."""
    warm.warm_up(warm.ORBITS)
    modules = (legs, shooting, admissibility)
    kernels = {value for module in modules for value in vars(module).values() if isinstance(value, jit.Kernel)}
    before = {kernel: list(kernel.python_kernel.signatures) for kernel in kernels}
    run = branch(bouncing_ball(("A",), R=0.5), ball_orbit(1.5, 0.5), 1.5, (0.5, 4.0))
    curve(bouncing_ball(("A", "R")), run.events[0], np.array([float(run.events[0].point.values[0]), 0.5]), WINDOW)
    branch(impact_pair(("alpha",), R=0.5), pair_orbit(0.2, 0.5), 0.2, (0.05, 1.0))
    assert {kernel: list(kernel.python_kernel.signatures) for kernel in kernels} == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bouncing-ball", "capsule"])
def test_after_the_warm_up_no_time_history_compiles_anything(name: str) -> None:
    warm.warm_up(*warm.kernels_for(find_system(name), warm.PATHS, warm.ORBITS))
    modules = (motion, cell_loops, run)
    kernels = {value for module in modules for value in vars(module).values() if isinstance(value, jit.Kernel)}
    before = {kernel: list(kernel.python_kernel.signatures) for kernel in kernels}
    atlas.time_history(system=name, periods=3, transient=2)
    assert {kernel: list(kernel.python_kernel.signatures) for kernel in kernels} == before
