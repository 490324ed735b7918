"""A small reference picture of each kind, of atlases made by hand; ``python -m tests.reference`` makes them anew."""

from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

from matplotlib.figure import Figure

from atlas import render
from atlas.render.kinds import KIND_TABLE
from atlas.render.layout import STANDARD
from atlas.render.maps import draw
from atlas.render.request import PictureRequest
from tests.pictures import basin, branches, curves, keeping, labelled, line, orbit, plane

FOLDER = Path(__file__).parent / "reference"
DPI = 50

LINES = ("grazing", "boundaries")
"""The overlays that need no store."""


NUMBERS = ("error", "periods_used", "stuck_fraction", "share", "return_time", "reactivity", "fatal_shock")
"""Variables that have colours of their own."""


def motions() -> Figure:
    with keeping(curves()):
        drawn: Figure = render.figure(plane(), "impacts", overlay="curves")
    return drawn


def basins() -> Figure:
    ds, table = basin()
    with patch("atlas.query.basins.table", return_value=table):
        return draw(KIND_TABLE["basins"], ds, PictureRequest(STANDARD))


def labels() -> Figure:
    ds, table = labelled()
    with patch("atlas.render.class_maps.branches", return_value=table):
        return draw(KIND_TABLE["labels"], ds, PictureRequest(STANDARD))


PICTURES: dict[str, Callable[[], Figure]] = {
    **{
        kind: (lambda kind=kind: render.figure(plane(), kind))  # type: ignore[misc]
        for kind in render.MAPS
    },
    "exponent": lambda: render.figure(plane(), "exponent", overlay=LINES),
    **{
        name: (lambda name=name: render.figure(plane(), variable=name))  # type: ignore[misc]
        for name in NUMBERS
    },
    "impacts": motions,
    "sweep": lambda: render.figure(line()),
    "spectrum": lambda: render.figure(line(), "spectrum"),
    "hysteresis": lambda: render.figure(line("forward", 5), against=line("backward", 3)),
    "coexistence": lambda: render.figure(branches()),
    "basins": basins,
    "labels": labels,
    "portrait": lambda: render.figure(orbit()),
}


def write(figure: Figure, path: Path) -> Path:
    """The figure as a small PNG without metadata."""
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return path


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, picture in PICTURES.items():
        write(picture(), FOLDER / f"{name}.png")
