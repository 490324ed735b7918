"""All attractors of one cell, solved in this process."""

from collections.abc import Mapping
from typing import Any

from atlas.cell.coexisting import attractor_in_words
from atlas.spec.attractors import cell_attractors, resolved_search
from atlas.spec.spec import checked_parameters, given_settings, given_values
from atlas.spec.system import checked_system
from workers import Settings
from workers.attractors.starts import Starts
from workers.model.system import DEFAULT, System
from workers.results import ATTRACTOR, REASON, REGIME, in_words


def attractors(
    given: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    starts: int = Starts.count,
    **named: Any,
) -> dict[str, Any]:
    """All attractors that initial states of one cell reach, with their shares, as ``[attractors]`` finds them.

    ``omega=4.0`` or a mapping gives parameters other than the defaults. ``starts`` initial states are solved: the
    cell's own and others that fill a box evenly; only half of them if these all reach one attractor.
    Result by name: ``attractors``, the number found; ``starts`` solved; ``own``, the place of the attractor that the
    cell's own initial state reaches; ``undecided`` initial states; ``unseen_share``, the share of an attractor that 5 %
    of such cells miss; ``periods_used`` by all; ``coexisting``, the attractors with all their numbers, the largest
    share first; where there is none, the ``regime`` and ``reason`` of the cell's own initial state; and ``system``,
    ``parameters``, ``solve`` and ``search`` in full.
    Raises InputError for a parameter that does not exist or is out of range, and for settings that find no attractors.

    >>> import atlas
    >>> found = atlas.attractors(omega=4.0, b=0.1, starts=8)
    >>> [(each["regime"], each["period"], each["share"]) for each in found["coexisting"]]
    [('periodic', 1, 0.625), ('periodic', 3, 0.375)]
    """
    from workers.attractors.waves import solve_attractors

    record, settings = checked_system(system), given_settings(settings)
    parameters = checked_parameters(record, given_values(given, named))
    search = cell_attractors(starts, record, settings)
    arrays = solve_attractors(record, parameters, settings, search)
    many = [each.name for each in record.variables(settings, attractors=True) if ATTRACTOR in each.extra]
    found = {name: array.tolist() for name, array in arrays.items() if name not in many}
    kept = min(found["attractors"], search.keep)
    each = [attractor_in_words({name: arrays[name][place].tolist() for name in many}) for place in range(kept)]
    if not each:  # then the first place has what became of the cell's own initial state
        found |= in_words({name: arrays[name][0] for name in (REGIME.name, REASON.name)})
    return resolved_search(record, parameters, settings, search) | found | {"coexisting": each}
