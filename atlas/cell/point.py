"""The results of one cell, solved in this process."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from atlas.spec.spec import given_settings, given_values, validate_parameters
from atlas.spec.system import parse_system
from workers import Settings
from workers.model.system import DEFAULT, System
from workers.results import REASON, in_words


def point(
    given: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    **named: Any,
) -> dict[str, Any]:
    """Solve one cell and return its results by name, with ``system``, ``parameters`` and ``solve`` in full.

    ``omega=4.0`` or a mapping gives parameters other than the defaults; ``system`` is a name, the path of a .toml file,
    or a System. ``regime`` is the name of the regime. ``reason`` is present if the cell could not be solved. Raise
    InputError for a parameter that does not exist or is out of range.

    >>> import atlas
    >>> cell = atlas.point(omega=4.0, b=0.15)
    >>> cell["regime"], cell["period"], cell["impacts_upper"], cell["impacts_lower"], round(cell["largest"], 6)
    ('periodic', 1, 1, 1, -0.206173)
    """
    from workers.tile import solve_tile

    record, settings = parse_system(system), given_settings(settings)
    parameters = validate_parameters(record, given_values(given, named))
    arrays = solve_tile(record, parameters, settings)
    results = {variable.name: arrays[variable.name].tolist() for variable in record.variables(settings)}
    words = in_words(results)
    del results[REASON.name]
    return record.to_resolved() | {"parameters": parameters, "solve": asdict(settings)} | results | words
