"""Tables of contacts, friction and phases to the elements of a definition, each fault in one line."""

from collections.abc import Collection, Mapping
from typing import Any

from workers.model.elements import NO_STOP, PAD, RELEASES, RUB, STOP, Changes, Contact, Friction, Phase
from workers.model.entries import DefinitionError, check_name, fault, read_entries, read_table, read_tables, read_text
from workers.model.expression import Expression
from workers.model.parameter import unknown_name

STOPS = 4
"""Stops of all contacts, sides counted."""
FRICTION = 4
"""Friction elements."""
PHASES = 16
"""Phases of a forcing period."""

_SHORT = ("gap", "upper", "lower", "restitution")  # keys of [system] that make a contact by themselves
_SOFT = (*PAD, "release")
CONTACT_KEYS = ("name", *_SHORT, *_SOFT)
FRICTION_KEYS = ("name", "row", *RUB, "belt")
PHASE_KEYS = ("start", "stiffness", "damping", "force", "cosine", "load", "contacts", "friction")
_SAME = ("mass", "gap", "row", "upper", "lower")  # keys of what is the same in all phases
_LAWS = "a rigid contact has a restitution, a soft one a stiffness, damping, preload and release"


def read_contacts(table: Mapping[str, Any], known: Collection[str], n: int) -> tuple[Contact, ...]:
    """The contacts in a table [system] of n coordinates; gap, stops and restitution there are those of a rigid one."""
    short = {key: table[key] for key in _SHORT if key in table}
    if "contacts" not in table:
        if not short and (table.get("friction") or table.get("phases")):
            return ()
        return (_read_contact("system", {"name": STOP, **short}, known, n),)
    if short:
        first = next(iter(short))
        raise DefinitionError(f"system.{first}: stands beside [[system.contacts]]; write it into one of these")
    parts = read_tables("system.contacts", table["contacts"])
    if not parts:
        raise DefinitionError("system.contacts: found none; give one, or leave the key out")
    contacts = tuple(_read_contact(where, one, known, n) for where, one in parts.items())
    if (count := sum(each.stops for each in contacts)) > STOPS:
        raise DefinitionError(f"system.contacts: found {count} stops, sides counted, must be at most {STOPS}")
    _refuse_twice("contact", parts, [each.name for each in contacts])
    return contacts


def _read_contact(where: str, given: object, known: Collection[str], n: int) -> Contact:
    table = read_table(where, given, CONTACT_KEYS)
    name = _read_name(where, table)
    if isinstance(table.get("gap"), list) and any(isinstance(each, list) for each in table["gap"]):
        raise fault(f"{where}.gap", table["gap"], "several gaps at once are not supported; give one row")
    for key in ("gap",) if any(key in table for key in _SOFT) else ("gap", "restitution"):
        if key not in table:
            raise DefinitionError(f"{where}: {key} missing" + ("" if key == "gap" else f"; {_LAWS}"))
    gap = read_entries(f"{where}.gap", table["gap"], known, n)
    upper, lower = (_read_stop(where, table, key, known) for key in ("upper", "lower"))
    soft = [key for key in _SOFT if key in table]
    if not soft:
        restitution = read_entries(f"{where}.restitution", table["restitution"], known)
        return Contact(name, gap, restitution, upper, lower)
    if "restitution" in table:
        raise DefinitionError(f"{where}: found restitution and {soft[0]}; {_LAWS}")
    if "stiffness" not in table:
        raise DefinitionError(f"{where}: stiffness missing; {_LAWS}")
    constants = {key: read_entries(f"{where}.{key}", table.get(key, 0.0), known) for key in PAD}
    release = table.get("release", RELEASES[0])
    if release not in RELEASES:
        raise fault(f"{where}.release", release, f"must be {' or '.join(map(repr, RELEASES))}")
    return Contact(name, gap, None, upper, lower, **constants, release=release)


def _read_stop(where: str, table: Mapping[str, Any], key: str, known: Collection[str]) -> Expression | None:
    if "upper" not in table and "lower" not in table:
        missing = f"{where}: upper and lower missing"
        raise DefinitionError(f"{missing}; give one stop or both as positions of the gap coordinate")
    if key not in table or table[key] == NO_STOP[key]:
        return None
    found: Expression = read_entries(f"{where}.{key}", table[key], known)
    return found


def read_friction(table: Mapping[str, Any], known: Collection[str], n: int) -> tuple[Friction, ...]:
    """The friction elements in a table [system] of n coordinates."""
    parts = read_tables("system.friction", table.get("friction", []))
    if len(parts) > FRICTION:
        raise DefinitionError(f"system.friction: found {len(parts)}, must be at most {FRICTION}")
    found = []
    for where, given in parts.items():
        one = read_table(where, given, FRICTION_KEYS)
        name = _read_name(where, one)
        for key in ("row", "kinetic"):
            if key not in one:
                raise DefinitionError(f"{where}: {key} missing; give {'a row' if key == 'row' else 'a force'}")
        row = read_entries(f"{where}.row", one["row"], known, n)
        kinetic, belt, slope = (
            read_entries(f"{where}.{key}", one.get(key, 0.0), known) for key in ("kinetic", "belt", "slope")
        )
        static = read_entries(f"{where}.static", one["static"], known) if "static" in one else None
        found.append(Friction(name, row, kinetic, static, belt, slope))
    _refuse_twice("friction element", parts, [each.name for each in found])
    return tuple(found)


def read_phases(
    table: Mapping[str, Any], known: Collection[str], n: int,
    contacts: Collection[Contact], friction: Collection[Friction],
) -> tuple[Phase, ...]:  # fmt: skip
    """The phases in a table [system] of n coordinates with these elements."""
    parts = read_tables("system.phases", table.get("phases", []))
    if len(parts) > PHASES:
        raise DefinitionError(f"system.phases: found {len(parts)}, must be at most {PHASES}")
    shapes = {"stiffness": (n, n), "damping": (n, n), "force": (n,), "cosine": (n,), "load": (n,)}
    found: list[Phase] = []
    for where, given in parts.items():
        _refuse_same(where, given)
        one = read_table(where, given, PHASE_KEYS)
        if "start" not in one:
            raise DefinitionError(f"{where}: start missing; give a share of the forcing period")
        start: Expression = read_entries(f"{where}.start", one["start"], known)
        if not found and start.constant != 0.0:
            raise fault(f"{where}.start", one["start"], "must be 0; the first phase begins at the section")
        entries = {
            key: read_entries(f"{where}.{key}", one[key], known, *shape) for key, shape in shapes.items() if key in one
        }
        entries["contacts"] = _read_changes(f"{where}.contacts", one.get("contacts", {}), contacts, known)
        entries["friction"] = _read_changes(f"{where}.friction", one.get("friction", {}), friction, known)
        found.append(Phase(start, **entries))
    return tuple(found)


def _read_changes(
    where: str, given: object, elements: Collection[Contact] | Collection[Friction], known: Collection[str]
) -> Changes:
    """What a phase changes of elements, in their order and in that of their constants."""
    table = read_table(where, given)
    names = [each.name for each in elements]
    for name in table:
        if name not in names:
            raise DefinitionError(unknown_name(f"element in {where}", name, names or ["none"]))
    found = []
    for element in elements:
        inside, keys = f"{where}.{element.name}", RUB if isinstance(element, Friction) else PAD
        changes = table.get(element.name, {})
        _refuse_same(inside, changes)
        changes = read_table(inside, changes)
        if changes and isinstance(element, Contact) and element.rigid:
            raise DefinitionError(f"{inside}: {element.name} is rigid; a phase changes soft contacts and friction")
        changes = read_table(inside, changes, keys)
        read = tuple((key, read_entries(f"{inside}.{key}", changes[key], known)) for key in keys if key in changes)
        found += [(element.name, read)] if read else []
    return tuple(found)


def _refuse_same(where: str, given: object) -> None:
    """DefinitionError for what no phase can change."""
    for key in _SAME:
        if isinstance(given, Mapping) and key in given:
            raise DefinitionError(f"{where}.{key}: phases leave mass, rows and positions of stops as they are")


def _read_name(where: str, table: Mapping[str, Any]) -> str:
    if "name" not in table:
        raise DefinitionError(f"{where}: name missing")
    check_name(f"{where}.name", table["name"])
    return read_text(f"{where}.name", table["name"])


def _refuse_twice(kind: str, parts: Collection[str], names: list[str]) -> None:
    """DefinitionError at the first name of an element that another one has."""
    for i, (where, name) in enumerate(zip(parts, names, strict=True)):
        if name in names[:i]:
            raise DefinitionError(f"{where}.name: there is a {kind} {name!r} already; choose another name")
