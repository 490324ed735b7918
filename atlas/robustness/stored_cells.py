"""Stability measures of the attractors of many cells, from their stored results."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.orbit_table import are_on_orbit
from atlas.robustness.fatal_shock import shock_of
from atlas.robustness.linear_measures import NO_ORBIT, UNMEASURED, measures_of
from atlas.robustness.norm import weights_of
from atlas.robustness.table import LINEAR, SHOCKS, Arrays, empty, of_family
from workers.attractors.attractor import ON_ATTRACTOR, STABLE, Attractor
from workers.attractors.basins import AttractorTable
from workers.attractors.initial_states import AttractorSettings
from workers.cell.interval import begin
from workers.model.oscillator import Array, at_rows
from workers.model.system import System
from workers.results import BEYOND_TABLE, NO_REASON, UNKNOWN_LABEL
from workers.settings import Settings


def linear_measures(
    system: System, params: Mapping[str, Array], cells: Mapping[str, NDArray[Any]], norm: Mapping[str, float]
) -> Arrays:
    """Return the return time, reactivity and amplification of the attractors (N, keep) of N cells, by name.

    system  system of the cells
    params  (N,) parameters of the cells, by name
    cells   regime, period, largest (N, keep), and state (N, keep, 2n): a state of each attractor at t = k T
    norm    weights of the norm, by component of the state
    """
    regime = cells["regime"]
    measures = empty(of_family(LINEAR), regime.shape)
    measures["unmeasured"][np.isin(regime, ON_ATTRACTOR) & ~np.isin(regime, STABLE)] = UNMEASURED[NO_ORBIT]
    oscillators, reasons = system.build_many(params)
    stable = np.isin(regime, STABLE) & (reasons == NO_REASON)[:, None] & np.isfinite(cells["state"]).all(axis=-1)
    cell, column = np.nonzero(stable)
    motions, _ = begin(at_rows(oscillators, cell), reasons[cell], cells["state"][stable])
    for k, at in enumerate(zip(cell.tolist(), column.tolist(), strict=True)):
        one = at_rows(oscillators, cell[k : k + 1])
        orbit = Attractor(
            int(regime[at]),
            {"largest": cells["largest"][at]},
            mode=int(motions.mode[k, 0]),
            h=motions.h[k],
            period=int(cells["period"][at]),
        )
        linear = measures_of(one, orbit, weights_of(norm, system, float(one.period[0])))
        for name, value in linear._asdict().items():
            if name in measures:
                measures[name][at] = value
        if linear.reason:
            measures["unmeasured"][at] = UNMEASURED[linear.reason]
    return measures


def shock_measures(
    system: System,
    params: Mapping[str, Array],
    cells: Mapping[str, NDArray[Any]],
    norm: Mapping[str, float],
    settings: Settings,
    starts: AttractorSettings,
) -> Arrays:
    """Return the minimal fatal shocks of the attractors (N, keep) of N cells, by name.

    Arguments are as in ``linear_measures``; ``settings`` and ``starts`` are those of the solver and of the search for
    attractors. The attractors of a cell are found again from the same initial states; one that is not found again has
    no shock.
    """
    measures = empty(of_family(SHOCKS), cells["regime"].shape)
    for n in np.flatnonzero(np.isin(cells["regime"], ON_ATTRACTOR).any(axis=1)).tolist():
        table = AttractorTable(system, {name: float(values[n]) for name, values in params.items()}, settings, starts)
        if len(table.attractors) < 2:
            continue
        weights = weights_of(norm, system, float(table.oscillators.period[0]))
        places = [
            _place(attractor, {name: values[n] for name, values in cells.items()}) for attractor in table.attractors
        ]
        for label, column in enumerate(places):
            shock = shock_of(table, label, weights) if column >= 0 else None
            if shock is not None:
                measures["fatal_shock"][n, column] = shock.size
                reached = places[shock.reached] if shock.reached >= 0 else BEYOND_TABLE
                measures["shock_reaches"][n, column] = BEYOND_TABLE if reached == UNKNOWN_LABEL else reached
                measures["shock_tried"][n, column] = shock.tried
    return measures


def _place(attractor: Attractor, cell: Mapping[str, NDArray[Any]]) -> int:
    """Return the index (keep,) of the stored attractor of a cell that equals ``attractor``.

    Return UNKNOWN_LABEL if none of the stored attractors does.
    """
    state = np.asarray(attractor.result["state"])
    same = (cell["regime"] == attractor.regime) & (cell["period"] == int(attractor.result["period"]))
    matches = np.flatnonzero(same & are_on_orbit(cell["state"][:, None], state))
    return int(matches[0]) if len(matches) else UNKNOWN_LABEL
