"""Maps as codes of cells and plain JSON, for a web page that draws them itself.

A code stands for a colour, or for the colorbar by which the page colours the cell's number.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.formatting import mathtext_to_unicode
from atlas.query.extremes import numbers_of_cells
from atlas.query.plane import Plane
from atlas.render import looks, text
from atlas.render.kinds import BASINS, KIND_TABLE, LABELS, LOGARITHM, MAPS, NUMBER, SCALAR
from atlas.render.layers import MARKED, CellStyle, HatchLayer, MapLayers, MapView, ScalarLayer
from atlas.render.layout import STANDARD
from atlas.render.looks import LegendEntry
from atlas.render.painters import layers_of
from atlas.render.request import PictureRequest
from workers.results import PENDING


@dataclass(frozen=True)
class CodedMap:
    """A map of cells, for a web page.

    name       name of its kind, or of its variable
    codes      (y, x) index of each cell's entry among the map's colours and patterns
    needs      variables that it reads; the first is the one on the colorbar
    described  colours, patterns, legend and colorbar, as plain JSON
    layers     layers of the map, from which codes and description were made
    """

    name: str
    codes: NDArray[np.uint8] | NDArray[np.uint16]
    needs: tuple[str, ...]
    described: dict[str, Any]
    layers: MapLayers


def coded_maps(ds: xr.Dataset, seen: xr.Dataset) -> Iterator[CodedMap]:
    """Yield all maps that the variables of the cells ``seen`` allow: each kind of map, then a map of each number.

    ``ds`` is the dataset of the whole atlas, with its attributes.
    """
    kinds = [name for name in (BASINS, *MAPS, LABELS) if seen.data_vars.keys() >= {*KIND_TABLE[name].variables}]
    if {BASINS, LABELS} <= {*kinds}:
        kinds.remove(LABELS)  # these labels are of initial states
    for name in (*kinds, *(f"{NUMBER}{variable}" for variable in numbers_of_cells(seen))):
        with suppress(InputError):  # this machine has no such map
            yield coded_map(ds, seen, name)


def coded_map(ds: xr.Dataset, seen: xr.Dataset, name: str) -> CodedMap:
    """Return the map ``name`` of the cells ``seen``, which are visible cells of the atlas ``ds``.

    Raise InputError if the cells lack the variables of the map.
    """
    variable = name.removeprefix(NUMBER).removesuffix(LOGARITHM) if name.startswith(NUMBER) else None
    kind = KIND_TABLE[SCALAR if variable else name]
    needs = (variable,) if variable else kind.variables
    kind.require(seen, needs)
    request = PictureRequest(STANDARD, kind.name, variable=variable, log=name.endswith(LOGARITHM))
    view = MapView(kind, ds, Plane.from_dataset(seen, needs), request)
    return _coded(name, text_of(text.variable_label(ds, variable)) if variable else kind.description, view, needs)


def text_of(label: str) -> str:
    """Return a label of a picture as plain text, with its mathtext as Unicode."""
    parts = label.split("$")
    unicode_text = "".join(
        mathtext_to_unicode(part).replace("-", "\N{MINUS SIGN}") if k % 2 else part for k, part in enumerate(parts)
    )
    return " ".join(unicode_text.split())


def _coded(name: str, meaning: str, view: MapView, needs: tuple[str, ...]) -> CodedMap:
    layers = layers_of(view)
    textures, patterns = _textures(layers)
    outlined = np.zeros(layers.codes.shape, np.int64)
    for texture in layers.textures:
        outlined |= 0 if texture.outlined is None else texture.outlined
    base = 2 * (len(patterns) + 1)
    keys, codes = np.unique(layers.codes * base + 2 * textures + outlined, return_inverse=True)
    entries, regimes = [], text.regime(view.ds)
    for key in keys.tolist():
        rest, look = key % base, layers.styles[key // base]
        entry = _shown(layers, look) | (patterns[rest // 2 - 1] if rest > 1 else {})
        if rest % 2:
            entry["outlined"] = True
        if look.regime in MARKED:
            entry["enlarged"] = text_of(regimes.meaning(look.regime).text)  # the same words as in the legend
        entries.append(entry)
    described = {
        "name": name,
        "needs": list(needs),
        "meaning": meaning,
        "numbers": view.kind.name == SCALAR,
        "entries": entries,
        "bar": layers.bar and _bar(layers.bar, view.plane[needs[0]], needs[0]),
        "shade": _shade(layers, needs[0]),
        "title": text_of(layers.side_legend_title or ""),
        "legend": [_entry(entry) for entry in layers.entries],
    }
    kind = np.uint8 if len(entries) <= 256 else np.uint16
    return CodedMap(name, codes.reshape(view.plane.regime.shape).astype(kind), needs, described, layers)


def _shown(layers: MapLayers, style: CellStyle) -> dict[str, Any]:
    """Return how a page draws cells of a style: in a colour, or by the colorbar according to the cell's number.

    Shading, if the map has it, darkens all colours but those of regimes.
    """
    if style.by_number and layers.scalar is not None:
        if layers.scalar.bar:
            return {"byNumber": True}
        return {"color": layers.scalar.scale.hex(-np.inf)}  # the colour below the lower limit
    return {"color": style.color} | ({"shaded": True} if layers.shade is not None and style.regime is None else {})


def _shade(layers: MapLayers, variable: str) -> dict[str, Any] | None:
    """Return, as plain JSON, the variable that darkens a map's colours, and its limits; None without shading."""
    if layers.shade is None:
        return None
    return {
        "variable": variable,
        "low": layers.shade.low,
        "high": layers.shade.high,
        "dark": layers.shade.min_brightness,
    }


def _textures(layers: MapLayers) -> tuple[NDArray[np.int64], list[dict[str, Any]]]:
    """Return the hatch of each cell (y, x) as a number, and the list of hatches.

    0 is no hatch; k is entry k - 1 of the list, which gives pattern and colour.
    """
    numbers, patterns = np.zeros(layers.codes.shape, np.int64), []
    pending = HatchLayer(layers.as_regime(PENDING), looks.HATCH[PENDING], looks.HATCH_INK[PENDING])
    for cells, hatch, ink, *_ in [pending, *layers.textures]:
        if cells.any():
            patterns.append({"hatch": hatch[0], "ink": ink})
            numbers[cells] = len(patterns)
    return numbers, patterns


def _bar(bar: ScalarLayer, stored: NDArray[Any], variable: str) -> dict[str, Any]:
    """Return a colorbar as plain JSON.

    bar        numbers of cells with their colormap and norm
    stored     values of the variable as stored, in which an exact zero may have its own position on a logarithmic scale
    variable   name of the variable
    """
    zeros = np.unique(bar.values[(stored == 0) & (bar.values > 0.0)])
    return {
        "variable": variable,
        "label": text_of(bar.label),
        "scale": bar.scale.form,
        "ends": list(bar.ends),
        "colors": bar.scale.above.tobytes().hex(),
        "both": None if bar.scale.both is None else bar.scale.both.tobytes().hex(),
        "zero": float(zeros[0]) if zeros.size else 0.0,  # position of an exact 0 on a log scale
    }


def _entry(entry: LegendEntry) -> dict[str, Any]:
    """Return a legend entry as plain JSON."""
    described = {"label": text_of(entry.label), "color": entry.color}
    if entry.min_brightness < 1.0:
        return described | {"dark": entry.min_brightness}
    return described | ({"hatch": entry.hatch[0], "ink": entry.hatch_color} if entry.hatch else {})
