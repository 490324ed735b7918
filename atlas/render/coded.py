"""Maps as codes of their cells, for a page that draws them itself: painted by the code that draws files.

A code stands for a colour of its own, or for a scale, on which the page places the cell's number.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.markers import MarkerStyle
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.extremes import numbers_of_cells
from atlas.query.plane import Plane
from atlas.query.window import axis_names
from atlas.render import maps, scales, style, words
from atlas.render.kinds import BASINS, LABELS, MAPS, SCALAR, TABLE
from atlas.render.page import STANDARD
from atlas.render.painted import PaintedView, ScaleBar, View
from atlas.render.painters import PAINTERS
from atlas.render.wanted import Wanted
from atlas.text import plain
from workers.results import NO_IMPACT


@dataclass(frozen=True)
class CodedMap:
    """A map of a page.

    name       of its kind, or of its variable
    codes      (y, x) of the entries that give each cell its colour
    needs      the variables that it reads, the one on the scale first
    described  what the page has to know besides, as plain JSON
    """

    name: str
    codes: NDArray[np.uint8] | NDArray[np.uint16]
    needs: tuple[str, ...]
    described: dict[str, Any]


def coded_maps(ds: xr.Dataset, seen: xr.Dataset) -> Iterator[CodedMap]:
    """Every map that the cells ``seen`` of an atlas have: the kinds of pictures, then each variable as numbers."""
    held = [name for name in (BASINS, *MAPS, LABELS) if seen.data_vars.keys() >= {*TABLE[name].variables}]
    for name in held:
        kind = TABLE[name]
        if name in PAINTERS and not (name == LABELS and BASINS in held):  # whose labels are of starts
            view = View(kind, ds, Plane.of(seen, kind.variables), Wanted(STANDARD, name))
            try:
                yield _coded(name, kind.meaning, view, kind.variables)
            except InputError:  # of a machine that has no such map
                continue
    for name in numbers_of_cells(seen):
        view = View(TABLE[SCALAR], ds, Plane.of(seen, [name]), Wanted(STANDARD, SCALAR, variable=name))
        yield _coded(f"number-{name}", text_of(words.variable_label(ds, name)), view, (name,))


def text_of(label: str) -> str:
    """A label of a picture, with its mathtext in Unicode."""
    parts = label.split("$")
    shown = "".join(plain(part).replace("-", "\N{MINUS SIGN}") if k % 2 else part for k, part in enumerate(parts))
    return " ".join(shown.split())


def curves_over(ds: xr.Dataset) -> dict[str, Any]:
    """The curves that the store of an atlas keeps of this plane, with the looks of their kinds; empty without any."""
    from atlas.curves import asking

    try:
        found = asking.curves_of(ds)
    except InputError:
        return {}
    if found.axes != axis_names(ds):
        return {}
    corners = sorted({(each.kind, each.x, each.y) for curve in found for each in curve.stable_corners})
    return {
        "looks": {kind: _line_look(look) for kind, look in style.LOOKS.items() if found.of_kind(kind)},
        "lines": [
            {"kind": curve.kind, "orbit": curve.label, "points": line.ravel().tolist()}
            for curve in found
            for line in curve.stable_lines
        ],
        "marks": {kind: _mark_look(kind) for kind, _, _ in corners},
        "corners": [list(corner) for corner in corners],
        "ends": [[curve.kind, *at.tolist()] for curve in found for at in curve.loose_ends],
    }


def _line_look(look: style.EventLook) -> dict[str, Any]:
    return {"label": look.label, "color": look.color, "dashes": [] if look.dashes == "solid" else [*look.dashes[1]]}


def _mark_look(kind: str) -> dict[str, Any]:
    """Name and outline of a point of codimension two, in units of its size."""
    look = style.corner_look(kind, 1.0)
    marker = MarkerStyle(look["marker"])
    shape = marker.get_path().transformed(marker.get_transform()).to_polygons()
    return {"label": look["label"], "shape": [np.asarray(part).ravel().round(3).tolist() for part in shape]}


def _coded(name: str, meaning: str, view: View, needs: tuple[str, ...]) -> CodedMap:
    painted = PAINTERS[view.kind.name](view)
    sources, looks = _sources(view, painted)
    textures, patterns = _textures(view, painted)
    keys, codes = np.unique(sources * (len(patterns) + 1) + textures, return_inverse=True)
    entries = []
    for key in keys.tolist():
        source, texture = divmod(key, len(patterns) + 1)
        entries.append(looks[source] | (patterns[texture - 1] if texture else {}))
    maps.explain_pending(painted.entries, view.ds)
    described = {
        "name": name,
        "needs": list(needs),
        "meaning": meaning,
        "numbers": view.kind.name == SCALAR,
        "entries": entries,
        "bars": [_bar(bar, view.plane[needs[0]], needs[0]) for bar in painted.bars],
        "title": text_of(painted.beside or ""),
        "legend": [_entry(each) for each in painted.entries],
    }
    kind = np.uint8 if len(entries) <= 256 else np.uint16
    return CodedMap(name, codes.reshape(view.plane.regime.shape).astype(kind), needs, described)


def _sources(view: View, painted: PaintedView) -> tuple[NDArray[np.int64], list[dict[str, Any]]]:
    """Where each cell has its colour from (y, x), and what that is: the number of a scale, or a colour."""
    found = np.full(view.plane.regime.shape, -1, np.int64)
    for number, bar in enumerate(painted.bars):
        on_it = ~np.isnan(bar.values)
        on_it &= (scales.on_scale(bar.values, bar.norm, bar.colormap) == painted.rgba).all(axis=-1)
        found[on_it] = number
    rest = found < 0
    colors, places = np.unique(np.ascontiguousarray(painted.rgba[rest]).view(np.uint32)[:, 0], return_inverse=True)
    found[rest] = len(painted.bars) + places
    # A cell without a result is transparent in pictures, over the white of the plot.
    bytes_of = colors.view(np.uint8).reshape(-1, 4)
    named = ["#ffffff" if not a else to_hex((r / 255, g / 255, b / 255)) for r, g, b, a in bytes_of.tolist()]
    return found, [{"bar": number} for number in range(len(painted.bars))] + [{"color": color} for color in named]


def _textures(view: View, painted: PaintedView) -> tuple[NDArray[np.int64], list[dict[str, Any]]]:
    """The texture of each cell (y, x), 0 for none, else its place in the list, from 1."""
    found, patterns = np.zeros(view.plane.regime.shape, np.int64), []
    for code, pattern in style.HATCH.items():
        if code != NO_IMPACT:  # it has a texture only where its colour does not show it
            plain_color = np.array(style.rgb(style.COLORS[code]), np.uint8)[:3]
            there = (view.plane.regime == code) & (
                (painted.rgba[..., :3] == plain_color).all(axis=-1) | (painted.rgba[..., 3] == 0)
            )
            if there.any():
                patterns.append({"hatch": pattern[0], "ink": style.HATCH_INK.get(code, style.TEXTURE)})
                found[there] = len(patterns)
    for texture in painted.textures:
        if texture.cells.any():
            patterns.append({"hatch": texture.hatch[0], "ink": to_hex(texture.ink)})
            found[texture.cells] = len(patterns)
    return found, patterns


def _bar(bar: ScaleBar, stored: NDArray[Any], variable: str) -> dict[str, Any]:
    colors = np.asarray(bar.colormap(np.arange(bar.colormap.N), bytes=True))[:, :3]
    zeros = np.unique(bar.values[(stored == 0) & (bar.values > 0.0)])
    return {
        "variable": variable,
        "label": text_of(bar.label),
        "title": bar.title,
        "scale": scales.FORMS[type(bar.norm)],
        "ends": [float(bar.norm.vmin or 0.0), float(bar.norm.vmax or 0.0)],
        "colors": colors.tobytes().hex(),
        "zero": float(zeros[0]) if zeros.size else 0.0,  # where a number of exactly 0 stands on a logarithmic scale
    }


def _entry(entry: Any) -> dict[str, Any]:
    """An entry of a legend."""
    described = {"label": text_of(entry.get_label()), "color": to_hex(entry.get_facecolor())}
    if isinstance(entry, style.Gradient):
        return described | {"dark": entry.dark}
    if entry.get_hatch():
        return described | {"hatch": entry.get_hatch()[0], "ink": to_hex(entry.get_edgecolor())}
    return described
