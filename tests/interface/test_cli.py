import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner, Result
from distributed import Client

import atlas
from atlas.cell.point_command import point_words
from atlas.cli.main import main
from atlas.cli.output import to_json
from atlas.service.summary import RunSummary
from atlas.service.timing import TIMING, Timing
from tests.paths import ROOT
from tests.support.faults import ATLAS, environment
from workers import Settings
from workers.model.system import find_system, system_names
from workers.results import PERIODS_SPENT, REASONS

SPEC = """
system = "two-mass"
[parameters]
R = 0.7
[axes.omega]
start = 2.0
stop = 4.0
num = 6
[axes.b]
values = [0.1, 0.2, 0.4, 0.5]
[solve]
max_periods = 400
tolerance = 0.1
[store]
tile = [1, 2]
"""


def call(*args: object, timing: Timing = TIMING) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args], obj=timing)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    """A folder with a spec, and its store made through the cluster's address: spec.toml, out.zarr."""
    made = tmp_path_factory.mktemp("atlas")
    (made / "spec.toml").write_text(SPEC)
    atlas.run(atlas.Spec.from_toml(made / "spec.toml"), made / "out.zarr", client=client)
    return made


def test_help_comes_without_the_heavy_imports() -> None:
    heavy = ["dask", "distributed", "xarray", "zarr", "matplotlib", "numba", "scipy"]
    code = (
        "import sys; from atlas.cli.main import main; main(['--help'], standalone_mode=False)\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "Compute:" in shown.stdout
    assert shown.stdout.splitlines()[-1] == "[]"


def test_a_map_is_drawn_without_numba(folder: Path, tmp_path: Path) -> None:
    asked = ["plot", str(folder / "out.zarr"), "-o", str(tmp_path / "map.png")]
    code = (
        f"import sys; from atlas.cli.main import main; main({asked}, standalone_mode=False)\n"
        "print('numba' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines()[-1] == "False"


@pytest.mark.parametrize("command", ["plan", "run", "cancel", "status", "query", "plot", "point", "systems"])
def test_every_command_has_help(command: str) -> None:
    assert call(command, "--help").exit_code == 0
    assert command in call("--help").stdout


def test_plan_prints_one_json_object(folder: Path) -> None:
    shown = call("plan", folder / "spec.toml", "--workers", 2, "--json")
    message = json.loads(shown.stdout)
    assert (message["cells"], message["tiles"], message["tile"]) == (24, 12, [1, 2])
    assert message["seconds"] > 0


def test_plan_for_a_person_names_axes_and_cells(folder: Path) -> None:
    assert "omega 2..4 (6 values)" in call("plan", folder / "spec.toml", "--no-probe").stdout


def test_a_complete_run_ends_with_0_and_says_so(folder: Path) -> None:
    shown = call("run", folder / "spec.toml", "-o", folder / "out.zarr")
    assert shown.exit_code == 0
    assert "12 of 12 tiles done" in shown.stdout


def test_status_counts_tiles_and_regimes(folder: Path) -> None:
    message = json.loads(call("status", folder / "out.zarr", "--json").stdout)
    assert (message["tiles_done"], message["tiles_pending"], message["fraction"]) == (12, 0, 1.0)
    assert sum(message["regimes"].values()) == message["cells"] == 24
    assert message["parameters"]["R"] == 0.7
    assert "12 of 12 done" in call("status", folder / "out.zarr").stdout


def test_query_at_a_point_gives_the_nearest_cell(folder: Path) -> None:
    message = json.loads(call("query", folder / "out.zarr", "--at", "omega=2.05", "--at", "b=.19", "--json").stdout)
    assert (message["omega"], message["b"]) == (2.0, 0.2)


def test_query_gives_the_shares_of_regimes(folder: Path) -> None:
    message = json.loads(call("query", folder / "out.zarr", "--window", "omega=2:3", "--json").stdout)
    assert message.pop("reasons") == {REASONS[PERIODS_SPENT].text: 3}
    assert sum(message.values()) == pytest.approx(1.0)


def test_query_and_run_say_what_their_shares_are_of(folder: Path, tmp_path: Path) -> None:
    """Cells of b = .1, .2, .4, .5 are .1, .15, .15 and .1 wide: shares of their number are not those of the area."""
    assert call("query", folder / "out.zarr").stdout.split("\n")[0].split() == ["regime", "share", "of", "the", "area"]
    assert "share of the length" in call("query", folder / "out.zarr", "--select", "b=.2").stdout
    counts = {"periodic": 3, "chaotic": 1}
    done = RunSummary("a.zarr", 2, 2, 2, 4, counts, {}, 1.0, 1.0, 0.0, 10, 1, 1, (), {})
    assert "shares of these cells: periodic 75.0 %, chaotic 25.0 %" in str(done).splitlines()


@pytest.mark.parametrize("suffix", ["csv", "nc"])
def test_query_writes_a_window_to_a_file(folder: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"window.{suffix}"
    shown = call("export", folder / "out.zarr", "--window", "omega=2:3", "--window", "b=.1:.3", "-o", out, "--json")
    assert json.loads(shown.stdout) == {"file": str(out), "cells": 6}
    assert out.stat().st_size > 500
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


def test_a_window_without_a_cell_is_refused_and_nothing_written(folder: Path, tmp_path: Path) -> None:
    shown = call("export", folder / "out.zarr", "--window", "omega=7:8", "-o", tmp_path / "a.csv")
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert "no cell centre with omega from 7 to 8" in shown.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_the_shares_of_whole_tiles_come_from_their_records_and_of_cut_tiles_from_their_cells(folder: Path) -> None:
    assert call("query", folder / "out.zarr").stderr == "0 chunks read from the store\n"
    cut = call("query", folder / "out.zarr", "--window", "omega=2:2.2").stderr
    assert cut == "6 chunks read from the store\n"  # four with classes, and in two of their tiles reasons


def test_render_takes_a_window_and_reports_how_many_chunks_it_read(folder: Path, tmp_path: Path) -> None:
    shown = call("plot", folder / "out.zarr", "-o", tmp_path / "a.png", "--window", "omega=2:2.5")
    assert shown.exit_code == 0
    assert "8 chunks read from the store, at full resolution" in shown.stderr


def test_render_writes_the_picture_and_names_it(folder: Path) -> None:
    shown = call("plot", folder / "out.zarr", "-o", folder / "map.png")
    assert (shown.exit_code, shown.stdout.strip()) == (0, str(folder / "map.png"))
    assert (folder / "map.png").read_bytes()[:4] == b"\x89PNG"


def test_the_words_of_a_point_name_what_is_not_the_default_and_nothing_else() -> None:
    system = find_system("two-mass")
    defaults = {parameter.name: parameter.default for parameter in system.parameters}
    assert point_words(system, defaults, Settings()) == ["atlas", "point"]
    found = point_words(system, defaults | {"R": 0.1 + 0.2}, Settings(max_periods=300, exponents="spectrum"), ["b"])
    assert sorted(zip(found[2::2], found[3::2], strict=True)) == [
        ("--exponents", "spectrum"), ("--max-periods", "300"), ("--set", "R=0.30000000000000004"),
        ("--set", f"b={defaults['b']!r}"),
    ]  # fmt: skip


def test_point_gives_every_result_of_one_cell() -> None:
    args = ("point", "--set", "omega=3", "--set", "b=0.2", "--exponents", "spectrum", "--max-periods", 300)
    message = json.loads(call(*args, "--json").stdout)
    assert {"regime", "largest", "spectrum", "period", "periods_used", "state"} <= message.keys()
    assert message["parameters"]["omega"] == 3.0
    assert message["parameters"]["mu_k"] == 5.0
    assert "periods_used" in call(*args).stdout


def test_systems_lists_parameters_with_their_ranges() -> None:
    assert "0 <= R <= 1" in call("systems", "two-mass").stdout


@pytest.mark.parametrize("name", [name for name in system_names() if find_system(name).definition.unforced])
def test_what_a_machine_without_a_force_loses_is_told_per_unit_of_time(name: str) -> None:
    told = call("systems", name).stdout
    assert "forcing period" not in told
    assert "per unit time" in told


def test_json_writes_infinity_as_text_and_nan_as_null() -> None:
    value = {"a": -math.inf, "b": (math.nan, np.float64("inf")), "c": np.array([1, 2]), "d": np.bool_(True)}
    assert json.loads(to_json(value)) == {"a": "-inf", "b": [None, "inf"], "c": [1, 2], "d": True}


FAR = 'system = "two-mass"\naxes.x1 = { start = -1e308, stop = 1e308, num = 9 }\n'

BAD_SPECS = {
    "unknown parameter": ("R = 0.7", "RR = 0.7", "unknown parameter 'RR'; did you mean 'R'?"),
    "R above 1": ("R = 0.7", "R = 1.2", "R = 1.2: must satisfy 0 <= R <= 1"),
    "b not positive": ("[0.1,", "[0.0,", "b = 0.0: must satisfy 0 < b"),
    "omega not positive": ("start = 2.0", "start = -2.0", "omega = -2.0: must satisfy 0 < omega"),
    "negative mass": ("R = 0.7", "mu_m = -1", "mu_m = -1.0: must satisfy 0 < mu_m"),
    "NaN": ("R = 0.7", "R = nan", "R = nan: must be a finite number"),
    "axis repeated": ("[axes.b]", "[axes.omega]", "not a TOML file"),
    "axis without points": ("num = 6", "num = 0", "axes.omega.num: found 0 points"),
    "four axes": (
        "[solve]",
        "[axes.zeta]\nvalues = [0.1]\n[axes.f2]\nvalues = [0.1]\n[solve]",
        "axes: found 4 (omega, b, zeta, f2)",
    ),
    "no axes": (SPEC, 'system = "two-mass"\n[axes]\n', "axes: found none"),
    "parameter that is an axis": ("R = 0.7", "omega = 1.0", "omega is both a parameter and an axis"),
    "not TOML": (SPEC, "{]", "not a TOML file"),
    "nested": (SPEC, "a = " + "[" * 5000, "nested too deeply"),
    "too far": (SPEC, FAR, "from start -1e+308 to stop 1e+308 is farther than a float can hold"),
    "unknown key": ("max_periods", "max_perods", "did you mean 'max_periods'?"),
}


@pytest.mark.parametrize("name", BAD_SPECS)
def test_a_bad_spec_is_one_line_and_exit_code_2_and_writes_nothing(tmp_path: Path, name: str) -> None:
    before, after, message = BAD_SPECS[name]
    assert before in SPEC
    spec = tmp_path / "spec.toml"
    spec.write_text(SPEC.replace(before, after, 1))
    check_refused(call("run", spec, "-o", tmp_path / "out.zarr"), message)
    assert list(tmp_path.iterdir()) == [spec]


def test_a_missing_spec_is_refused(tmp_path: Path) -> None:
    check_refused(call("run", tmp_path / "none.toml", "-o", tmp_path / "out.zarr"), "no such file")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("R = 0.7", "R = 0.6", "R = 0.7 in the store, 0.6 in the spec"),
        ("omega", "b", "axis order differs: (omega, b) in the store, (b, omega) in the spec"),
    ],
    ids=["another spec", "transposed"],
)
def test_a_store_of_another_spec_is_refused_and_untouched(folder: Path, before: str, after: str, message: str) -> None:
    text = SPEC.replace(before, after)
    if after == "b":
        text = (
            SPEC.replace("[axes.omega]", "[axes.x]").replace("[axes.b]", "[axes.omega]").replace("[axes.x]", "[axes.b]")
        )
        text = text.replace("tile = [1, 2]", "")
    other = folder / "other.toml"
    other.write_text(text)
    whole = state_of(folder / "out.zarr")
    check_refused(call("run", other, "-o", folder / "out.zarr"), message)
    assert state_of(folder / "out.zarr") == whole


def test_a_store_that_is_not_ours_is_refused_and_untouched(folder: Path, tmp_path: Path) -> None:
    zarr.create_group(tmp_path / "foreign.zarr")
    whole = state_of(tmp_path)
    for command in (("run", folder / "spec.toml", "-o"), ("status",), ("query",)):
        check_refused(call(*command, tmp_path / "foreign.zarr"), "not an atlas")
    assert state_of(tmp_path) == whole


def test_an_unwritable_path_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    check_refused(call("run", folder / "spec.toml", "-o", tmp_path / "file" / "out.zarr"), "cannot be written")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_folder_that_refuses_is_refused(folder: Path, tmp_path: Path) -> None:
    if os.geteuid() == 0:
        target = Path("/proc/out.zarr")
    else:
        tmp_path.chmod(0o500)
        target = tmp_path / "out.zarr"
    check_refused(call("run", folder / "spec.toml", "-o", target), "cannot be written")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "tcp://no-such-host.invalid:8786"])
def test_an_unreachable_scheduler_is_refused(folder: Path, tmp_path: Path, address: str) -> None:
    args = ("run", folder / "spec.toml", "-o", tmp_path / "out.zarr", "--scheduler", address)
    check_refused(call(*args, timing=Timing(connect=0.3)), f"{address}: no scheduler answers")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("point", "--set", "R=1.2"), "R = 1.2: must satisfy 0 <= R <= 1"),
        (("point", "--set", "omgea=2"), "unknown parameter 'omgea'; did you mean 'omega'?"),
        (("point", "--set", "omega"), "--set omega: must be NAME=VALUE"),
        (("point", "--set", "omega=fast"), "--set omega: found 'fast', must be a number"),
        (("point", "--set", "omega=2", "--set", "omega=3"), "--set omega: given twice"),
        (("point", "--tolerance", "0"), "solve.tolerance: found 0.0"),
        (("query", "OUT", "--at", "omega=3"), "point: found no b"),
        (("query", "OUT", "--at", "omega=99", "--at", "b=0.2"), "omega = 99 lies outside"),
        (("query", "OUT", "--window", "omega=3:2"), "must be LOW:HIGH with LOW <= HIGH"),
        (("query", "OUT", "--window", "omega=2:3", "--at", "b=1"), "give only one"),
        (("export", "OUT", "-o", "window.txt"), "window.txt: the suffix chooses the format, found '.txt'"),
        (("status", "NONE"), "no such store"),
        (("statsu", "OUT"), "unknown command 'statsu'; did you mean 'status'?"),
        (("--jason",), "No such option '--jason'"),
        (("plan", "tiny", "--workers", "few"), "Invalid value for '--workers': 'few' is not a valid integer"),
        (("plan",), "Missing argument 'SPEC' (see atlas plan --help)"),
        (("plan", "x" * 6000), "File name too long"),
        (("point", "--set", f"omega={'x' * 6000}"), "--set omega: found 'xxx"),
        (("run", "tiny", "-o", "NONE", "--workers", "2", "--scheduler", "tcp://x:1"), "give only one"),
    ],
)
def test_a_bad_question_is_one_line_and_exit_code_2(folder: Path, args: tuple[str, ...], message: str) -> None:
    names = {"OUT": folder / "out.zarr", "NONE": folder / "none.zarr"}
    shown = call(*(names.get(arg, arg) for arg in args))
    lines = shown.stderr.splitlines()
    assert (shown.exit_code, len(lines), shown.stdout) == (2, 1, "")
    assert message in lines[0]
    assert len(lines[0]) < 600


def test_a_picture_that_cannot_be_made_is_refused(folder: Path) -> None:
    shown = call("plot", folder / "out.zarr", "-o", folder / "map.xyz")
    assert shown.exit_code == 2
    assert "suffix" in shown.stderr.splitlines()[-1]
    shown = call("plot", folder / "out.zarr", "-o", folder / "no" / "map.png")
    assert shown.exit_code == 2
    assert "map.png: cannot be written" in shown.stderr.splitlines()[-1]


INTERRUPTED = """
import os, signal, sys
from atlas.cli import progress
from atlas.cli.main import main

class Interrupting(progress.LogReporter):
    def __call__(self, snapshot):
        super().__call__(snapshot)
        if snapshot.tiles_done == 3 and snapshot.stage == "solving":
            os.killpg(0, signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background starts with it ignored
progress.reporter = Interrupting
main(sys.argv[1:])
"""


@pytest.mark.slow
def test_ctrl_c_ends_with_130_and_the_line_printed_goes_on(tmp_path: Path) -> None:
    """SIGINT to the whole process group, as a terminal sends it, while worker processes solve tiles of 0.3 s."""
    (tmp_path / "spec.toml").write_text(SPEC)
    args = ["run", "spec.toml", "-o", "out.zarr", "--workers", "2"]
    slow = environment(tmp_path / "faults", {"*": ["slow"]})
    options = {"cwd": tmp_path, "env": slow, "capture_output": True, "text": True}
    first = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, *args], start_new_session=True, timeout=300, check=False, **options
    )
    assert first.returncode == 130
    assert "Traceback" not in first.stderr
    assert first.stderr.splitlines()[-1].endswith("rerun the same command to resume")
    chunks = tmp_path / "out.zarr" / "regime" / "c"
    kept = {path: path.stat().st_mtime_ns for path in chunks.rglob("*") if path.name.isdigit() and path.is_file()}
    assert 3 <= len(kept) < 12

    second = subprocess.run([*ATLAS, *args], timeout=300, check=False, **options)
    assert second.returncode == 0
    assert f"resuming: {len(kept)} of 12 tiles are done" in second.stderr
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert (xr.open_zarr(tmp_path / "out.zarr").regime.values >= 0).all()


def check_refused(shown: Result, message: str) -> None:
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert len(shown.stderr.splitlines()) == 1, shown.stderr
    assert message in shown.stderr


def state_of(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
