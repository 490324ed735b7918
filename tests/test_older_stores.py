"""Stores that solver version 4 wrote (see data/README.md): read, drawn, verified and resumed as they are."""

import csv
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner, Result
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main as cli
from atlas.errors import InputError
from atlas.store.store import done_tiles, read_header
from atlas.task.retry import checked_retry
from tests.synthetic import set_attribute
from workers import SOLVER_VERSION
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC

DATA = Path(__file__).parent / "data"
MORE = 2000
"""The budget that undetermined cells of the sweep were given."""
ERRORS = 5.0
"""So many errors of both solutions may lie between the exponents that two solver versions give."""
EQUAL, HITS = ["period", "symmetric", "sticks"], ["impacts_upper", "impacts_lower"]
NUMBERS = ["largest", "spectrum", "impacts_per_period", "stuck_fraction", "min_impact_speed"]
SETTLED = {"plane": {(4, 2): (CHAOTIC, PERIODIC)}, "sweep": {}}
"""The cells that solver version 4 took for chaotic before they settled."""


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


def differences(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> list[str]:
    """In which results two solver versions differ by more than they may in one cell.

    Its class and what counts impacts and periods are the same, the largest exponent within the errors, and the other
    numbers of an orbit to its digits. It may be the mirror image of the other's orbit, and its state another section.
    """
    if new["regime"] != old["regime"]:
        return ["regime"]
    if new["regime"] not in (NO_IMPACT, PERIODIC):
        away, room = abs(new["largest"] - old["largest"]), ERRORS * (new["error"] + old["error"])
        return ["largest"] if new["regime"] <= CHAOTIC and not away <= room else []
    found = [name for name in EQUAL if new[name] != old[name]]
    if {int(new[name]) for name in HITS} != {int(old[name]) for name in HITS}:
        found += HITS
    numbers = [name for name in NUMBERS if name in old]
    return found + [n for n in numbers if not np.allclose(new[n], old[n], rtol=1e-9, atol=1e-9, equal_nan=True)]


def assert_like(found: Path, original: Path, name: str) -> None:
    """The numbers of today's solver are those of the older one, but for the cells that are listed."""
    old, new = atlas.open(original).load(), atlas.open(found).load()
    names = [str(name) for name in old.data_vars]
    assert set(names) <= set(new.data_vars)
    for cell in np.ndindex(old.regime.shape):
        one, other = ({name: ds[name].values[cell] for name in names} for ds in (old, new))
        listed = SETTLED[name].get(cell) == (one["regime"], other["regime"])
        assert listed or differences(one, other) == [], f"cell {cell}"


def test_plain_xarray_opens_it_without_a_warning(older: Path) -> None:
    ds = xr.open_zarr(older)  # warnings are errors here
    assert not (ds.regime.values == -1).any()
    assert not {"reason", "survived"} & set(ds.data_vars)


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
    assert call("plot", older, "-o", drawn).exit_code == 0
    assert drawn.stat().st_size > 0


def test_it_can_be_exported(older: Path) -> None:
    ds = atlas.open(older)
    assert call("export", older, "-o", older.parent / "cells.csv").exit_code == 0
    with (older.parent / "cells.csv").open() as file:
        largest = [float(row["largest"]) for row in csv.DictReader(file)]
    np.testing.assert_array_equal(largest, ds.largest.values.ravel())
    assert call("export", older, "-o", older.parent / "cells.nc").exit_code == 0
    with xr.open_dataset(older.parent / "cells.nc", engine="scipy") as written:
        assert set(written.data_vars) == set(ds.data_vars)


def test_it_is_verified_as_sound_without_solving_cells_again(older: Path) -> None:
    report = verify(older)
    assert report.fine
    assert (report.cells_checked, report.cells_solved, report.digests) == (140, 0, False)
    assert report.comparison == f"the store has solver version 4, this program {SOLVER_VERSION}"


def test_a_resume_is_refused_with_both_versions(older: Path, name: str, client: Client) -> None:
    with pytest.raises(InputError, match=f"made by solver version 4, this is version {SOLVER_VERSION}"):
        atlas.run(spec_of(name), older, client=client)


def test_half_done_and_of_this_solver_version_it_is_completed_to_like_numbers(
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
    assert_like(older, originals / f"{name}.zarr", name)
    assert not (older / "reason").exists()
    assert verify(older, sample=0).fine  # half of its cells are another solver's


def test_its_spec_solved_anew_gives_like_numbers(originals: Path, name: str, tmp_path: Path, client: Client) -> None:
    solve(name, tmp_path / "new.zarr", client)
    assert_like(tmp_path / "new.zarr", originals / f"{name}.zarr", name)
