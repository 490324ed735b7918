"""What a store gets after it was made: records, allowances, and coordinates that are written again."""

import json
from collections.abc import Iterable
from dataclasses import replace

from atlas.store.axes import ROOT
from atlas.store.build import codecs, consolidate, create_variable
from atlas.store.location import Place
from atlas.store.record import create_arrays
from atlas.store.schema import ALLOWANCES, Allowance, variable_attributes
from atlas.store.store import ZOOM, Header, open_group, read_header


def add_records(header: Header) -> Header:
    """The header of a store with arrays for records; a store of an earlier version gets them here."""
    if header.record is not None:
        return header
    root = open_group(header.place, "r+")
    create_arrays(root, (*header.variables, *ALLOWANCES), header.spec.dims, header.tiling.grid, codecs(), added=True)
    consolidate(root)
    _leave_out(header.place, f"{ZOOM}/")
    return read_header(header.place)


def add_allowances(header: Header, raised: Iterable[Allowance]) -> None:
    """Add variables for cells that are given more than the spec's settings; all others read as these settings."""
    group = open_group(header.place, "r+")
    wanted, spec = list(raised), header.spec
    for each in (each for each in wanted if each.name not in group):
        fixed = [name for name in (*spec.parameters, *spec.points) if name in header.coordinate_names]
        variable = replace(each, fill=each.of_spec(spec))
        create_variable(group, variable, spec, header.tiling, variable_attributes(variable, fixed))
    if any(each.name not in header.arrays for each in wanted):  # also if a run made it and was killed at once
        consolidate(group)
        _leave_out(header.place, f"{ZOOM}/")
    vars(header).pop("writable", None)  # it is to be opened with them


def _leave_out(place: Place, prefix: str) -> None:
    """Take what lies under a prefix, which comes and goes on its own, out of the root's copy of the metadata."""
    root = json.loads(place.get(ROOT) or b"{}")
    nodes = root.get("consolidated_metadata", {}).get("metadata", {})
    foreign = [name for name in nodes if f"{name}/".startswith(prefix)]
    for name in foreign:
        del nodes[name]
    if foreign:
        place.put(ROOT, json.dumps(root).encode())
