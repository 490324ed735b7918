"""Stability measures of all attractors of one cell."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.argument_checks import validate_flag
from atlas.errors import InputError
from atlas.robustness.attractors import AttractorSearch
from atlas.robustness.norm import validate_weights
from atlas.spec.spec import given_values
from atlas.spec.system import must_have_force
from workers import Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import DEFAULT, System
from workers.results import LARGEST, REASON, REGIME

if TYPE_CHECKING:
    from workers.attractors.basins import AttractorTable
    from workers.model.oscillator import Array

COUNTS = ("attractors", "starts", "undecided", "unseen_share", "periods_used")
"""Results of the cell that are listed."""
SHOWN = (REGIME.name, "share", "share_low", "share_high", "period", LARGEST.name)
"""Results of an attractor that are listed before its measures."""


def stability(
    parameters: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    starts: int = AttractorSettings.count,
    norm: Mapping[str, float] | None = None,
    shocks: bool = False,
    **named: Any,
) -> dict[str, Any]:
    """How stable each attractor of one cell is: basin stability, return time, reactivity, amplification.

    ``omega=4.0`` or a mapping gives parameters other than the defaults. The attractors are the ones
    of ``atlas.attractors`` with as many ``starts``; ``share`` is the basin stability, with its 95 % interval.
    ``norm`` has weights w > 0 of components of the state, ``|dz|`` = sqrt(sum (w dz)^2); the others have 1 if
    displacements, 1/omega if velocities.
    Each of ``coexisting`` has ``return_time`` in forcing periods, -1 / largest exponent; ``reactivity``, the largest
    log growth of a small deviation over one forcing period; ``amplification``, its largest growth over any number of
    periods, and ``amplified_after``, that number. Unknown numbers are NaN, or -1, and ``reason`` says why; chaos and
    tori have none of these.
    With ``shocks``, which costs thousands of motions, also ``fatal_shock``: the size ``|dz|`` of the smallest deviation
    found at the section that takes the motion to another attractor, ``shock_state``, the state it leads to, and
    ``shock_reaches``, the place of the attractor reached from there, -2 for an orbit that is not listed. It is an upper
    bound of the minimal fatal shock; ``shock_tried`` states that fill the ball of this size evenly are not fatal. NaN
    and ``shock_reason`` if no other attractor is known.
    Raises InputError for a parameter or a component that does not exist, and for a value out of range.

    >>> import atlas
    >>> found = atlas.stability(omega=4.0, b=0.1, starts=8)
    >>> [(one["period"], round(one["return_time"], 3)) for one in found["coexisting"]]
    [(1, 4.245), (3, 4.276)]
    """
    validate_flag("shocks", shocks)
    asked = AttractorSearch.from_arguments(given_values(parameters, named), system, settings, starts)
    must_have_force(asked.record, "stability measures")
    if asked.settings.exponents == "none":
        raise InputError("exponents: found 'none'; stability measures need the largest one")
    w = asked.weights(validate_weights(norm, asked.record))
    results = {"norm": dict(zip(asked.record.states, w.tolist(), strict=True))}
    results |= {name: asked.results[name] for name in (*COUNTS, REGIME.name, REASON.name) if name in asked.results}
    entries = [
        {name: entry[name] for name in SHOWN}
        | _measured(asked.table, place, w)
        | {"state": entry["state"]}
        | (_shocked(asked.table, place, w) if shocks else {})
        for place, entry in enumerate(asked.results["coexisting"])
    ]
    return asked.described | results | {"coexisting": entries}


def _measured(table: "AttractorTable", index: int, weights: "Array") -> dict[str, Any]:
    """The linear measures of the attractor in this place of the table."""
    from atlas.robustness.linear_measures import measures_of

    measures = measures_of(table.cell.oscillator, table.attractors[index], weights)._asdict()
    return measures if measures["reason"] else {name: value for name, value in measures.items() if name != "reason"}


def _shocked(table: "AttractorTable", index: int, weights: "Array") -> dict[str, Any]:
    """The minimal fatal shock of the attractor in this place of the table."""
    from atlas.robustness.fatal_shock import shock_of

    shock = shock_of(table, index, weights)
    if shock is None:
        return {"fatal_shock": np.nan, "shock_reason": "no other attractor is known"}
    return {
        "fatal_shock": shock.size,
        "shock_reaches": shock.reached,
        "shock_tried": shock.tried,
        "shock_unseen_share": shock.unseen,
        "shock_from": shock.phase,
        "shock_state": shock.state.tolist(),
    }
