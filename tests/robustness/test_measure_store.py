"""Claims about stability measures of all cells of a store: numbers of single cells, what a store keeps, resuming."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.errors import InputError, RunError
from atlas.robustness.job import MeasureJob, group_of, measure_and_keep, pieces, read_measured
from atlas.robustness.linear_measures import FLAGS
from atlas.robustness.table import (
    LINEAR,
    MEASURES,
    SHOCKS,
    VERSION,
    StoredMeasures,
    empty,
    of_family,
    read_measures,
    write_measures,
)
from atlas.service.measures import _content, _digest, measure_attractors
from atlas.store.create import create_store
from atlas.store.groups import STABILITY
from atlas.store.parts import finished_parts, get_part, part_names, put_part
from atlas.store.store import open_store
from atlas.task.store_ref import StoreRef
from tests import synthetic
from workers import SOLVER_VERSION
from workers.results import NO_IMPACT, PERIODIC

NORM = {"v1": 0.5}
LINEAR_NAMES = [measure.name for measure in of_family(LINEAR)]


@pytest.fixture(scope="module")
def unmeasured(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """Twins, a symmetric orbit and motion without impact, two attractors a cell at most."""
    spec = atlas.Spec(
        "two-mass",
        {"omega": {"values": [3.5, 3.6, 4.0]}, "b": {"values": [0.1, 0.104]}},
        solve={"max_periods": 2000, "survival": 2000},
        attractors={"starts": 8, "keep": 3},
        store={"tile": [2, 2]},
    )
    return solved_once(spec)


@pytest.fixture(scope="module")
def measured(unmeasured: Path, tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    path = copied(unmeasured, tmp_path_factory.mktemp("measured"))
    measure_attractors(path, norm=NORM, client=client)
    return path


@pytest.fixture(scope="module")
def plane(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """One attractor a cell, on a linear and a logarithmic axis; one cell is invalid."""
    axes = {"omega": {"values": [2.0, 3.0, 4.0]}, "b": {"start": 0.1, "stop": 0.4, "num": 3, "scale": "log"}}
    return solved_once(atlas.Spec("two-mass", axes, solve={"max_periods": 2000, "survival": 2000}))


def copied(store: Path, to: Path) -> Path:
    return Path(shutil.copytree(store, to / "copy.zarr"))


def test_measures_of_a_store_are_those_of_single_cells(measured: Path) -> None:
    """Truth: ``atlas.stability``, which finds the attractors of a cell anew and linearises its own orbits."""
    ds = atlas.open(measured)
    for omega in (3.5, 4.0):
        cell = ds.sel(omega=omega, b=0.1)
        solve: dict[str, Any] = {"max_periods": 2000, "survival": 2000}
        found = atlas.stability({"omega": omega, "b": 0.1}, starts=8, norm=NORM, settings=atlas.Settings(**solve))[
            "coexisting"
        ]
        assert len(found) == int(cell["attractors"]) >= 2
        for place, row in enumerate(found[: ds.sizes["attractor"]]):
            for name in ("return_time", "reactivity", "amplification", "amplified_after"):
                assert float(cell[name][place]) == pytest.approx(row[name], rel=1e-9, nan_ok=True)


def test_places_without_an_attractor_have_no_measure(measured: Path) -> None:
    ds = atlas.open(measured)
    empty = ~ds["regime"].isin([NO_IMPACT, PERIODIC])
    assert empty.any()
    for name in LINEAR_NAMES:
        fill = MEASURES[name].fill
        values = ds[name].values[empty.values]
        assert np.isnan(values).all() if fill != fill else (values == fill).all()


def test_plain_xarray_opens_the_group_and_explains_its_codes(measured: Path) -> None:
    group = xr.open_zarr(measured, group=STABILITY)
    assert set(LINEAR_NAMES) <= set(group.data_vars)
    assert group["return_time"].dims == ("b", "omega", "attractor")
    assert group["omega"].values.tolist() == [3.5, 3.6, 4.0]
    assert group["return_time"].attrs["units"] == "1"
    assert group["unmeasured"].attrs["flag_meanings"].split() == list(FLAGS)
    assert group.attrs["linear"]["norm"] == NORM


def test_a_store_of_one_attractor_a_cell_is_measured_too(plane: Path, tmp_path: Path, client: Client) -> None:
    path = copied(plane, tmp_path)
    measure_attractors(path, client=client)
    ds = atlas.open(path)
    assert ds["return_time"].dims == ("b", "omega")
    periodic = np.isin(ds["regime"].values, (NO_IMPACT, PERIODIC))
    largest = ds["largest"].values[periodic]
    assert ds["return_time"].values[periodic] == pytest.approx(-1.0 / largest, rel=1e-12)
    assert (ds["amplification"].values[periodic & (ds["unmeasured"].values < 0)] >= 1.0).all()


def test_what_a_store_has_is_not_computed_again(measured: Path, client: Client) -> None:
    again = measure_attractors(measured, norm=NORM, client=client)
    assert (again.tasks, again.seconds) == (0, 0.0)
    assert again.measures["return_time"]["known"] > 0


def test_another_norm_is_computed_anew(measured: Path, tmp_path: Path, client: Client) -> None:
    path = copied(measured, tmp_path)
    before = atlas.open(path).load()
    assert measure_attractors(path, norm={"v1": 5.0}, client=client).tasks > 0
    after = atlas.open(path).load()
    assert after["return_time"].equals(before["return_time"])
    assert not after["reactivity"].equals(before["reactivity"])


def test_a_run_that_was_stopped_loses_nothing(unmeasured: Path, measured: Path, tmp_path: Path, client: Client) -> None:
    """Every other part is done by hand; the rest is done by the call, and no bit differs."""
    path = copied(unmeasured, tmp_path)
    handle = open_store(path)
    digest = _digest({LINEAR: {"content": _content(handle), "norm": NORM}})
    finished_parts(handle, group_of(LINEAR), digest)
    parts = list(pieces(handle, LINEAR))
    site = StoreRef(str(path), handle.run_id, SOLVER_VERSION)
    for k, (name, tile, first, last) in list(enumerate(parts))[::2]:
        measure_and_keep(MeasureJob((k,), name, LINEAR, tile, first, last, tuple(NORM.items()), site))
        assert read_measured(handle, name)["return_time"].shape == (last - first, 3)
    summary = measure_attractors(path, norm=NORM, client=client)
    assert summary.tasks == len(parts) // 2
    assert not list(part_names(handle, STABILITY))
    xr.testing.assert_identical(atlas.open(path).load(), atlas.open(measured).load())


def test_parts_of_another_request_are_not_taken(unmeasured: Path, tmp_path: Path) -> None:
    handle = open_store(copied(unmeasured, tmp_path))
    finished_parts(handle, group_of(LINEAR), "one")
    (name, tile, first, last) = next(iter(pieces(handle, LINEAR)))
    site = StoreRef(str(handle.backend), handle.run_id, SOLVER_VERSION)
    measure_and_keep(MeasureJob((0,), name, LINEAR, tile, first, last, (), site))
    assert name.removeprefix("linear/") in finished_parts(handle, group_of(LINEAR), "one")
    assert name.removeprefix("linear/") not in finished_parts(handle, group_of(LINEAR), "another")


def test_measuring_one_family_keeps_the_finished_parts_of_another(
    unmeasured: Path, tmp_path: Path, client: Client
) -> None:
    """Truth: plain measure threw away what an interrupted measure --shocks had found in hours."""
    handle = open_store(copied(unmeasured, tmp_path))
    finished_parts(handle, group_of(SHOCKS), "shocks")
    put_part(handle, group_of(SHOCKS), "0.0-0", b"hours")
    measure_attractors(handle.path, client=client)
    assert get_part(handle, group_of(SHOCKS), "0.0-0") == b"hours"
    assert not list(part_names(handle, group_of(LINEAR)))


def test_parts_of_another_version_of_the_measures_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    requests: dict[str, Any] = {LINEAR: {"content": "", "norm": NORM}}
    before = _digest(requests)
    assert _digest(requests) == before
    monkeypatch.setattr("atlas.service.measures.VERSION", VERSION + 1)
    assert _digest(requests) != before


def test_verify_finds_a_flipped_byte_of_a_measure_and_repair_drops_the_group(measured: Path, tmp_path: Path) -> None:
    path = copied(measured, tmp_path)
    chunk = path / STABILITY / "reactivity" / "c/0/0/0"
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 0x10
    chunk.write_bytes(data)
    (fault,) = atlas.verify(path, sample=0).faults
    assert "stability/reactivity/c/0/0/0" in str(fault) and f"atlas attractors measure {path} makes it anew" in str(
        fault
    )
    assert any("stability dropped" in line for line in atlas.verify(path, sample=0, repair=True).restored)
    assert "reactivity" not in atlas.open(path)
    assert atlas.verify(path, sample=0).is_sound


@pytest.mark.parametrize("name", ["return_time", "reactivity", "amplification"])
def test_each_measure_is_drawn_as_a_map(measured: Path, name: str) -> None:
    drawn = atlas.open(measured).atlas.plot(variable=name)
    assert any(axis.get_ylabel() for axis in drawn.axes[1:])


def test_a_store_without_measures_says_how_to_get_them(unmeasured: Path) -> None:
    with pytest.raises(InputError, match="measure its attractors by atlas attractors measure"):
        atlas.open(unmeasured).atlas.plot(variable="return_time")


def test_what_another_run_has_measured_meanwhile_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, client: Client
) -> None:
    """It ends while this one waits for the claim."""
    handle = create_store(tmp_path / "made.zarr", synthetic.spec_of(4, 3), (3, 4))
    synthetic.fill(handle)
    theirs = StoredMeasures(empty(of_family(LINEAR), handle.spec.shape), {LINEAR: {"content": "theirs", "norm": NORM}})

    @contextmanager
    def claimed_late(*_: object) -> Iterator[Any]:
        write_measures(handle, theirs)
        yield SimpleNamespace(bind=lambda place: place)

    monkeypatch.setattr("atlas.service.store_call.hold_lease", claimed_late)
    with pytest.raises(RunError, match="another run has measured it meanwhile; rerun the same command"):
        measure_attractors(handle.path, client=client)
    assert read_measures(handle).requests == theirs.requests


# Errors


def fails(*words: str) -> str:
    shown = CliRunner().invoke(main, ["attractors", "measure", *words])
    assert (shown.exit_code, shown.stdout) == (2, "")
    (line,) = shown.stderr.splitlines()
    return line


def test_bad_input_is_one_line_and_nothing_is_written(plane: Path, tmp_path: Path) -> None:
    path = copied(plane, tmp_path)
    store = str(path)
    assert "shocks need an atlas of all attractors, see [attractors]" in fails(store, "--shocks")
    assert "norm.v1: found 0, must be above 0" in fails(store, "--norm", "v1=0")
    assert not (path / STABILITY).exists()


def test_the_command_prints_the_summary(measured: Path) -> None:
    words = ["attractors", "measure", str(measured), "--norm", "v1=0.5"]
    shown = CliRunner().invoke(main, [*words, "--json"])
    assert shown.exit_code == 0, shown.output
    found = json.loads(shown.stdout)
    assert found["linear"] == {"norm": NORM} and found["measures"]["reactivity"]["known"] > 0
    assert "return_time: " in CliRunner().invoke(main, words).stdout


@pytest.mark.slow
def test_shocks_of_a_store_are_those_of_single_cells(tmp_path: Path, client: Client) -> None:
    spec = atlas.Spec("gear-mesh", {"zeta": [0.05, 0.06]}, attractors={"starts": 32})
    atlas.run(spec, tmp_path / "gears.zarr", client=client)
    measure_attractors(tmp_path / "gears.zarr", shocks=True, client=client)
    ds = atlas.open(tmp_path / "gears.zarr").sel(zeta=0.05)
    found = atlas.stability({"zeta": 0.05}, system="gear-mesh", shocks=True)["coexisting"]
    assert ds["fatal_shock"].values[:2] == pytest.approx([row["fatal_shock"] for row in found], rel=1e-9)
    assert ds["shock_reaches"].values[:2].tolist() == [row["shock_reaches"] for row in found]


def test_a_store_is_read_without_a_warning_while_other_measures_are_under_way(measured: Path, tmp_path: Path) -> None:
    """Warnings are errors: Zarr warns of what is no array among those of a group."""
    handle = open_store(copied(measured, tmp_path))
    finished_parts(handle, group_of(LINEAR), "another")
    assert "reactivity" in atlas.open(handle.path)
    assert "reactivity" in xr.open_zarr(handle.path, group=STABILITY, consolidated=False)
