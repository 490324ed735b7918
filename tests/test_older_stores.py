"""Stores that solver version 4 wrote (see data/README.md): read, drawn, verified and resumed as they are."""

import csv
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner, Result
from distributed import Client

import atlas
from atlas.check.reproduce import beyond_error
from atlas.check.verify import verify
from atlas.cli.main import main as cli
from atlas.errors import InputError
from atlas.store.machine import this_machine
from atlas.store.store import done_tiles, machines, read_header
from atlas.task.retry import checked_retry
from tests.synthetic import set_attribute
from workers import SOLVER_VERSION

DATA = Path(__file__).parent / "data"
MORE = 2000
"""The budget that undetermined cells of the sweep were given."""


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("older")
    with zipfile.ZipFile(DATA / "stores-solver-4.zip") as packed:
        packed.extractall(folder)
    return folder


@pytest.fixture(params=["plane", "sweep"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def older(originals: Path, name: str, tmp_path: Path) -> Path:
    """A copy of one of the stores."""
    return Path(shutil.copytree(originals / f"{name}.zarr", tmp_path / f"{name}.zarr"))


def call(*args: object) -> Result:
    return CliRunner().invoke(cli, [str(arg) for arg in args])


def spec_of(name: str) -> atlas.Spec:
    return atlas.Spec.from_toml(DATA / f"{name}.toml")


def solve(name: str, store: Path, client: Client) -> None:
    """Compute what the store is to hold, as it was computed once: undetermined cells of the sweep a second time."""
    spec = spec_of(name)
    atlas.run(spec, store, client=client)
    if name == "sweep":
        atlas.run(spec, store, client, atlas.RunOptions(retry=checked_retry(spec, "undetermined", MORE)))


def cells(ds: xr.Dataset, names: list[str]) -> Iterator[dict[str, np.ndarray]]:
    arrays = {name: ds[name].values for name in names}
    for cell in np.ndindex(ds.regime.shape):
        yield {name: values[cell] for name, values in arrays.items()}


def assert_same_numbers(found: Path, original: Path) -> None:
    """To the bit on the kind of machine that wrote the original, elsewhere within the errors."""
    old, new = atlas.open(original).load(), atlas.open(found).load()
    names = [str(name) for name in old.data_vars]
    assert set(names) <= set(new.data_vars)
    if {machine.name for machine in machines(read_header(original))} == {this_machine().name}:
        assert [name for name in names if old[name].values.tobytes() != new[name].values.tobytes()] == []
    else:
        pairs = zip(cells(old, names), cells(new, names), strict=True)
        assert [message for one, other in pairs if (message := beyond_error(one, other))] == []


def test_plain_xarray_opens_it_without_a_warning(older: Path) -> None:
    ds = xr.open_zarr(older)  # warnings are errors here
    assert not (ds.regime.values == -1).any()
    assert "reason" not in ds


def test_it_opens_as_an_atlas(older: Path, name: str) -> None:
    ds = atlas.open(older)
    xr.testing.assert_identical(ds.load(), xr.open_zarr(older).load())
    assert ds.regime.dims == spec_of(name).dims


def test_its_spec_and_digest_are_those_of_today(older: Path, name: str) -> None:
    header = read_header(older)
    assert header.spec.digest == header.digest == spec_of(name).digest


def test_it_answers_queries(older: Path) -> None:
    ds = atlas.open(older)
    codes = ds.regime.values
    meanings = dict(zip(ds.regime.attrs["flag_values"], ds.regime.attrs["flag_meanings"].split(), strict=True))
    areas = ds.atlas.fractions()
    assert set(areas) == {meanings[code] for code in np.unique(codes).tolist()}
    assert sum(areas.values()) == pytest.approx(1.0)
    assert ds.atlas.reasons() == {}
    assert call("query", older, "--json").exit_code == 0
    assert call("status", older).exit_code == 0


def test_pictures_can_be_drawn_of_it(older: Path) -> None:
    drawn = older.parent / "picture.png"
    assert call("render", older, "-o", drawn).exit_code == 0
    assert drawn.stat().st_size > 0


def test_it_can_be_exported(older: Path) -> None:
    ds = atlas.open(older)
    assert call("query", older, "-o", older.parent / "cells.csv").exit_code == 0
    with (older.parent / "cells.csv").open() as file:
        largest = [float(row["largest"]) for row in csv.DictReader(file)]
    np.testing.assert_array_equal(largest, ds.largest.values.ravel())
    assert call("query", older, "-o", older.parent / "cells.nc").exit_code == 0
    with xr.open_dataset(older.parent / "cells.nc", engine="scipy") as written:
        assert set(written.data_vars) == set(ds.data_vars)


def test_it_is_verified_as_sound_without_solving_cells_again(older: Path) -> None:
    report = verify(older)
    assert report.fine
    assert (report.cells_checked, report.cells_solved, report.digests) == (140, 0, False)
    assert report.comparison == f"the store is of solver version 4, this program's is {SOLVER_VERSION}"


def test_a_resume_is_refused_with_both_versions(older: Path, name: str, client: Client) -> None:
    with pytest.raises(InputError, match=f"made by solver version 4, this is version {SOLVER_VERSION}"):
        atlas.run(spec_of(name), older, client=client)


def test_half_done_and_of_this_solver_version_it_is_completed_to_the_same_numbers(
    older: Path, originals: Path, name: str, client: Client
) -> None:
    set_attribute(older, "solver_version", SOLVER_VERSION)
    header = read_header(older)
    lost = sorted(done_tiles(header))[1::2]
    for variable in (*header.variables, *(["budget"] if (older / "budget").exists() else [])):
        array = older / getattr(variable, "name", str(variable))
        for index in lost:
            chunk = array.joinpath("c", *map(str, index))
            shutil.rmtree(chunk) if chunk.is_dir() else chunk.unlink(missing_ok=True)
    assert len(done_tiles(header)) == header.tiling.count - len(lost)
    solve(name, older, client)
    assert_same_numbers(older, originals / f"{name}.zarr")
    assert not (older / "reason").exists()
    assert verify(older).fine


def test_its_spec_solved_anew_gives_the_same_numbers(
    originals: Path, name: str, tmp_path: Path, client: Client
) -> None:
    solve(name, tmp_path / "new.zarr", client)
    assert_same_numbers(tmp_path / "new.zarr", originals / f"{name}.zarr")
