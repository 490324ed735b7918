"""What a picture of each kind shows, against what it showed: texts, axes, legend, artists, and colours of cells."""

import json

import numpy as np
import pytest

from atlas import render
from tests.pictures import plane
from tests.reference import FILE, NUMBERS, PICTURES, described
from workers.results import CHAOTIC

SHOWN = json.loads(FILE.read_text(encoding="utf-8"))


def differences(name: str, found: dict[str, object]) -> list[str]:
    """The parts of a picture that differ; colours of cells may differ by rounding."""
    expected = SHOWN[name]
    cells = [np.array(shows["cells"], int) for shows in (expected, found)]
    alike = cells[0].shape == cells[1].shape and np.all(np.abs(cells[0] - cells[1]) <= 2)
    found = json.loads(json.dumps(found)) | {"cells": expected["cells"] if alike else []}
    return [part for part in expected if found[part] != expected[part]]


def test_every_kind_of_picture_is_described() -> None:
    assert set(SHOWN) == set(PICTURES) == {*render.KINDS, *NUMBERS, "portrait"}


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_shows_what_it_did(name: str) -> None:
    assert differences(name, described(PICTURES[name]())) == []


def test_a_changed_cell_a_changed_label_and_a_lost_line_are_differences() -> None:
    """A comparison that could not fail would prove nothing."""
    ds = plane()
    ds["regime"].values[2, 4] = CHAOTIC
    assert differences("period", described(render.figure(ds, "period"))) == ["cells"]
    figure = PICTURES["period"]()
    figure.axes[0].set_xlabel("forcing period")
    assert differences("period", described(figure)) == ["plots"]
    without = render.figure(plane(), "exponent", overlay="grazing")
    assert differences("exponent", described(without)) == ["plots", "legend"]
