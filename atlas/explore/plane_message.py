"""The message from which the browser draws the visible cells: maps, overlays and labels, as bytes."""

import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.explore.compose import VisibleCells
from atlas.explore.front.numbers import PackedArray, add_codes, pack
from atlas.explore.lattice import Lattice
from atlas.explore.subject import Subject
from atlas.explore.view_state import Range, ViewState
from atlas.explore.viewport import CellRange
from atlas.query.extremes import numbers_of_cells
from atlas.query.plane import Plane
from atlas.render.coded_lines import lines_over, names_on
from atlas.render.coded_maps import CodedMap, coded_map, coded_maps
from atlas.render.kinds import KIND_TABLE, LOGARITHM, NUMBER, OverlayError
from atlas.render.layers import MapView
from atlas.render.layout import STANDARD
from atlas.render.request import PictureRequest
from workers.results import REGIME

if TYPE_CHECKING:
    import xarray as xr

BITS = 14
"""Number of mantissa bits of the numbers that are sent to the page: four digits."""


def maps_of(visible: VisibleCells, view: ViewState, others: bool) -> list[CodedMap]:
    """Return the chosen map, as a code per cell with its legend, and with ``others`` all further maps of the dataset.

    Raise InputError if the chosen map cannot be drawn.
    """
    first = coded_map(visible.ds, visible.ds, view.map)
    rest = _others(visible.ds) if others else ()
    return [first, *(further_map for further_map in rest if further_map.name != view.map)]


def _others(ds: "xr.Dataset") -> Iterator[CodedMap]:
    yield from coded_maps(ds, ds)
    for name in numbers_of_cells(ds):
        with suppress(InputError):  # numbers below zero have no logarithm
            yield coded_map(ds, ds, f"{NUMBER}{name}{LOGARITHM}")


def ends_of(plane_map: CodedMap) -> Range | None:
    """Return the colour limits of a map; None if the map has no colour scale."""
    bar = plane_map.layers.bar
    return None if bar is None else bar.ends


def message(
    visible: VisibleCells,
    subject: Subject,
    view: ViewState,
    maps: list[CodedMap],
    scales: Mapping[str, Range],
    size: tuple[int, int],
) -> tuple[NDArray[np.uint8], str]:
    """Return the message, as bytes, from which a page draws maps with overlays, and why some overlays are missing.

    visible   the visible cells
    subject   the subject that is explored
    view      the view state of the page
    maps      the maps, the chosen map first
    scales    colour limits of maps, by name
    size      width and height of the plane, in pixels

    The message begins with the length of its first part, in four bytes. The first part is deflated JSON, and the packed
    arrays that it names follow.
    """
    plane, (lines, arrays, lacking) = _plane(visible, subject), _lines(visible, subject, view, size)
    packed = {name: pack(values) for name, values in arrays.items()} | {"stages": pack(visible.stages)}
    described, names = [], dict[str, Any]()
    for plane_map in maps:
        codes = add_codes(packed, plane_map)
        for name in plane_map.needs:
            if name not in packed:
                packed[name] = pack(visible.ds[name].values, BITS)
        bar = plane_map.described["bar"]
        colorbar = bar and bar | {"fit": bar["ends"], "ends": list(scales.get(plane_map.name) or bar["ends"])}
        described.append(plane_map.described | {"codes": codes, "bar": colorbar})
        names[plane_map.name] = names_on(plane_map.layers, plane, size)
    packed.setdefault(REGIME.name, pack(visible.ds[REGIME.name].values))
    about = {
        "of": visible.view_id,
        "axes": [
            _axis(lattice, stretch) for lattice, stretch in zip((subject.x, subject.y), visible.sight, strict=True)
        ],
        "maps": described,
        "lines": lines,
        "names": names,
    }
    return _joined(about, packed), "; ".join(lacking)


def _plane(visible: VisibleCells, subject: Subject) -> Plane:
    """Return the plane of the visible cells, with an axis logarithmic exactly if it is logarithmic in the spec."""
    plane = Plane.from_dataset(visible.ds, ())
    return replace(plane, x=replace(plane.x, log=subject.x.log), y=replace(plane.y, log=subject.y.log))


def _lines(
    visible: VisibleCells, subject: Subject, view_state: ViewState, size: tuple[int, int]
) -> tuple[dict[str, Any], dict[str, NDArray[np.uint8]], list[str]]:
    """Return the chosen overlays by name, the arrays that they need, and the reasons why some overlays are missing."""
    why = view_state.without_curves(subject)
    drawn, arrays, lacking = dict[str, Any](), dict[str, NDArray[np.uint8]](), [why] if why else []
    view = MapView(KIND_TABLE["period"], visible.ds, _plane(visible, subject), PictureRequest(STANDARD))
    for name in view_state.overlays:
        drawn[name] = {"looks": {}, "lines": [], "marks": {}, "corners": [], "ends": []}
        if name not in view_state.visible_overlays(subject):
            continue
        try:
            lines = lines_over(view, name, size)
        except OverlayError as error:
            lacking.append(str(error))
            continue
        drawn[name] = lines.described
        if lines.regions is not None:
            arrays["regions"] = lines.regions
    return drawn, arrays, lacking


def _axis(lattice: Lattice, cells: CellRange) -> dict[str, Any]:
    """Return the edges, number and zoom level of the visible cells along an axis, for the browser.

    If the cells are equally wide on the axis's scale, only the outer two edges are given.
    """
    halves = np.arange(2 * cells.first - 1, 2 * (cells.first + cells.count), 2, dtype=np.int64)
    edges = lattice.values(cells.level + 1, halves)
    drawn = np.log(edges) if lattice.log else edges
    even = np.allclose(np.diff(drawn), (drawn[-1] - drawn[0]) / cells.count, rtol=1e-3)
    sent_edges = edges[[0, -1]] if even else edges
    return {"edges": sent_edges.tolist(), "count": cells.count, "first": cells.first, "level": cells.level}


def _joined(about: Mapping[str, Any], packed: Mapping[str, PackedArray]) -> NDArray[np.uint8]:
    arrays, at = dict[str, Any](), 0
    for name, array in packed.items():
        arrays[name] = {"type": array.type, "digits": array.digits, "at": at, "size": len(array.data)}
        at += len(array.data)
    text = json.dumps({**about, "arrays": arrays}, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    head = zlib.compress(text.encode(), 6)
    parts = [len(head).to_bytes(4, "little"), head, *(array.data for array in packed.values())]
    return np.frombuffer(b"".join(parts), np.uint8)
