import itertools
import json
import math
import os
import re
import subprocess
import sys
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import atlas
from atlas import Spec
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.overview.levels import MIN_SIDE, SIDE
from atlas.service import plan
from atlas.store.tile_records import complete_records
from tests.paths import ROOT
from tests.planes import plane_of
from tests.synthetic import complete
from workers.results import result_variables


def wide(nx: int, ny: int) -> Spec:
    axes = {"omega": {"start": 1, "stop": 2, "num": nx}, "b": {"start": 1, "stop": 2, "num": ny}}
    return Spec("two-mass", axes=axes)


@pytest.mark.parametrize(
    ("side", "workers", "tile"),
    [(1000, 4, 64), (3900, 4, 64), (4096, 4, 128), (4096, 65, 64), (8192, 4, 256), (50_000, 4, 256), (100_000, 4, 512)],
)
def test_the_default_tile_grows_with_the_plane_where_enough_are_left(side: int, workers: int, tile: int) -> None:
    assert plan.make_plan(wide(side, side), workers).tiling.tile == (tile, tile)


@pytest.mark.parametrize("side", [60_000, 100_000, 300_000])
def test_no_plane_has_more_than_50000_tiles_by_default(side: int) -> None:
    assert plan.make_plan(wide(side, side), workers=1000).tiling.count <= 50_000


@pytest.mark.parametrize(("size", "workers"), list(itertools.product([(40, 30), (280, 220), (7, 1000)], [1, 2, 16])))
def test_there_are_16_tiles_a_worker_where_there_are_cells_enough(size: tuple[int, int], workers: int) -> None:
    assert plan.make_plan(wide(*size), workers).tiling.count >= 16 * workers


def test_a_tile_is_never_smaller_than_a_cell() -> None:
    made = plan.make_plan(wide(3, 2), workers=100)
    assert made.tiling.tile == (1, 1)


def test_the_tile_of_a_store_wins_over_the_tile_asked_for() -> None:
    assert plan.make_plan(plane_of((2, 3)), workers=1, tile=(4, 5)).tiling.tile == (4, 5)


def test_a_tile_is_cut_to_the_plane() -> None:
    assert plan.make_plan(plane_of((64, 64)), workers=1).tiling.tile == (5, 7)


def test_bytes_bound_the_arrays_themselves() -> None:
    spec = wide(300, 200)
    shape = {"exponent": 4, "state": 4, "sample": 0}
    cell = sum(
        np.dtype(v.dtype).itemsize * math.prod(shape[dim] for dim in v.extra_dims)
        for v in result_variables(spec.settings)
    )
    assert plan.make_plan(spec, workers=1).bytes >= 300 * 200 * cell


def disk_use(path: Path) -> int:
    """Bytes of a folder as ``du`` counts them on a disk with blocks of 4096 bytes, one for each folder."""
    sizes = (entry.stat().st_size for entry in path.rglob("*") if entry.is_file())
    return sum(-(-size // 4096) * 4096 for size in sizes) + 4096 * sum(entry.is_dir() for entry in path.rglob("*"))


@pytest.mark.parametrize(("spec", "tile"), [(wide(45, 38), (8, 8)), (wide(200, 9), (3, 50)), (wide(12, 10), (64, 64))])
def test_a_store_takes_no_more_of_a_disk_than_its_plan_says(tmp_path: Path, spec: Spec, tile: tuple[int, int]) -> None:
    handle = complete(tmp_path / "out.zarr", tile, spec, SIDE, MIN_SIDE)
    complete_records(handle)
    bound = plan.make_plan(spec, 1, tile).bytes
    assert bound / 2 <= disk_use(handle.path) <= bound


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk with 1 kB to spare."""
    usage = namedtuple("usage", "free")(1000)
    monkeypatch.setattr(plan.shutil, "disk_usage", lambda _: usage)


@pytest.mark.usefixtures("full")
def test_a_run_on_a_disk_without_room_is_refused_with_both_sizes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"needs up to .* has 1 kB free"):
        atlas.run(wide(300, 200), tmp_path / "out.zarr")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("full")
def test_a_plan_for_a_disk_without_room_says_so_and_goes_on(tmp_path: Path) -> None:
    shown = CliRunner().invoke(main, ["plan", "tiny", "-o", str(tmp_path / "out.zarr"), "--no-probe", "--json"])
    assert shown.exit_code == 0
    assert json.loads(shown.stdout)["tiles"] > 0
    assert re.match(r"atlas run will refuse this: .*out.zarr: needs up to .* has 1 kB free", shown.stderr)


def test_a_plan_takes_any_number_of_workers() -> None:
    shown = CliRunner().invoke(main, ["plan", "tiny", "--workers", str(10**20), "--no-probe", "--json"])
    assert json.loads(shown.stdout)["workers"] == 10**20


def test_a_plan_prints_itself() -> None:
    printed = str(plan.make_plan(plane_of(), workers=2))
    assert "omega 2..4 (7 values) x b 0.1..0.5 (5 values)" in printed
    assert "35 (5 x 7; b, omega) in 9 tiles of 2 x 3" in printed


@pytest.mark.parametrize(
    ("low", "high", "says"),
    [(0.9, 1.1, "about 20 s on 2 workers (probed on 256 cells)"), (0.5, 1.5, "10 s to 30 s on 2 workers (probed on")],
)
def test_a_plan_prints_a_range_of_time_where_the_probe_leaves_one(low: float, high: float, says: str) -> None:
    probe = plan.ProbeResult(cells=256, periods_per_cell=100.0, seconds_per_cell=1.0, low=low, high=high)
    made = replace(plan.make_plan(wide(8, 5), workers=2), probe=probe)
    assert says in str(made)
    assert made.as_dict()["seconds"] == 20.0
    assert made.as_dict()["seconds_range"] == (20.0 * low, 20.0 * high)
    assert (made.as_dict()["processor_seconds"], made.as_dict()["periods"]) == (40.0, 4000.0)


def test_a_plan_over_initial_states_alone_names_the_table_for_basins() -> None:
    states = {"x1": {"start": -0.05, "stop": 0.05, "num": 4}, "v1": {"start": -1.0, "stop": 1.0, "num": 4}}
    plain = plan.make_plan(Spec("two-mass", axes=states))
    assert "[attractors]" in str(plain).splitlines()[-1] and "[attractors]" in plain.as_dict()["note"]
    others = states | {"v1": {"start": 1.0, "stop": 2.0, "num": 4}}
    for spec in (Spec("two-mass", axes=others, attractors={}), Spec("two-mass", axes={"omega": [2.0, 3.0]})):
        assert plan.make_plan(spec).note == "" and "note" not in str(plan.make_plan(spec))


COMPILED = """
import sys

def compiled():
    modules = [module for name, module in sorted(sys.modules.items()) if name.startswith("workers.")]
    return {
        (name, str(signature))
        for module in modules
        for name, kernel in vars(module).items()
        for signature in getattr(getattr(kernel, "python_kernel", kernel), "signatures", ())
    }
"""
"""What each kernel of workers has been compiled for, as a part of the scripts below."""

WARM = """
import numpy as np
import atlas
from atlas import Spec
from atlas.cli.main import main
from atlas.task.compile import warm_up
from workers.tile import solve_tile

spec = Spec("two-mass", axes={"omega": [2.0, 3.0]}, solve={"exponents": sys.argv[1], "max_periods": 600})
warm_up()
before = compiled()
rng = np.random.default_rng(1)
cells = {
    "omega": rng.uniform(0.5, 4.0, 60), "b": 10.0 ** rng.uniform(-2, 0, 60), "zeta": 10.0 ** rng.uniform(-2, 1, 60),
    "R": rng.choice([0.0, 0.3, 0.8, 1.0], 60),
}
found = solve_tile("two-mass", cells, spec.settings)
for k in range(60):
    solve_tile("two-mass", {name: values[k] for name, values in cells.items()}, spec.settings)
assert found["sticks"].any() and (found["regime"] == (4 if sys.argv[1] == "none" else 3)).any()
print(len(before), *sorted(compiled() - before))
"""


@pytest.mark.slow
@pytest.mark.parametrize("exponents", ["none", "largest", "spectrum"])
def test_after_the_warm_up_no_cell_compiles_anything(exponents: str) -> None:
    """Cells of every kind, alone and side by side, sticking and overdamped ones among them."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", COMPILED + WARM, exponents]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True).stdout
    count, *more = said.split(maxsplit=1)
    assert int(count) >= 9  # those that Python calls; loaded from the cache they bring no others
    assert not more


WARM_WITH_MODES = """
import numpy as np
from atlas.task.compile import MODES, WITH_MODES, warm_up
from workers import Settings, System, solve_tile

warm_up(MODES)
before = compiled()
system = System.from_mapping(WITH_MODES)
settings = Settings(exponents=sys.argv[1], max_periods=600)
solve_tile(system, {"omega": np.linspace(0.4, 2.0, 40)}, settings)
solve_tile(system, {"omega": 0.7}, settings)
rigid = {"name": "stop", "gap": [1.0], "upper": 0.2, "lower": -0.3, "restitution": 0.4}
solve_tile(System.from_mapping(WITH_MODES | {"contacts": [rigid]}), {"omega": np.linspace(0.4, 2.0, 40)}, settings)
print(len(before), *sorted(compiled() - before))
"""


@pytest.mark.slow
@pytest.mark.parametrize("exponents", ["none", "spectrum"])
def test_after_their_warm_up_no_cell_of_a_machine_with_modes_compiles_anything(exponents: str) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", COMPILED + WARM_WITH_MODES, exponents]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True).stdout
    count, *more = said.split(maxsplit=1)
    assert int(count) >= 8 and not more


WARM_WITH_MEASURES = """
import numpy as np
from atlas.task.compile import MEASURES, WITH_MEASURES, warm_up
from workers import Settings, System, solve_tile

warm_up(MEASURES)
before = compiled()
shaken = System.from_mapping(WITH_MEASURES | {"upper": 0.3, "lower": -0.2})
found = solve_tile(shaken, {"omega": np.linspace(0.4, 2.0, 40)}, Settings(max_periods=600))
assert np.isfinite(found["all_peak"]).any()
print(len(before), *sorted(compiled() - before))
"""


@pytest.mark.slow
def test_after_their_warm_up_no_measured_cell_compiles_anything() -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", COMPILED + WARM_WITH_MEASURES]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True).stdout
    count, *more = said.split(maxsplit=1)
    assert int(count) >= 8 and not more
