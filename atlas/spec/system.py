"""Find the system, the definition of a machine, that a spec, a store or a command names or describes."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
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
    return _of_text(str(attributes.get("spec", "")))[0]


def system_of(attributes: Mapping[Any, Any], who: str = "") -> System:
    """Return the system of the store with these root attributes.

    Raise InputError if the attributes name no system that this program can build; the message begins with ``who``.
    """
    system = _of_text(str(attributes.get("spec", "")))[1]
    if isinstance(system, InputError):
        raise InputError(f"{who}: {system}" if who else str(system))
    return system


def stored_system(attributes: Mapping[Any, Any]) -> System | None:
    """Return the system of the store with these root attributes; None if they name no known system."""
    system = _of_text(str(attributes.get("spec", "")))[1]
    return None if isinstance(system, InputError) else system


def stored_name(attributes: Mapping[Any, Any]) -> str:
    """Return the name that a store's root attributes give its system, known or not; empty if they give none."""
    system = stored_spec(attributes).get("system", "")
    return str(system.get("name", "") if isinstance(system, Mapping) else system)


@lru_cache(maxsize=16)
def _of_text(text: str) -> tuple[Mapping[str, Any], System | InputError]:
    """Return the spec in a JSON text, and its system, or the error if this program cannot build the system.

    The result is cached, since a picture needs the system at every label.
    """
    lacking = InputError("this dataset lacks the spec of its atlas")
    try:
        spec = json.loads(text)
        if not isinstance(spec, Mapping):
            return {}, lacking
    except ValueError:
        return {}, lacking
    try:
        return spec, resolved_system(spec)
    except InputError as error:
        return spec, error
    except (KeyError, TypeError, ValueError):
        return spec, lacking


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
