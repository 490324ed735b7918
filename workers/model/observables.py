"""Observables: numbers such as the phase of each impact, which diagrams show in place of states.

An observable is written KIND, KIND:OF or, for impacts, KIND:CONTACT:SIDE, such as ``impact_phase:stop`` or
``maximum:gap``.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from workers.results import Variable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from workers.model.definition import Definition
    from workers.model.oscillator import Array

SECTION, IMPACT_PHASE, IMPACT_SPEED, MAXIMUM, MINIMUM, ENERGY_LOSS = KINDS = (
    "section", "impact_phase", "impact_speed", "maximum", "minimum", "energy_loss",
)  # fmt: skip
OF_IMPACTS, OF_OUTPUTS = (IMPACT_PHASE, IMPACT_SPEED), (SECTION, MAXIMUM, MINIMUM)
SIDES = {"upper": 1, "lower": -1}
GAP = "gap"
"""Name of the output that pictures show: the gap of the first contact, else the first coordinate."""

WORDS = {
    SECTION: "{} at the section", MAXIMUM: "local maxima of {}", MINIMUM: "local minima of {}",
    IMPACT_PHASE: "phase of the force at impacts{}", IMPACT_SPEED: "speed before impacts{}",
    ENERGY_LOSS: "energy lost in a forcing period",
}  # fmt: skip
FORMS = "impact_phase[:CONTACT][:SIDE], impact_speed[:CONTACT][:SIDE], maximum:OUTPUT, minimum:OUTPUT, " + (
    "section:OUTPUT, energy_loss"
)
"""All kinds of observables, in one line."""

VALUE = "value"
"""Dimension along the values of an observable, in the order of time."""


@dataclass(frozen=True)
class Observable:
    """An observable of a motion, with one value per event.

    kind     one of KINDS, see below
    of       name of the output, see ``outputs_of``, or of the contact; empty if there is none
    contact  index of the contact, -1 for all contacts
    side     +1 for the upper and -1 for the lower stop, 0 for both

    The kinds are:

    section       an output at each section t = k T
    impact_phase  omega t + tau modulo 2 pi, the phase of the force when a contact is reached, in [0, 2 pi)
    impact_speed  speed |y'| along the contact's row at that time, before the impact
    maximum       an output when it ceases to rise, at a turning point or at an impact
    minimum       an output when it ceases to fall, at a turning point or at an impact
    energy_loss   energy taken by contacts, friction and dampers in each forcing period

    A soft contact is reached at its stop.
    """

    kind: str
    of: str = ""
    contact: int = -1
    side: int = 0

    @classmethod
    def parse(cls, text: str, definition: "Definition") -> Self:
        """Return the observable named by a text, for a machine with this definition.

        Raise ValueError, in one line with the valid observables, if the machine has no such observable.
        """
        kind, *rest = text.split(":")
        if kind not in KINDS:
            raise ValueError(f"unknown observable {text!r}; possible: {FORMS}")
        if kind in OF_IMPACTS:
            return cls._of_impacts(kind, rest, text, definition)
        if kind == ENERGY_LOSS:
            if rest:
                raise ValueError(f"{text}: {ENERGY_LOSS} belongs to the whole machine, must be written {ENERGY_LOSS}")
            return cls(kind)
        known = outputs_of(definition)
        if len(rest) != 1 or rest[0] not in known:
            fault = f"unknown output {rest[0]!r}" if rest else "no output"
            raise ValueError(f"{text}: {fault}, must be {kind}: and one of {', '.join(known)}")
        return cls(kind, rest[0])

    @classmethod
    def _of_impacts(cls, kind: str, rest: list[str], text: str, definition: "Definition") -> Self:
        names = [contact.name for contact in definition.contacts]
        if not names:
            raise ValueError(f"{text}: this machine has no contact")
        remaining, contact, side = list(rest), -1, 0
        if remaining and remaining[0] in names:  # a contact may be named upper, too
            contact = names.index(remaining.pop(0))
        if remaining and remaining[0] in SIDES:
            side = SIDES[remaining.pop(0)]
        if remaining:
            raise ValueError(f"{text}: unknown contact {remaining[0]!r}; possible: {', '.join([*names, *SIDES])}")
        some = definition.contacts if contact < 0 else definition.contacts[contact : contact + 1]
        if side and all(getattr(contact, rest[-1]) is None for contact in some):
            raise ValueError(f"{text}: there is no {rest[-1]} stop")
        return cls(kind, "" if contact < 0 else names[contact], contact, side)

    @property
    def name(self) -> str:
        """Text form of the observable, which ``parse`` reads."""
        return ":".join(part for part in (self.kind, self.of, self._side) if part)

    @property
    def _side(self) -> str:
        return next((name for name, side in SIDES.items() if side == self.side), "")

    @property
    def unit(self) -> str:
        """CF unit of the values."""
        return "rad" if self.kind == IMPACT_PHASE else "1"

    @property
    def modulus(self) -> float:
        """Modulus of the values if they are angles, 2 pi; infinity for other values."""
        return 2.0 * math.pi if self.kind == IMPACT_PHASE else math.inf

    @property
    def words(self) -> str:
        """Description of the observable, in words for tables, axes and pages."""
        if self.kind in OF_IMPACTS:
            contact, stop = f" on {self.of}" if self.of else "", f" at the {self._side} stop" if self._side else ""
            return WORDS[self.kind].format(contact + stop)
        return WORDS[self.kind].format("the gap coordinate" if self.of == GAP else self.of)

    @property
    def variable(self) -> str:
        """Name of the result that holds the values."""
        return self.name.replace(":", "_")

    @property
    def number(self) -> str:
        """Name of the result that counts the values."""
        return f"{self.variable}_number"

    @property
    def variables(self) -> tuple[Variable, Variable]:
        """The results that hold the values, and that count them."""
        counted = f"how many values of {self.name} there are, also where fewer are kept; -1 where infinitely many"
        return (
            Variable(self.variable, "float64", float("nan"), self.words, self.unit, (VALUE,)),
            Variable(self.number, "int32", 0, counted, "1"),
        )

    def row(self, definition: "Definition", values: "Mapping[str, Array]") -> "tuple[Array, float]":
        """Return the weights (N, n) of the coordinates in the output, and the derivative on which they act.

        The derivative is an index in ORDERS. There are N machines with these parameters (N,). The weights are zero if
        the observable is no output.
        """
        n = len(definition.coordinates)
        gap = definition.picture_rows(values)
        if self.of == GAP:
            return gap, 0.0
        for order, names in enumerate((definition.coordinates, definition.velocities)):
            if self.kind in OF_OUTPUTS and self.of in names:
                return np.tile(np.eye(n)[names.index(self.of)], (len(gap), 1)), float(order)
        if self.kind in OF_OUTPUTS:
            rows, orders, _ = definition.outputs(values)
            index = [name for name, _ in definition.measures].index(self.of)
            return rows[:, index], float(orders[0, index])
        return np.zeros_like(gap), 0.0


def outputs_of(definition: "Definition") -> tuple[str, ...]:
    """Return the names of a machine's outputs: the gap coordinate, coordinates, velocities, and measures.

    A drifting coordinate is left out, since its position has no effect.
    """
    coordinates = [name for name in definition.coordinates if name != definition.drift]
    return tuple(dict.fromkeys((GAP, *coordinates, *definition.velocities, *(name for name, _ in definition.measures))))


def observables_of(names: str, definition: "Definition") -> tuple[Observable, ...]:
    """Return the observables of a text, separated by commas; raise ValueError if one is unknown or repeated."""
    observables = tuple(Observable.parse(text, definition) for text in names.split(",") if names)
    if len(set(observables)) < len(observables):
        raise ValueError(f"found {names!r}, must name each observable once")
    return observables
