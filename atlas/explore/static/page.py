"""An atlas as one HTML file that opens from disk: its cells, maps and curves, and their provenance."""

import html
import json
import math
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import validate_path
from atlas.errors import InputError
from atlas.explore.front.numbers import PackedArray, add_codes, pack, pack_within
from atlas.explore.front.script import program, shared_css
from atlas.explore.static import about
from atlas.formatting import byte_size
from atlas.query.attractors import has_all_attractors, select_attractor, select_dominant
from atlas.query.export import check_target, replace_on_success
from atlas.query.open import handle_of
from atlas.query.plane import Plane, sort_axes
from atlas.query.read_counter import count_chunk_reads
from atlas.query.resample import read_view
from atlas.query.store_block import find_part
from atlas.query.window import axis_names, check_not_points
from atlas.render.coded_lines import lines_over, names_on
from atlas.render.coded_maps import CodedMap, coded_maps
from atlas.render.drawing import check_units
from atlas.render.kinds import KIND_TABLE, MAP_OVERLAYS, OverlayError
from atlas.render.layers import MapView
from atlas.render.layout import STANDARD
from atlas.render.request import PictureRequest
from atlas.spec.toml_text import spec_toml
from workers.results import ATTRACTOR, ERROR, LARGEST, REGIME

if TYPE_CHECKING:
    import xarray as xr

FORMATS = (".html",)
LIMIT = 20_000_000
"""Default maximum size, in bytes, of a page."""
SIZE = 1000.0, 800.0
"""Width and height, in pixels, of the plane for which labels and lines are placed."""
MAX_CELLS = 1 << 20
"""Maximum number of cells of a page; a larger atlas is shown by an overview."""
COEXISTING = (REGIME.name, "period", "impacts_upper", "impacts_lower", LARGEST.name, "share")
"""Results of attractors after the first of a cell that a page lists beside the attractor that it shows."""
PROGRAM = ("atlas.mjs", "cell.mjs", "page.mjs")
"""JavaScript modules of the static page only, in the order in which they are joined."""
_EACH = 300
"""Maximum number of bytes of HTML around an array of a page."""


def write_page(ds: "xr.Dataset", path: str | Path, *, limit: int = LIMIT, most_cells: int = MAX_CELLS) -> Path:
    """Write the plane of an atlas as one HTML file, and return its path.

    ds           the dataset of an atlas
    path         path of the file, which ends in .html
    limit        maximum size of the file, in bytes
    most_cells   maximum number of cells; beyond it the page has the finest overview that fits

    In an atlas of all attractors each cell shows the attractor with the largest share. Numbers are exact if they fit.
    Otherwise floats lose digits, down to three, those of the largest Lyapunov exponent last. If that is not enough,
    variables are left out. The page reports both. The file is replaced as a whole or not at all, and the same atlas
    gives the same bytes. Raise InputError if the suffix is not .html, the path cannot be written, or the dataset is not
    a plane.
    """
    target = validate_path(path)
    check_target(target, FORMATS)
    text = page_of(ds, limit, most_cells)
    with replace_on_success(target) as unfinished:
        unfinished.write_text(text, encoding="utf-8", newline="\n")
    return target


def page_of(every: "xr.Dataset", limit: int = LIMIT, most_cells: int = MAX_CELLS) -> str:
    """Return the HTML page of an atlas as text; arguments and errors are those of ``write_page``."""
    ds = select_dominant(every)
    _check_plane(ds)
    handle = handle_of(ds)
    seen, block = _cells(ds, most_cells)
    seen, axes = sort_axes(seen)
    order = [variable.name for variable in handle.spec.variables]
    names = sorted(map(str, seen.data_vars), key=lambda name: order.index(name) if name in order else len(order))
    maps, plane = list(coded_maps(ds, seen[names])), Plane.from_dataset(seen, ())
    lines, regions = lines_of(ds, seen)
    described = about.described(ds, handle, (axes[0], axes[1])) | {
        "block": list(block),
        "command": about.command(ds, handle) if max(block) == 1 else "",
        "lines": lines,
        "names": {coded_map.name: names_on(coded_map.layers, plane, SIZE) for coded_map in maps},
        "leftOut": [],
        "variables": {name: about.variable(seen, name) for name in names},
    }
    words = {
        "title": str(ds.attrs.get("title", "Impact atlas")),
        "spec": spec_toml(handle.spec),
        "citation": about.citation(ds, handle),
        "provenance": about.provenance(ds, handle),
    }
    others = _others(every) if has_all_attractors(every) and max(block) == 1 else {}
    described["others"] = {name: _label_of_other(name, described["variables"]) for name in others}
    arrays = {name: partial(_values, seen, name) for name in names} | others
    codes = {name: pack(values) for name, values in regions.items()}
    for coded_map in maps:
        coded_map.described["codes"] = add_codes(codes, coded_map)
    bare = _filled(described, words, maps, codes)
    room = limit - len(bare.encode()) - _EACH * len(arrays)
    packed, left_out = pack_within(arrays, room, last=LARGEST.name, first=ERROR.name)
    packed_maps = [coded_map for coded_map in maps if packed.keys() >= {*coded_map.needs}]
    arrays_kept = {
        name: codes[name] for name in (*(coded_map.described["codes"] for coded_map in packed_maps), *regions)
    } | packed
    text = _filled(described | {"leftOut": left_out}, words, packed_maps, arrays_kept)
    if len(text.encode()) > limit:
        size = f"{byte_size(len(text.encode()))}, at most {byte_size(limit)}"
        raise InputError(f"the page of this atlas would take {size}; select a part of it")
    return text


def lines_of(ds: "xr.Dataset", visible: "xr.Dataset") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the overlays that can be drawn on maps of a plane, by name, and the arrays that they need.

    ds        the dataset of the atlas, which may have curves
    visible   the cells that the page shows
    """
    view = MapView(KIND_TABLE["period"], ds, Plane.from_dataset(visible, ()), PictureRequest(STANDARD))
    lines, arrays = dict[str, Any](), dict[str, Any]()
    for name in MAP_OVERLAYS:
        with suppress(OverlayError):  # this atlas has no such overlay
            drawn = lines_over(view, name, SIZE)
            if drawn.described["lines"] or drawn.regions is not None:
                lines[name] = drawn.described
            arrays |= {} if drawn.regions is None else {"regions": drawn.regions}
    return lines, arrays


def _check_plane(ds: "xr.Dataset") -> None:
    check_not_points(ds, "a page")
    names = axis_names(ds)
    if len(names) == 1:
        raise InputError(f"a page shows two axes, found one ({names[0]})")
    if len(names) > 2:
        value = f"--select {names[-1]}={float(ds[names[-1]][0]):g}"
        raise InputError(f"a page shows one plane, found a stack of {ds.sizes[names[-1]]}; pick one by {value}")
    check_units(ds)


def _cells(ds: "xr.Dataset", limit: int) -> tuple["xr.Dataset", tuple[int, ...]]:
    """Return the cells that a page shows, loaded, and how many cells of the atlas along x and y each stands for.

    The cells have all variables with one number per cell, and are those of an overview if the atlas has more than
    ``limit`` cells. Raise InputError if there are too many cells and no overview.
    """
    across, up = axis_names(ds)
    names = [str(name) for name in ds.data_vars if {*ds[name].dims} == {across, up}]
    size = ds.sizes[across], ds.sizes[up]
    if math.prod(size) > limit:
        part = find_part(ds, [REGIME.name])
        if part is None:
            hint = "select a part, or open the atlas anew"
            raise InputError(f"a page shows at most {limit} cells of values in memory, found {math.prod(size)}; {hint}")
        known = {variable.name for variable in part.pyramid.variables}
        names = [name for name in names if name in known]
    halved = 0
    while True:  # unevenly spaced cells may need more halvings than their number suggests
        pixels = [-(-count >> halved) for count in size]
        with count_chunk_reads() as reads:
            seen = read_view(ds, names, pixels=pixels) if math.prod(pixels) <= limit else ds
        if seen[REGIME.name].size <= limit:
            return seen.load().transpose(up, across, ...), reads.block if len(reads.block) == 2 else (1, 1)
        halved += 1


def _others(every: "xr.Dataset") -> dict[str, Any]:
    """Return functions that read the results of further attractors, for a page of an atlas of all attractors.

    Their names have the attractor's index, such as ``largest-1`` for the second attractor.
    """
    names = [name for name in COEXISTING if name in every]
    arrays: dict[str, Any] = {}
    for index in range(1, every.sizes[ATTRACTOR]):
        ds, _ = sort_axes(select_attractor(every, index)[names])
        arrays |= {f"{name}-{index}": partial(_values, ds.load(), name) for name in names}
    return arrays


def _label_of_other(name: str, variables: Mapping[str, Any]) -> str:
    variable, _, index = name.rpartition("-")
    return f"{variables[variable]['label']} of attractor number {int(index) + 1}"


def _values(visible: "xr.Dataset", name: str) -> Any:
    return visible[name].values


def _filled(
    described: Mapping[str, Any], words: Mapping[str, Any], maps: list[CodedMap], arrays: Mapping[str, PackedArray]
) -> str:
    """Return the whole page: the HTML template filled with descriptions, texts, maps and packed arrays."""
    content = {
        **described,
        "maps": [coded_map.described for coded_map in maps],
        "arrays": {name: {"type": array.type, "digits": array.digits} for name, array in arrays.items()},
    }
    parts = {name: files(__package__).joinpath(name).read_text("utf-8") for name in ("page.html", "page.css")}
    listed = "".join(
        f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>" for name, value in words["provenance"].items()
    )
    blobs = [f'<script type="text/plain" id="{name}">{array.text}</script>' for name, array in arrays.items()]
    return Template(parts["page.html"]).substitute(
        title=html.escape(words["title"]),
        spec=html.escape(words["spec"]),
        citation=html.escape(words["citation"]),
        provenance=listed,
        style=shared_css() + parts["page.css"],
        program=program(__package__, *PROGRAM),
        described=json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":")).replace(
            "<", "\\u003c"
        ),
        arrays="\n".join(blobs),
    )
