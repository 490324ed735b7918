"""What a picture of each kind shows, as data, of atlases made by hand; ``python -m tests.reference`` lists it anew."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from atlas import render
from atlas.render.kinds import KIND_TABLE
from atlas.render.layout import STANDARD
from atlas.render.maps import draw
from atlas.render.request import PictureRequest
from tests.pictures import basin, branches, curves, keeping, labelled, line, orbit, plane

FILE = Path(__file__).parent / "reference" / "pictures.json"

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


def described(figure: Figure) -> dict[str, Any]:
    """What a picture shows: its texts, its plots, its legend, and the colours of the cells of a map in bytes."""
    entries = [
        entry for legend in figure.legends for entry in zip(legend.legend_handles, legend.get_texts(), strict=True)
    ]
    images = [image for ax in figure.axes for image in ax.images]
    return {
        "title": figure.get_suptitle(),
        "plots": [_plot(ax) for ax in figure.axes],
        "legend_titles": [legend.get_title().get_text() for legend in figure.legends],
        "legend": [[text.get_text(), *_look(handle)] for handle, text in entries],
        "cells": [np.asarray(image.get_array()).ravel().tolist() for image in images],
    }


def _plot(ax: Axes) -> dict[str, Any]:
    axes = {
        name: [axis.get_label_text(), axis.get_scale(), *(float(f"{end:.5g}") for end in axis.get_view_interval())]
        for name, axis in (("x", ax.xaxis), ("y", ax.yaxis))
    }
    shown = axes | {"title": ax.get_title("left"), "texts": [text.get_text() for text in ax.texts]}
    if ax.get_label() == "<colorbar>":  # its artists are matplotlib's own
        return shown
    return shown | {
        "lines": [[*_look(line), len(np.atleast_1d(line.get_xdata()))] for line in ax.lines],
        "patches": [[to_hex(patch.get_edgecolor()), patch.get_hatch()] for patch in ax.patches],
        "collections": [
            [drawn.get_gid(), sorted({*map(to_hex, drawn.get_edgecolor())}), len(drawn.get_paths())]
            for drawn in ax.collections
        ],
    }


def _look(artist: Any) -> list[Any]:
    """Colours, and marker and dashes of a line or the hatch of a box."""
    if hasattr(artist, "get_marker"):
        return [to_hex(artist.get_color()), artist.get_marker(), artist.get_linestyle(), artist.get_linewidth()]
    return [to_hex(artist.get_facecolor()), to_hex(artist.get_edgecolor()), artist.get_hatch()]


if __name__ == "__main__":
    shown = {name: described(picture()) for name, picture in PICTURES.items()}
    FILE.parent.mkdir(exist_ok=True)
    rows = ",\n".join(f"{json.dumps(name)}: {json.dumps(shows, ensure_ascii=False)}" for name, shows in shown.items())
    FILE.write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")
