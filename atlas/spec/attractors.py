"""The table ``[attractors]`` of a spec: the initial states from which attractors are searched in each cell."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from atlas.errors import InputError, brief_repr, check_names
from atlas.spec.axis import number
from workers.attractors.initial_states import MAX_KEPT, AttractorSettings
from workers.model.system import System
from workers.settings import Settings

KEYS = ("starts", "seed", "box", "keep")
MOST_COST = 2**31 - 1
"""Maximum cost of a cell in forcing periods: the largest number that its result ``periods_used`` can hold."""


def parse_attractors(attractors: object, system: System, settings: Settings) -> AttractorSettings | None:
    """Convert the table ``[attractors]`` of a spec to the settings of the search; None if there is no table.

    Raise InputError, naming the key, for a wrong table.
    """
    if attractors is None:
        return None
    table: object = attractors_to_json(attractors) if isinstance(attractors, AttractorSettings) else attractors
    if not isinstance(table, Mapping):
        raise InputError(f"attractors: found {brief_repr(table)}, must be a table")
    check_names("key in attractors", table, KEYS)
    if settings.method == "fixed":
        raise InputError('attractors: need method = "adaptive", found "fixed"')
    arguments = {"count" if key == "starts" else key: table[key] for key in ("starts", "seed", "keep") if key in table}
    try:
        starts = AttractorSettings(**arguments, box=_checked_box(table.get("box", {}), system))
    except ValueError as error:
        raise error if isinstance(error, InputError) else InputError(f"attractors.{error}") from None
    cost = settings.max_periods + settings.survival
    if starts.count * cost > MOST_COST:
        raise InputError(
            f"attractors.starts: found {starts.count}, of at most {cost} periods each "
            f"(solve.max_periods and survival); together they must be at most {MOST_COST}"
        )
    return starts


def cell_attractors(starts: int, system: System, settings: Settings) -> AttractorSettings:
    """Return settings of a search for all attractors of one cell, from ``starts`` initial states.

    Raise InputError as ``parse_attractors`` does.
    """
    search = parse_attractors({"starts": starts, "keep": MAX_KEPT}, system, settings)
    assert search is not None
    return search


def search_to_json(
    system: System, parameters: Mapping[str, float], settings: Settings, search: AttractorSettings
) -> dict[str, Any]:
    """Return system, parameters, settings and attractor search of one cell as a dict for JSON, with all defaults filled
    in.
    """
    described = {"parameters": parameters, "solve": asdict(settings), "search": attractors_to_json(search)}
    return system.to_resolved() | described


def attractors_to_json(starts: AttractorSettings) -> dict[str, Any]:
    """Return the settings of an attractor search as a table ``[attractors]``, as a dict for JSON."""
    box = {name: [low, high] for name, low, high in starts.box}
    return {"starts": starts.count, "seed": starts.seed, "box": box, "keep": starts.keep}


def _checked_box(value: object, system: System) -> tuple[tuple[str, float, float], ...]:
    if not isinstance(value, Mapping):
        raise InputError(
            f"attractors.box: found {brief_repr(value)}, must be a table of components of the initial state"
        )
    check_names("component in attractors.box", value, system.states)
    box = []
    for name in system.states:
        if name not in value:
            continue
        ends = value[name]
        if not isinstance(ends, list | tuple) or len(ends) != 2:
            raise InputError(
                f"attractors.box.{name}: found {brief_repr(ends)}, must be two numbers, lowest and highest"
            )
        low, high = (number(f"attractors.box.{name}", end) for end in ends)
        if not low <= high:
            raise InputError(f"attractors.box.{name}: found {low:g} to {high:g}, must rise")
        box.append((name, low, high))
    return tuple(box)
