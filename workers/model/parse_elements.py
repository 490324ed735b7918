"""Conversion of tables of contacts, friction, springs and phases to elements, with every error in one line."""

from collections.abc import Collection, Mapping
from typing import Any

from workers.model.elements import LAW, NO_STOP, PAD, RELEASES, RUB, STOP, Changes, Contact, Friction, Phase, Spring
from workers.model.entries import DefinitionError, check_name, fault, read_entries, read_table, read_tables, read_text
from workers.model.expression import Expression
from workers.model.laws import SEGMENTS
from workers.model.parameter import unknown_name
from workers.model.parse_laws import read_law, read_law_back, read_spring

STOPS = 4
"""Maximum number of stops of all contacts together, counting sides."""
FRICTION = 4
"""Maximum number of friction elements."""
PHASES = 16
"""Maximum number of phases of a forcing period."""
SPRINGS = 4
"""Maximum number of springs with a law."""
LAWFUL = 6
"""Maximum number of contacts, springs and friction elements of a machine with a force law: the numbers of its modes,
the combinations of their states, must fit a double."""

_SHORT = ("gap", "upper", "lower", "restitution")  # keys of [system] that make a contact without a table
_SOFT = (*PAD, "release", *LAW)
CONTACT_KEYS = ("name", *_SHORT, *_SOFT)
FRICTION_KEYS = ("name", "row", *RUB, "belt", *LAW, "law_back")
PHASE_KEYS = ("start", "stiffness", "damping", "force", "cosine", "load", "contacts", "friction")
_SAME = ("mass", "gap", "row", "upper", "lower")  # keys that are the same in all phases
_LAWS = "a rigid contact has a restitution, a soft one a stiffness, damping or law, preload and release"


def read_contacts(
    table: Mapping[str, Any], known: Collection[str], n: int, smooth: Collection[str]
) -> tuple[Contact, ...]:
    """Return the contacts in a table [system] of n coordinates; stiffness, damping and preload know ``smooth`` names.

    Gap, stops and restitution in the table itself make a rigid contact.
    """
    short = {key: table[key] for key in _SHORT if key in table}
    if "contacts" not in table:
        if not short and any(table.get(key) for key in ("friction", "phases", "springs", "within")):
            return ()
        return (_read_contact("system", {"name": STOP, **short}, known, n, smooth),)
    if short:
        first = next(iter(short))
        raise DefinitionError(f"system.{first}: found beside [[system.contacts]], must stand in one of these tables")
    parts = read_tables("system.contacts", table["contacts"])
    if not parts:
        raise DefinitionError("system.contacts: found none; give one, or leave the key out")
    contacts = tuple(_read_contact(where, one, known, n, smooth) for where, one in parts.items())
    if (count := sum(contact.stops for contact in contacts)) > STOPS:
        raise DefinitionError(f"system.contacts: found {count} stops, sides counted, must be at most {STOPS}")
    _refuse_twice("contact", parts, [contact.name for contact in contacts])
    return contacts


def _read_contact(where: str, value: object, known: Collection[str], n: int, smooth: Collection[str]) -> Contact:
    table = read_table(where, value, CONTACT_KEYS)
    name = _read_name(where, table)
    if isinstance(table.get("gap"), list) and any(isinstance(entry, list) for entry in table["gap"]):
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
    if not any(key in table for key in ("stiffness", "damping", "law")):
        raise DefinitionError(f"{where}: stiffness missing; {_LAWS}")
    law = _read_law(where, table, known, Contact, ("stiffness", "preload"))
    keys = ("damping",) if law else PAD
    constants = {key: read_entries(f"{where}.{key}", table.get(key, 0.0), smooth) for key in keys}
    release = table.get("release", RELEASES[0])
    if release not in RELEASES:
        raise fault(f"{where}.release", release, f"must be {' or '.join(map(repr, RELEASES))}")
    return Contact(name, gap, None, upper, lower, **constants, release=release, **law)


def _read_stop(where: str, table: Mapping[str, Any], key: str, known: Collection[str]) -> Expression | None:
    if "upper" not in table and "lower" not in table:
        missing = f"{where}: upper and lower missing"
        raise DefinitionError(f"{missing}; give one stop or both as positions of the gap coordinate")
    if key not in table or table[key] == NO_STOP[key]:
        return None
    stop: Expression = read_entries(f"{where}.{key}", table[key], known)
    return stop


def read_friction(
    table: Mapping[str, Any], known: Collection[str], n: int, smooth: Collection[str]
) -> tuple[Friction, ...]:
    """Return the friction in a table [system] of n coordinates; its levels and slope know ``smooth`` names."""
    parts = read_tables("system.friction", table.get("friction", []))
    if len(parts) > FRICTION:
        raise DefinitionError(f"system.friction: found {len(parts)}, must be at most {FRICTION}")
    friction = []
    for where, value in parts.items():
        one = read_table(where, value, FRICTION_KEYS)
        name = _read_name(where, one)
        law = _read_law(where, one, known, Friction, ("kinetic", "slope"))
        for key in ("row",) if law else ("row", "kinetic"):
            if key not in one:
                raise DefinitionError(f"{where}: {key} missing; give {'a row' if key == 'row' else 'a force'}")
        row = read_entries(f"{where}.row", one["row"], known, n)
        belt = read_entries(f"{where}.belt", one.get("belt", 0.0), known)
        slope = None if law else read_entries(f"{where}.slope", one.get("slope", 0.0), smooth)
        kinetic, static = (
            read_entries(f"{where}.{key}", one[key], smooth) if key in one else None for key in ("kinetic", "static")
        )
        back = read_law_back(where, one, law, known)
        friction.append(Friction(name, row, kinetic, static, belt, slope, **law, law_back=back))
    _refuse_twice("friction element", parts, [element.name for element in friction])
    return tuple(friction)


def read_springs(table: Mapping[str, Any], known: Collection[str], n: int) -> tuple[Spring, ...]:
    """Return the springs in a table [system] of n coordinates."""
    parts = read_tables("system.springs", table.get("springs", []))
    if len(parts) > SPRINGS:
        raise DefinitionError(f"system.springs: found {len(parts)}, must be at most {SPRINGS}")
    springs = tuple(read_spring(where, one, known, n) for where, one in parts.items())
    _refuse_twice("spring", parts, [spring.name for spring in springs])
    return springs


def check_element_count(*elements: Collection[Contact] | Collection[Friction] | Collection[Spring]) -> None:
    """Raise DefinitionError if a machine with a force law has too many elements for its modes to be numbered.

    A mode is a set of linear equations, one for each combination of the states of contacts and friction.
    """
    laws = [element.law for kind in elements for element in kind]
    if any(law is not None for law in laws) and len(laws) > LAWFUL:
        raise DefinitionError(
            f"system: found {len(laws)} contacts, springs and friction elements, must be at most {LAWFUL} if one "
            f"has a law; with segments up to {SEGMENTS} each the modes would be too many to number"
        )


def _read_law(
    where: str, table: Mapping[str, Any], known: Collection[str], kind: type, instead: Collection[str]
) -> dict[str, Any]:
    """Return the force law in a table of a contact or friction, by the keys LAW; empty if there is no law.

    ``instead`` are the keys that a law replaces.
    """
    if "law" not in table:
        for key in (key for key in LAW if key in table):
            raise DefinitionError(f"{where}.{key}: found without a law; give law too, or leave this key out")
        return {}
    for key in (key for key in instead if key in table):
        raise DefinitionError(f"{where}: found law and {key}; the law replaces {key}")
    return read_law(where, table, known, kind)


def read_phases(
    table: Mapping[str, Any], known: Collection[str], n: int,
    contacts: Collection[Contact], friction: Collection[Friction], smooth: Collection[str],
) -> tuple[Phase, ...]:  # fmt: skip
    """Return the phases, parts of the forcing period, in a table [system] with these contacts and friction.

    table     the table, of a system with n coordinates
    known     names that expressions may use
    contacts  contacts whose constants phases may change
    friction  friction elements whose constants phases may change
    smooth    names that all entries but start and force may use
    """
    parts = read_tables("system.phases", table.get("phases", []))
    if len(parts) > PHASES:
        raise DefinitionError(f"system.phases: found {len(parts)}, must be at most {PHASES}")
    shapes = {"stiffness": (n, n), "damping": (n, n), "force": (n,), "cosine": (n,), "load": (n,)}
    phases: list[Phase] = []
    for where, value in parts.items():
        _refuse_same(where, value)
        one = read_table(where, value, PHASE_KEYS)
        if "start" not in one:
            raise DefinitionError(f"{where}: start missing; give a share of the forcing period")
        start: Expression = read_entries(f"{where}.start", one["start"], known)
        if not phases and start.constant != 0.0:
            raise fault(f"{where}.start", one["start"], "must be 0; the first phase begins at the section")
        entries = {
            key: read_entries(f"{where}.{key}", one[key], known if key in ("force", "cosine") else smooth, *shape)
            for key, shape in shapes.items()
            if key in one
        }
        entries["contacts"] = _read_changes(f"{where}.contacts", one.get("contacts", {}), contacts, smooth)
        entries["friction"] = _read_changes(f"{where}.friction", one.get("friction", {}), friction, smooth)
        phases.append(Phase(start, **entries))
    return tuple(phases)


def _read_changes(
    where: str, value: object, elements: Collection[Contact] | Collection[Friction], known: Collection[str]
) -> Changes:
    """Return the constants of contacts or friction that a phase changes, in the order of elements and of constants."""
    table = read_table(where, value)
    names = [element.name for element in elements]
    for name in table:
        if name not in names:
            raise DefinitionError(unknown_name(f"element in {where}", name, names or ["none"]))
    every = []
    for element in elements:
        inside = f"{where}.{element.name}"
        keys: tuple[str, ...] = RUB if isinstance(element, Friction) else PAD
        if element.law is not None:
            keys = ("damping",) if isinstance(element, Contact) else ("static",)  # the law is the same in all phases
        changes = table.get(element.name, {})
        _refuse_same(inside, changes)
        changes = read_table(inside, changes)
        if changes and isinstance(element, Contact) and element.rigid:
            raise DefinitionError(f"{inside}: {element.name} is rigid; a phase changes soft contacts and friction")
        changes = read_table(inside, changes, keys)
        read = tuple((key, read_entries(f"{inside}.{key}", changes[key], known)) for key in keys if key in changes)
        every += [(element.name, read)] if read else []
    return tuple(every)


def _refuse_same(where: str, value: object) -> None:
    """Raise DefinitionError for entries that no phase can change."""
    for key in _SAME:
        if isinstance(value, Mapping) and key in value:
            raise DefinitionError(f"{where}.{key}: phases cannot change mass, rows or positions of stops")


def _read_name(where: str, table: Mapping[str, Any]) -> str:
    if "name" not in table:
        raise DefinitionError(f"{where}: name missing")
    check_name(f"{where}.name", table["name"])
    return read_text(f"{where}.name", table["name"])


def _refuse_twice(kind: str, parts: Collection[str], names: list[str]) -> None:
    """Raise DefinitionError at the first repeated name of an element."""
    for i, (where, name) in enumerate(zip(parts, names, strict=True)):
        if name in names[:i]:
            raise DefinitionError(f"{where}.name: there is a {kind} {name!r} already; choose another name")
