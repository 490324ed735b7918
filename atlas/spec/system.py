"""Find the system, the definition of a machine, that a spec, a store or a command names or describes."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from atlas.errors import InputError, brief_repr
from atlas.spec.examples import example_system
from workers.model.system import System, find_system


def parse_system(system: object, folder: Path | None = None) -> System:
    """Return the system that is given by its name, the path of a .toml file or a table; a System is returned unchanged.

    The path of a file is relative to ``folder``, if given. A packaged example that describes its own system may be
    named, too. Raise InputError for an unknown name, with the nearest known one, and for a wrong definition.
    """
    if not isinstance(system, str | Mapping | System):
        raise InputError(f"system: found {brief_repr(system)}, must be the name of a system, a .toml file or a table")
    if folder is not None and isinstance(system, str) and system.endswith(".toml"):
        system = str(folder / system)
    try:
        return find_system(system)
    except KeyError as error:
        if (described := example_system(str(system))) is not None:
            return described
        raise InputError(error.args[0]) from None
    except ValueError as error:
        raise InputError(str(error)) from None


def resolved_system(resolved: Mapping[str, Any]) -> System:
    """Return the system of a resolved spec; raise InputError if this program cannot build it."""
    try:
        return System.from_resolved(resolved)
    except KeyError as error:
        raise InputError(error.args[0]) from None
    except ValueError as error:
        raise InputError(str(error)) from None


def stored_spec(attributes: Mapping[Any, Any]) -> Mapping[str, Any]:
    """Return the resolved spec of the store with these root attributes; empty if they contain no spec."""
    try:
        spec = json.loads(str(attributes.get("spec", "")))
    except ValueError:
        return {}
    return spec if isinstance(spec, Mapping) else {}


def system_of(attributes: Mapping[Any, Any], who: str = "") -> System:
    """Return the system of the store with these root attributes.

    Raise InputError if the attributes name no system that this program can build; the message begins with ``who``.
    """
    try:
        return resolved_system(stored_spec(attributes))
    except InputError as error:
        reason = str(error)
    except (KeyError, TypeError, ValueError):
        reason = "this dataset lacks the spec of its atlas"
    raise InputError(f"{who}: {reason}" if who else reason)


def stored_system(attributes: Mapping[Any, Any]) -> System | None:
    """Return the system of the store with these root attributes; None if they name no known system."""
    with suppress(InputError):
        return system_of(attributes)
    return None


def stored_name(attributes: Mapping[Any, Any]) -> str:
    """Return the name that a store's root attributes give its system, known or not; empty if they give none."""
    system = stored_spec(attributes).get("system", "")
    return str(system.get("name", "") if isinstance(system, Mapping) else system)


def impacts_of(system: System, cell: Mapping[str, Any]) -> str:
    """Return the impacts of an orbit at the upper and at the lower stop as p-q; "sticks" if there are infinitely many.

    With several contacts, these are the counts of each in the order of the definition, p-q/r-s, or the total if the
    cell lacks them.
    """
    one_by_one = [(f"{contact.name}_upper", f"{contact.name}_lower") for contact in system.definition.contacts]
    if not system.has_modes or not any(name in cell for pair in one_by_one for name in pair):
        one_by_one = [("impacts_upper", "impacts_lower")]
    counts = [[int(cell.get(name, 0)) for name in pair] for pair in one_by_one]
    return "sticks" if min(map(min, counts)) < 0 else "/".join(f"{p}-{q}" for p, q in counts)


def unused_lines(system: System) -> list[str]:
    """Return a list with a line of text about the system's parameters that have no effect; empty if all have one."""
    return [f"no entry of {system.name} uses {', '.join(system.unused_parameters)}"] if system.unused_parameters else []


def must_offer(system: System, what: str, unforced: bool = False) -> None:
    """Raise InputError, in one line, if the function ``what``, such as "branches", does not work for this system.

    It does not work if a coordinate drifts, nor without a force unless ``unforced``.
    """
    with _as_input_error():
        system.must_offer(what, unforced)


def must_have_force(system: System, what: str) -> None:
    """Raise InputError, in one line, if the system has no force, which the function ``what`` needs."""
    with _as_input_error():
        system.must_have_force(what)


@contextmanager
def _as_input_error() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise InputError(str(error)) from None
