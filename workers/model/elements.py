"""Contacts, friction, springs and phases of a definition."""

import math
from dataclasses import dataclass

from workers.model.expression import Expression, Matrix, Row

STOP = "stop"
"""The name of the contact that entries of the machine itself make."""

NO_STOP = {"upper": math.inf, "lower": -math.inf}

RELEASES = ("displacement", "force")
"""When a soft contact lets go: where its stop is left, or where its force would begin to pull."""

PAD = ("stiffness", "damping", "preload")
"""The constants of a soft contact that phases may change."""

RUB = ("kinetic", "static", "slope")
"""The constants of friction that phases may change."""

LAW = ("law", "within", "range")
"""The keys of a law: a table, or an expression of its variable with a bound, and where that counts."""

SegmentsOf = tuple[Row, ...] | Expression
"""A law as its table [[argument, force], ...], or as an expression of its argument."""

Changes = tuple[tuple[str, tuple[tuple[str, Expression], ...]], ...]
"""Constants that a phase changes, by the name of the element and by their own."""


@dataclass(frozen=True)
class Contact:
    """A stop, or two, on y = gap . x, lower <= y <= upper. A stop that is None does not exist.

    A rigid one has a restitution R and turns y' into -R y'. A soft one has none: at depth delta >= 0 beyond its stop it
    pushes back along the gap row with the force preload + stiffness delta + damping delta', as long as delta > 0 where
    it is released by "displacement", and no longer than that force is positive where by "force". One with a law has
    law(delta) in the place of preload + stiffness delta: see laws.py.
    """

    name: str
    gap: Row
    restitution: Expression | None = None
    upper: Expression | None = None
    lower: Expression | None = None
    stiffness: Expression | None = None
    damping: Expression | None = None
    preload: Expression | None = None
    release: str = ""
    law: SegmentsOf | None = None
    within: Expression | None = None
    range: Expression | Row | None = None

    @property
    def rigid(self) -> bool:
        """Whether it has a restitution."""
        return self.restitution is not None

    @property
    def stops(self) -> int:
        """How many sides have a stop."""
        return (self.upper is not None) + (self.lower is not None)


@dataclass(frozen=True)
class Friction:
    """Dry friction on the sliding velocity v = row . x' - belt.

    While it slides it resists with the force kinetic + slope |v| along the row, or with law(|v|): see laws.py. It holds
    v = 0 as long as the force that this takes is at most ``static``, which is kinetic, or law(0), where it is None.
    """

    name: str
    row: Row
    kinetic: Expression | None
    static: Expression | None
    belt: Expression
    slope: Expression | None
    law: SegmentsOf | None = None
    within: Expression | None = None
    range: Expression | Row | None = None


@dataclass(frozen=True)
class Spring:
    """A spring on y = row . x, which pulls back along its row with the force law(y), wherever y is: see laws.py."""

    name: str
    row: Row
    law: SegmentsOf
    within: Expression | None = None
    range: Expression | Row | None = None


@dataclass(frozen=True)
class Phase:
    """A part of each forcing period: from ``start``, a share of 2 pi / omega after the section, to that of the next.

    What it names takes the place of the entry of the whole machine while it lasts: force and cosine those of the first
    harmonic of order 1, with the same phase angles.
    """

    start: Expression
    stiffness: Matrix | None = None
    damping: Matrix | None = None
    force: Row | None = None
    load: Row | None = None
    cosine: Row | None = None
    contacts: Changes = ()
    friction: Changes = ()


ALWAYS = (Phase(Expression("0.0")),)
"""The only phase of a machine that has none."""


def in_phase(element: Contact | Friction, changes: Changes, key: str) -> Expression | None:
    """A constant of an element where a phase makes these changes."""
    changed = dict(dict(changes).get(element.name, ()))
    return changed[key] if key in changed else getattr(element, key)


def pad(contact: Contact, changes: Changes) -> tuple[Expression | float, ...]:
    """Stiffness, damping and preload of a contact in a phase; zeros of a rigid one."""
    return tuple(in_phase(contact, changes, key) or 0.0 for key in PAD)


def rub(friction: Friction, changes: Changes) -> tuple[Expression | float, ...]:
    """Kinetic and static level and slope of friction in a phase; NaN for levels that its law says."""
    kinetic, static, slope = (in_phase(friction, changes, key) for key in RUB)
    return kinetic or math.nan, static or kinetic or math.nan, slope or 0.0


def stops(contact: Contact) -> tuple[Expression | float, Expression | float]:
    """The lower and the upper stop of a contact, at infinity where there is none."""
    lower = NO_STOP["lower"] if contact.lower is None else contact.lower
    return lower, NO_STOP["upper"] if contact.upper is None else contact.upper
