"""Claims about what a picture's file says of its numbers."""

import json
from pathlib import Path

import pytest
from PIL import Image

from atlas import render
from atlas.render.provenance import provenance_of
from tests.pictures import every_regime, line, orbit
from workers import SOLVER_VERSION


def test_a_picture_of_an_atlas_names_the_solver_that_computed_it_and_its_spec(tmp_path: Path) -> None:
    ds = every_regime().assign_attrs(solver_version=7)
    with Image.open(render.render(ds, tmp_path / "map.png")) as image:
        assert image.info["Solver"] == "7"
        assert json.loads(image.info["Spec"]) == json.loads(ds.attrs["spec"])
        assert image.info["Source"] == "computed by numpy 2; solver version 7"


def test_a_portrait_names_the_present_solver_and_all_that_decides_its_cell(tmp_path: Path) -> None:
    with Image.open(render.render(orbit(), tmp_path / "cell.png")) as image:
        assert image.info["Solver"] == str(SOLVER_VERSION)
        assert json.loads(image.info["Spec"])["parameters"] == dict(orbit().parameters)


@pytest.mark.parametrize(("other", "solver"), [(7, "7"), (8, "7 8")])
def test_a_picture_of_two_atlases_names_both_digests_and_each_solver_once(other: int, solver: str) -> None:
    up, down = line("forward").assign_attrs(solver_version=7), line("backward").assign_attrs(solver_version=other)
    found = provenance_of(up, down)
    assert (found.digest, found.solver) == ("d1ge57-forward d1ge57-backward", solver)


@pytest.mark.parametrize("suffix", ["svg", "pdf"])
def test_vector_files_name_the_solver_and_the_spec_too(suffix: str, tmp_path: Path) -> None:
    path = render.render(every_regime().assign_attrs(solver_version=7), tmp_path / f"map.{suffix}")
    assert b"solver version 7" in path.read_bytes()
    assert b"two-mass" in path.read_bytes().split(b"solver version 7")[1 if suffix == "pdf" else 0]
