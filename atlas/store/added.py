"""What a store gets after it was made: allowances."""

import json
from collections.abc import Iterable
from dataclasses import replace

from atlas.store.axes import ROOT
from atlas.store.build import consolidate, create_variable
from atlas.store.location import Place
from atlas.store.schema import Allowance, variable_attributes
from atlas.store.store import ZOOM, Header, open_group


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
