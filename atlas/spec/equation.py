"""The equation of motion of a system as text: as its author wrote it, or generated from its definition."""

import re
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from atlas.formatting import plural
from workers.model.elements import Contact, Friction, Phase, Spring
from workers.model.expression import Expression, Row
from workers.model.force import Harmonic
from workers.model.laws import segments_of
from workers.model.system import System


def equation_of(system: System) -> str:
    """Return the equation of motion of a system as text: as its author wrote it, or generated from its definition.

    A generated text has a line for each coordinate, ``mass * x'' + damping * x' + stiffness * x = load + force``,
    without zero terms. Then follow omega if it is not a parameter, and the forcing period if it is not 2 pi / omega.
    The last lines are the stops, the impact law, friction, phases, the drifting coordinate and the names in
    expressions.
    """
    if system.equation.strip():
        return system.equation
    machine = system.definition
    defaults = {p.name: np.array([p.default]) for p in system.parameters}
    counts = {id(element): segments_of(element, table) for _, element, (table,) in machine.laws(defaults)}
    matrices = ((machine.mass, "''"), (machine.damping, "'"), (machine.stiffness, ""))
    lines = []
    for i in range(len(machine.coordinates)):
        left = [
            (entry, f"{x}{primes}")
            for matrix, primes in matrices
            for entry, x in zip(matrix[i], machine.coordinates, strict=True)
        ]
        right = [(machine.load[i], ""), *(part for harmonic in machine.harmonics for part in _harmonic(harmonic, i))]
        lines.append(f"{_sum(left)} = {_sum(right)}")
    if machine.period:
        period = _number(machine.period)
        lines.append(f"omega = 2 pi / {period if period.isidentifier() else f'({period})'}")
    if machine.turns > 1:
        lines.append(f"forcing period {2 * machine.turns} pi / omega")
    for contact in machine.contacts:
        lines += _contact(contact, machine.coordinates, counts)
    for friction in machine.friction:
        v = _sum(zip(friction.row, machine.velocities, strict=True))
        v += "" if friction.belt.constant == 0.0 else f" - {_factor(friction.belt)}"
        level = _level(friction, counts)
        if friction.law_back is not None:
            level = f"{level} forward, {_law(friction.back, counts)} backward,"
        static = "" if friction.static is None else f", {_number(friction.static)} at rest"
        lines.append(f"friction {friction.name}: {level} against {v if v == 'v' else f'v = {v}'}{static}")
    for phase in machine.phases:
        changed = ", ".join(_changes(phase))
        if changed:
            lines.append(f"from {_number(phase.start)} of the period on: {changed}")
    if machine.within is not None:
        bound = f"{machine.pieces // 2} steps, within {machine.within:g}"
        lines.append(f"phase from 0 to 2 pi in the forcing period, from the section on: {bound}")
    for spring in machine.springs:
        y = _sum(zip(spring.row, machine.coordinates, strict=True))
        lines.append(f"spring {spring.name} on y = {y}: pulls back by {_law(spring, counts)}")
    if machine.drift:
        lines.append(f"{machine.drift} may drift")
    return "\n".join(lines + [f"{name} = {_number(value)}" for name, value in machine.let])


def _contact(contact: Contact, coordinates: tuple[str, ...], counts: Mapping[int, int]) -> list[str]:
    """Return lines of text about a contact: its coordinate, the range between its stops, and its law beyond them."""
    gap = _sum(zip(contact.gap, coordinates, strict=True))
    name = gap if gap in coordinates else "gap"
    if not contact.stops:
        return ["no stop"]
    lines = [] if name == gap else [f"gap = {gap}"]
    ends = [name if stop is None else _number(stop) for stop in (contact.lower, contact.upper)]
    lines.append(" <= ".join([ends[0], name, ends[1]] if name not in ends else ends))
    if contact.restitution is not None:
        return [*lines, f"at a stop {name}' -> -{_factor(contact.restitution)} * {name}'"]
    force = [(contact.preload, ""), (contact.stiffness, "d"), (contact.damping, "d'")]
    known = _sum([(coefficient, of) for coefficient, of in force if coefficient is not None])
    if contact.law is not None:
        known = _law(contact, counts) + ("" if known == "0" else f" + {known}")
    until = ", as long as that pushes" if contact.release == "force" else ""
    return [*lines, f"beyond a stop by d: the force {known} back{until}"]


def _changes(phase: Phase) -> Iterator[str]:
    """Yield a text for each entry of the machine's definition that a phase of the forcing period replaces."""
    for key in ("stiffness", "damping"):
        if (matrix := getattr(phase, key)) is not None:
            yield f"{key} ({', '.join(map(_row, matrix)) if len(matrix) > 1 else _number(matrix[0][0])})"
    for name, constants in (*phase.contacts, *phase.friction):
        yield from (f"{key} of {name} = {_number(value)}" for key, value in constants)
    for key in ("force", "cosine", "load"):
        if (row := getattr(phase, key)) is not None:
            yield f"{key} {_row(row)}"


def _row(row: Row) -> str:
    return f"({', '.join(map(_number, row))})"


def _level(friction: Friction, counts: Mapping[int, int]) -> str:
    """Return the force of sliding friction, as a text with a law or constants."""
    if friction.law is not None:
        return _law(friction, counts)
    return _sum([(friction.kinetic, ""), (friction.slope, "|v|")])


def _law(element: Contact | Friction | Spring, counts: Mapping[int, int]) -> str:
    """Return the law of an element as text: its expression, or its first and last point and the number of segments."""
    law, count = element.law, counts.get(id(element))
    if isinstance(law, Expression):
        assert element.within is not None
        return f"{_number(law)} ({count} segments at the defaults, within {_number(element.within)} of the largest)"
    assert law is not None
    first, last = (f"({', '.join(map(_number, law[i]))})" for i in (0, -1))
    return f"{plural(len(law) - 1 if count is None else count, 'segment')} from {first} to {last}"


def _harmonic(harmonic: Harmonic, i: int) -> list[tuple[Expression, str]]:
    """Return the terms of one harmonic of the force on coordinate i, as pairs of an amplitude and a text.

    The texts are sin(order (omega t + tau) + phase) and its cosine.
    """
    angle = "omega t + tau" if harmonic.order == 1 else f"{harmonic.order} (omega t + tau)"
    phase = harmonic.phase[i]
    angle = angle if phase.constant == 0.0 else _sum([(None, angle), (phase, "")])
    return [(row[i], f"{of}({angle})") for row, of in ((harmonic.force, "sin"), (harmonic.cosine, "cos")) if row]


def _sum(terms: Iterable[tuple[Expression | None, str]]) -> str:
    """Return a sum of terms as text, each with its coefficient; a coefficient of None is 1, zero terms are omitted."""
    text = ""
    for coefficient, of in terms:
        if coefficient is not None and coefficient.constant == 0.0:
            continue
        term = of if coefficient is None else _term(coefficient, of)
        if not text:
            text = term
        elif term.startswith("-"):
            text += f" - {term[1:]}"
        else:
            text += f" + {term}"
    return text or "0"


def _term(coefficient: Expression, of: str) -> str:
    """Return a coefficient times ``of`` as text; the coefficient alone if ``of`` is empty."""
    if not of:
        return _factor(coefficient)
    if coefficient.constant in (1.0, -1.0):
        return of if coefficient.constant == 1.0 else f"-{of}"
    return f"{_factor(coefficient)} * {of}"


def _factor(expression: Expression) -> str:
    """Return an expression as text for a factor of a product, with parentheses around a sum."""
    text, outside = _number(expression), _number(expression)
    while "(" in outside:
        outside = re.sub(r"\([^()]*\)", "", outside)
    return f"({text})" if " + " in outside or " - " in outside else text


def _number(expression: Expression) -> str:
    """Return an expression in usual notation: whole numbers without a point, few spaces."""
    if expression.constant is not None:
        return f"{expression.constant:.12g}"
    text = re.sub(r"(?<![\w.])(\d+)\.0(?!\d)", r"\1", expression.text)
    text = re.sub(r"(^|[-+*/(,] )([-+]) (?=[^ ])", r"\1\2", text)  # a sign, not a difference
    text = re.sub(r"\b([A-Za-z_]\w*) \(", r"\1(", text)  # the call of a function
    return text.replace(" ** ", "**").replace("( ", "(").replace(" )", ")").replace(" ,", ",")
