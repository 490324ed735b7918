"""The elements of a definition: contacts, friction, springs and phases."""

import math
from dataclasses import dataclass, replace

from workers.model.expression import Expression, Matrix, Row

STOP = "stop"
"""Name of the contact whose entries stand in the table [system] itself, not in a table of contacts."""

NO_STOP = {"upper": math.inf, "lower": -math.inf}

RELEASES = ("displacement", "force")
"""Release of a soft contact: at its stop, or at the point where its force would begin to pull."""

PAD = ("stiffness", "damping", "preload")
"""Constants of a soft contact's force that phases may change."""

RUB = ("kinetic", "static", "slope")
"""Constants of a friction force that phases may change."""

LAW = ("law", "within", "range")
"""Keys of a force law: the law, a table or an expression; then the error bound and the range of an expression."""

SegmentsOf = tuple[Row, ...] | Expression
"""A law as a table [[argument, force], ...] or as an expression of its argument."""

Changes = tuple[tuple[str, tuple[tuple[str, Expression], ...]], ...]
"""Constants changed by a phase: pairs of an element's name and of (name of the constant, expression) pairs."""


@dataclass(frozen=True)
class Contact:
    """A contact with one or two stops on y = gap . x, lower <= y <= upper; a stop that is None does not exist.

    A rigid contact has a restitution R and turns y' into -R y'. A soft contact has none. At depth delta >= 0 beyond its
    stop it pushes back along the row ``gap``, the weights of the coordinates, with the force preload + stiffness delta
    + damping delta'. Released by "displacement", it pushes while delta > 0, and its damping may be negative; released
    by "force", only while this force is positive. A law replaces preload + stiffness delta by law(delta), see laws.py.
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
        """True if the contact is rigid, which means that it has a coefficient of restitution."""
        return self.restitution is not None

    @property
    def stops(self) -> int:
        """Number of stops of the contact, 1 or 2."""
        return (self.upper is not None) + (self.lower is not None)


@dataclass(frozen=True)
class Friction:
    """Dry friction on the sliding velocity v = row . x' - belt.

    While sliding, friction resists with the force kinetic + slope |v| along ``row``, the weights of the velocities, or
    with law(|v|), see laws.py. It sticks, v = 0, while the force needed is at most ``static``, by default kinetic or
    law(0). With ``law_back`` v < 0 has a law, and by default a static level, of its own.
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
    law_back: tuple[Row, ...] | None = None

    @property
    def back(self) -> "Friction":
        """The same friction with the law for v < 0 as its law for both directions."""
        return self if self.law_back is None else replace(self, law=self.law_back, law_back=None)


@dataclass(frozen=True)
class Spring:
    """A spring on y = row . x that pulls back with the force law(y) at any y, see laws.py.

    ``row`` has the weights of the coordinates x, along which the force acts.
    """

    name: str
    row: Row
    law: SegmentsOf
    within: Expression | None = None
    range: Expression | Row | None = None


@dataclass(frozen=True)
class Phase:
    """A part of each forcing period, from ``start`` to the start of the next phase.

    ``start`` is a share of 2 pi / omega, counted from the section, the instants t = k T of the forcing period T. The
    entries of a phase replace those of the machine. The force and cosine of a phase replace those of the first harmonic
    of order 1, with the same phase angles.
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
"""The only phase of a machine without phases."""


def in_phase(element: Contact | Friction, changes: Changes, key: str) -> Expression | None:
    """Return an element's constant ``key`` in a phase that makes ``changes``; None if it has no such constant."""
    changed = dict(dict(changes).get(element.name, ()))
    return changed[key] if key in changed else getattr(element, key)


def pad(contact: Contact, changes: Changes) -> tuple[Expression | float, ...]:
    """Return stiffness, damping and preload of a contact in a phase that makes ``changes``; zeros if it is rigid."""
    return tuple(in_phase(contact, changes, key) or 0.0 for key in PAD)


def rub(friction: Friction, changes: Changes) -> tuple[Expression | float, ...]:
    """Return kinetic level, static level and slope of friction in a phase that makes ``changes``.

    Levels that are given by a force law are NaN.
    """
    kinetic, static, slope = (in_phase(friction, changes, key) for key in RUB)
    return kinetic or math.nan, static or kinetic or math.nan, slope or 0.0


def stops(contact: Contact) -> tuple[Expression | float, Expression | float]:
    """Return the lower and the upper stop of a contact, infinite if missing."""
    lower = NO_STOP["lower"] if contact.lower is None else contact.lower
    return lower, NO_STOP["upper"] if contact.upper is None else contact.upper
