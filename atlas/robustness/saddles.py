"""The saddles between the basins of one cell's attractors: unstable orbits on the boundaries."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import InputError
from atlas.query.basins import is_basin_atlas
from atlas.robustness.attractors import AttractorSearch
from atlas.robustness.norm import validate_weights
from atlas.spec.spec import given_values
from atlas.spec.system import must_offer
from workers import Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    import xarray as xr

    from atlas.robustness.boundary_tracking import Saddle
    from atlas.spec.spec import Spec
    from workers.model.oscillator import Array


def saddles(
    parameters: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    starts: int = AttractorSettings.count,
    norm: Mapping[str, float] | None = None,
    **named: Any,
) -> dict[str, Any]:
    """Return the unstable orbits between the basins of one cell's attractors, with the direction of the boundary.

    The orbits are exact: Newton's method solves for them.

    Parameters, ``starts`` and ``norm`` are as in ``atlas.stability``; attractors have their indices in
    ``atlas.attractors``. Each of ``saddles`` has:

    period       its period in forcing periods
    between      the two attractors whose basins meet at the saddle
    multipliers  multipliers as [real, imaginary], one of them outside the unit circle
    states       its states at t = k T, the start of each forcing period
    normal       normal of the boundary at each state, a unit vector in the norm's coordinates w z
    slopes       for one mass, dv/dx along the boundary at each state

    ``troubles`` lists boundaries on which no saddle was found, in words. Raise InputError as ``atlas.stability`` does,
    and if a coordinate drifts.

    >>> import atlas
    >>> found = atlas.saddles(system="gear-mesh", starts=8)
    >>> [(one["period"], one["between"]) for one in found["saddles"]]
    [(1, [0, 1])]
    """
    search = AttractorSearch.from_arguments(given_values(parameters, named), system, settings, starts)
    return saddles_between(search, validate_weights(norm, search.record))


def saddles_between(requested: AttractorSearch, norm: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return the results of ``saddles`` for an attractor search; ``norm`` gives weights of components of the state."""
    from atlas.robustness.boundary_tracking import saddles_of

    record = requested.record
    must_offer(record, "saddles")
    table = requested.table
    w = requested.weights(norm)
    tracked = saddles_of(table, w)
    entries = [_described(saddle) for saddle in tracked.saddles]
    results = {"norm": dict(zip(record.states, w.tolist(), strict=True)), "attractors": len(table.attractors)}
    return requested.described | results | {"saddles": entries, "troubles": tracked.troubles}


def saddles_in(ds: "xr.Dataset", spec: "Spec", axes: Sequence[str]) -> "list[Array]":
    """Return the states of each saddle between the basins of an atlas of one mass, as points (N, 2) of its plane.

    ds     dataset of the atlas
    spec   spec of the atlas
    axes   names of the components of the state across and up

    Raise InputError if the atlas is not one of basins of one mass.
    """
    from workers.attractors.basins import fixed_values

    if not is_basin_atlas(ds) or len(spec.system_def.states) != 2 or spec.attractors is None:
        raise InputError("overlay 'saddles' needs basins of one mass")
    values, order = (
        fixed_values(spec.system_def, spec.parameters),
        [spec.system_def.states.index(name) for name in axes],
    )
    saddles = saddles_between(AttractorSearch(spec.system_def, values, spec.settings, spec.attractors))["saddles"]
    return [np.array(entry["states"])[:, order] for entry in saddles]


def _described(saddle: "Saddle") -> dict[str, Any]:
    return {
        "period": saddle.period,
        "between": sorted(saddle.sides),
        "multipliers": [[float(multiplier.real), float(multiplier.imag)] for multiplier in saddle.multipliers],
        "residual": saddle.residual,
        "states": saddle.states.tolist(),
        "normal": saddle.normal.tolist(),
        **({"slopes": saddle.slopes.tolist()} if saddle.states.shape[1] == 2 else {}),
    }
