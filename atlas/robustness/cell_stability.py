"""Stability measures of all attractors of one cell: basin stability, decay and growth of deviations, fatal shocks."""

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
"""Results of a search for attractors that ``stability`` returns, too."""
SHOWN = (REGIME.name, "share", "share_low", "share_high", "period", LARGEST.name)
"""Results of an attractor that ``stability`` returns before the measures."""


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
    """Return how stable each attractor of one cell is: basin stability, return time, reactivity, amplification.

    ``omega=4.0`` or a mapping gives parameters other than the defaults. The attractors are those of
    ``atlas.attractors`` with the same ``starts``; ``share`` is the basin stability, with its 95 % interval. ``norm``
    has weights w > 0 of components of the state, ``|dz|`` = sqrt(sum (w dz)^2); other weights are 1 for displacements
    and 1/omega for velocities. Each attractor in ``coexisting`` has these measures:

    return_time      time in forcing periods, -1 / largest exponent
    reactivity       largest log growth of a small deviation over one forcing period
    amplification    largest growth of a small deviation over any number of periods
    amplified_after  that number of periods
    reason           why a measure is unknown; missing if all are known

    Unknown measures are NaN, or -1; chaos and tori have none. With ``shocks``, which costs thousands of motions, each
    attractor also has:

    fatal_shock         size ``|dz|`` of the smallest deviation found, at t = k T, that leads to another attractor
    shock_from          index of the attractor's state at t = k T to which this deviation is added
    shock_state         the state after this deviation
    shock_reaches       index of the attractor reached from this state; -2 for an orbit that is not listed
    shock_tried         number of states tried that fill the ball of this size evenly and are not fatal
    shock_unseen_share  share of this ball that may be fatal and be missed in one search of twenty
    shock_reason        why there is no shock, if no other attractor is known; ``fatal_shock`` is then NaN

    ``fatal_shock`` is an upper bound of the minimal fatal shock. Raise InputError for a parameter or a component that
    does not exist, and for a value out of range.

    >>> import atlas
    >>> found = atlas.stability(omega=4.0, b=0.1, starts=8)
    >>> [(one["period"], round(one["return_time"], 3)) for one in found["coexisting"]]
    [(1, 4.245), (3, 4.276)]
    """
    validate_flag("shocks", shocks)
    search = AttractorSearch.from_arguments(given_values(parameters, named), system, settings, starts)
    must_have_force(search.record, "stability measures")
    if search.settings.exponents == "none":
        raise InputError("exponents: found 'none'; stability measures need the largest one")
    w = search.weights(validate_weights(norm, search.record))
    results = {"norm": dict(zip(search.record.states, w.tolist(), strict=True))}
    results |= {name: search.results[name] for name in (*COUNTS, REGIME.name, REASON.name) if name in search.results}
    entries = [
        {name: entry[name] for name in SHOWN}
        | _measured(search.table, index, w)
        | {"state": entry["state"]}
        | (_shocked(search.table, index, w) if shocks else {})
        for index, entry in enumerate(search.results["coexisting"])
    ]
    return search.described | results | {"coexisting": entries}


def _measured(table: "AttractorTable", index: int, weights: "Array") -> dict[str, Any]:
    """Return the return time, reactivity and amplification of the attractor ``index`` of the table, by name."""
    from atlas.robustness.linear_measures import measures_of

    measures = measures_of(table.cell.oscillator, table.attractors[index], weights)._asdict()
    return measures if measures["reason"] else {name: value for name, value in measures.items() if name != "reason"}


def _shocked(table: "AttractorTable", index: int, weights: "Array") -> dict[str, Any]:
    """Return the minimal fatal shock of the attractor ``index`` of the table, as results by name."""
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
