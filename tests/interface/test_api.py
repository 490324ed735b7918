"""Claims about ``import atlas``: what it offers, and that it loads nothing before it is used."""

import inspect
import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
import xarray as xr
from distributed import Client

import atlas
from atlas.service.progress import Progress
from tests.paths import ROOT
from tests.synthetic import complete

PUBLIC = ["RunOptions", "Settings", "Spec", "__version__", "errors", "extend", "open", "pack", "point", "retry"]
PUBLIC += ["System", "attractors", "measure_attractors", "plan", "saddles", "stability", "status", "trace"]
PUBLIC += ["CurveSettings", "branch", "find_curves", "label_attractors", "portrait", "run", "solve_tile", "verify"]
PUBLIC += ["time_history"]


def in_a_new_process(code: str) -> object:
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(shown.stdout)


def test_dir_shows_what_is_public_and_nothing_else() -> None:
    import atlas.query.queries

    assert atlas.query.queries  # a module that is loaded is no public name for that
    assert dir(atlas) == sorted(PUBLIC)


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(atlas, name)


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'atlas' has no attribute 'rum'"):
        atlas.rum  # type: ignore[attr-defined]  # noqa: B018


def test_importing_atlas_loads_no_library_and_no_module_but_the_one_that_waits_for_xarray() -> None:
    code = "import json, sys, atlas\nprint(json.dumps([n for n in sys.modules if n.split('.')[0] in %r]))"
    libraries = ("atlas", "workers", "numpy", "dask", "zarr", "xarray", "matplotlib", "numba", "click", "rich")
    assert in_a_new_process(code % (libraries,)) == ["atlas.accessing", "atlas"]


def test_a_spec_is_read_without_dask_zarr_xarray_numba_or_matplotlib() -> None:
    code = (
        "import json, sys, atlas\natlas.Spec.from_toml('tiny')\nprint(json.dumps([n for n in %r if n in sys.modules]))"
    )
    assert in_a_new_process(code % (("dask", "distributed", "zarr", "xarray", "numba", "matplotlib"),)) == []


def test_the_errors_are_there_before_anything_else_is_used() -> None:
    assert in_a_new_process("import json, atlas\nprint(json.dumps(issubclass(atlas.errors.InputError, ValueError)))")


def test_a_point_is_solved_with_the_defaults_of_the_system() -> None:
    found = atlas.point({"omega": 4.0, "b": 0.5}, settings=atlas.Settings(max_periods=500))
    assert (found["system"], found["regime"], found["parameters"]["R"]) == ("two-mass", "no_impact", 0.8)


def test_a_plan_without_a_probe_has_cells_and_tiles_and_no_time() -> None:
    found = atlas.plan(atlas.Spec.from_toml("tiny"), workers=2, probe=False)
    assert (found.tiling.cells, found.probe) == (48, None)


def test_a_plan_with_a_probe_foretells_a_time() -> None:
    found = atlas.plan(atlas.Spec.from_toml("tiny"))
    assert found.as_dict()["seconds"] > 0


def test_fields_of_the_options_are_keywords_of_a_run_and_its_status_is_that_of_the_store(
    tmp_path: Path, client: Client
) -> None:
    seen: list[Progress] = []
    atlas.run(atlas.Spec.from_toml("tiny"), tmp_path / "a.zarr", client, on_progress=seen.append)
    found = atlas.status(tmp_path / "a.zarr")
    assert (found.fraction, found.cells_done) == (1.0, 48)
    assert seen


def test_a_keyword_that_is_no_option_is_a_type_error(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="wokers"):
        atlas.run(atlas.Spec.from_toml("tiny"), tmp_path / "a.zarr", wokers=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("chunks", [{}, "auto", {"omega": 16}])
def test_an_atlas_opened_in_chunks_has_dask_arrays_of_the_same_values(
    tmp_path: Path, chunks: dict[str, int] | str
) -> None:
    handle = complete(tmp_path / "a.zarr")
    ds, lazy = atlas.open(handle.path), atlas.open(handle.path, chunks)
    assert lazy.largest.chunks is not None and ds.largest.chunks is None
    xr.testing.assert_identical(lazy.compute(), ds.compute())
    assert lazy.atlas.fractions().to_dict() == ds.atlas.fractions().to_dict()


def test_every_option_of_a_run_is_a_keyword_of_each_call_that_computes() -> None:
    options = {field.name for field in fields(atlas.RunOptions)}
    calls = (atlas.run, atlas.extend, atlas.retry, atlas.find_curves, atlas.label_attractors, atlas.measure_attractors)
    assert all(options <= inspect.signature(call).parameters.keys() for call in calls)
