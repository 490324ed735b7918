"""One cell, solved here and now: its results, or its portrait."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from atlas.spec.spec import checked_parameters, checked_system
from workers import Settings
from workers.results import NO_REASON, REASON, REASONS, REGIME, REGIMES, result_variables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def point(system: str, given: Mapping[str, Any], settings: Settings) -> dict[str, Any]:
    """Results of one cell by name (``regime`` by its name), with ``system``, ``parameters`` and ``solve`` in full.

    ``given`` are the parameters that differ from the defaults. ``reason`` is there where the cell could not be solved.
    Raises InputError for a parameter that does not exist or is out of range.
    """
    from workers.tile import solve_cells

    record = checked_system(system)
    parameters = checked_parameters(record, given)
    arrays = solve_cells(record.name, parameters, settings).arrays
    names = {regime.code: regime.name for regime in REGIMES}
    found = {variable.name: arrays[variable.name].tolist() for variable in result_variables(settings)}
    found[REGIME.name] = names[found[REGIME.name]]
    reason = REASONS[found.pop(REASON.name)]
    if reason.code != NO_REASON:
        found[REASON.name] = reason.text
    return {"system": record.name, "parameters": parameters, "solve": asdict(settings)} | found


def portrait(
    given: Mapping[str, Any] | None = None,
    *,
    system: str = "two-mass",
    settings: Settings | None = None,
    path: str | Path | None = None,
) -> "Figure":
    """The portrait of one cell as a matplotlib Figure; written to ``path`` too (.png, .svg or .pdf) if given.

    Time histories with impacts marked, phase planes, the plane of both displacements, the Poincare section, and the
    exponents as they converge, beside their exact values where the motion is periodic. ``given`` are the parameters
    that differ from the defaults, initial state included: with several attractors it decides which is shown.
    Raises InputError for bad parameters, for a cell without a motion to show and for a path that cannot be written.
    """
    from atlas.cell.orbit import follow
    from atlas.render import check_path, orbit_figure, render_orbit

    if path is not None:
        check_path(path)
    orbit = follow(given or {}, system, settings)
    drawn = orbit_figure(orbit)
    if path is not None:
        render_orbit(orbit, path, drawn)
    return drawn
