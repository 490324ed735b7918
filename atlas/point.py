"""One cell, solved here and now."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from atlas.spec import checked_parameters, checked_system
from workers import Settings
from workers.results import REGIME, REGIMES, result_variables


def point(system: str, given: Mapping[str, Any], settings: Settings) -> dict[str, Any]:
    """Results of one cell by name (``regime`` by its name), with ``system``, ``parameters`` and ``solve`` in full.

    ``given`` are the parameters that differ from the defaults. ``reason`` is there where the cell could not be solved.
    Raises InputError for a parameter that does not exist or is out of range.
    """
    from workers.tile import solve_cells

    record = checked_system(system)
    parameters = checked_parameters(record, given)
    arrays, reasons = solve_cells(record.name, parameters, settings)
    names = {regime.code: regime.name for regime in REGIMES}
    found = {variable.name: arrays[variable.name].tolist() for variable in result_variables(settings)}
    found[REGIME.name] = names[found[REGIME.name]]
    if reasons:
        found["reason"] = ", ".join(map(str, reasons))
    return {"system": record.name, "parameters": parameters, "solve": asdict(settings)} | found
