"""Checks of a definition at the defaults of its parameters, so that impossible machines are rejected early."""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import chain

import numpy as np

from workers.model.block_decomposition import undamped_modes
from workers.model.definition import Definition
from workers.model.elements import ALWAYS, PAD, RUB, Changes, Contact, Friction, Phase, Spring
from workers.model.entries import DefinitionError
from workers.model.expression import Expression
from workers.model.free_flight import UNSEEN
from workers.model.hybrid_modes import ZERO_SHARE
from workers.model.laws import SEGMENTS, segments_of
from workers.model.machines import GREATEST_R, Machines, dependent, held_rows, yields
from workers.model.oscillator import Array
from workers.model.parameter import Parameter

OF_EXPRESSION = ", within above 0 and the range around 0"


def check_at_defaults(definition: Definition, parameters: Iterable[Parameter]) -> None:
    """Raise DefinitionError, in one line, unless the defaults make a valid machine.

    The period is above 0. M is invertible. Phases begin in order within the period. For contacts 0 <= R <= GREATEST_R;
    stiffness and preload are not negative, nor is the damping of a contact released by force; the lower stop is below
    the upper one. For friction 0 <= kinetic <= static. Rows, the weights of the coordinates at contacts and friction,
    are nonzero. They are independent if they can stick together, and a force along a row moves it that way. Contacts
    see every free motion, K x = 0, except the motion of a coordinate that may drift, which nothing ties down.
    """
    defaults = {p.name: np.array([p.default]) for p in parameters}
    if definition.period:
        omega, _ = definition.forcing(defaults)
        if not (omega[0] > 0.0 and np.isfinite(omega[0])):
            period = definition.value(definition.period, defaults)[0]
            raise DefinitionError(f"system.period: found {period:g} at the defaults, must be above 0 and finite")
    for where, element, tables in definition.laws(defaults):
        _check_law(where, element, tables[0])
    many = definition.machines(defaults)
    machine = Machines(*(field[0] for field in many))
    matrices = [("system.mass", machine.mass)]
    for key in ("damping", "stiffness"):
        matrices += [(_entry_in(definition, p, key), matrix) for p, matrix in enumerate(getattr(machine, key))]
    C = len(definition.contacts)
    rows = {f"{_contact(definition, c)}.gap": row for c, row in enumerate(machine.row[:C])}
    rows |= {f"system.springs[{s}].row": row for s, row in enumerate(machine.row[C:])}
    rows |= {f"system.friction[{f}].row": row for f, row in enumerate(machine.friction_rows)}
    constants = [*_constants(definition, machine)]
    for where, entries in chain(matrices, rows.items(), _forces(definition, machine), constants):
        if not np.isfinite(entries).all():
            raise DefinitionError(f"{where}: found {_shown(entries)} at the defaults, must be finite numbers")
    _check_measures(definition, definition.outputs(defaults))
    _check_mass(machine.mass)
    for where, number in constants:
        _check_constant(where, float(number))
    _check_damping(definition, machine)
    _check_static(definition, machine)
    _check_stops(definition, machine)
    _check_starts(machine.starts[:: definition.pieces])
    for where, row in rows.items():
        if not row.any():
            quantity = "y of the coordinates" if where.endswith("gap") else "the sliding velocity of the velocities"
            raise DefinitionError(f"{where}: found zeros only; give the row that makes {quantity}")
    _check_independent(list(rows), held_rows(many))
    _check_independent(list(rows)[len(machine.row) :], many.friction_rows)
    _check_yields(rows, many)
    for where, matrix in matrices:
        if where.endswith("stiffness"):
            _check_free_motions(definition, machine, where, matrix)


def _contact(definition: Definition, c: int) -> str:
    return "system" if definition.is_short_form else f"system.contacts[{c}]"


def _entry_in(definition: Definition, p: int, key: str) -> str:
    """Return the key of the definition that counts in phase p of the machine: that of its phase, or of the machine."""
    p //= definition.pieces
    overridden = definition.phases and getattr(definition.phases[p], key) is not None
    return f"system.phases[{p}].{key}" if overridden else f"system.{key}"


def _forces(definition: Definition, machine: Machines) -> Iterator[tuple[str, Array]]:
    """Yield (entry, values) for load and force of each phase; the entry is the key of the definition."""
    for p, load in enumerate(machine.load):
        yield _entry_in(definition, p, "load"), load
        where = _entry_in(definition, p, "force")
        for part in (machine.force_sin[p], machine.force_cos[p]):
            orders = (Fraction(k + 1, definition.turns) for k in range(len(part)))
            yield from ((f"{where} of order {order}", row) for order, row in zip(orders, part, strict=True))


def _constants(definition: Definition, machine: Machines) -> Iterator[tuple[str, Array]]:
    """Yield (entry, values) for each constant of contacts and friction, also in each phase; the entry is its key."""
    for c, contact in enumerate(definition.contacts):
        if contact.rigid:
            yield f"{_contact(definition, c)}.restitution", machine.R[c]
    for piece, (p, phase) in enumerate(_phases(definition)):
        for c, contact in enumerate(definition.contacts):
            for key, number in () if contact.rigid else zip(PAD, machine.contact_constants[piece, c], strict=True):
                yield _constant_in(phase.contacts, p, "contacts", contact.name, key, _contact(definition, c)), number
        for f, friction in enumerate(definition.friction):
            for key, number in zip(RUB, machine.friction_constants[piece, f, 1], strict=True):
                yield _constant_in(phase.friction, p, "friction", friction.name, key, f"system.friction[{f}]"), number
    for f, belt in enumerate(machine.belt):
        yield f"system.friction[{f}].belt", belt


def _phases(definition: Definition) -> list[tuple[int, Phase]]:
    """Return number and phase of the definition for each phase of its machines."""
    every = enumerate(definition.phases or ALWAYS)
    return [numbered for numbered in every for _ in range(definition.pieces)]


def _constant_in(changes: Changes, p: int, kind: str, name: str, key: str, entry: str) -> str:
    changed = key in dict(dict(changes).get(name, ()))
    return f"system.phases[{p}].{kind}.{name}.{key}" if changed else f"{entry}.{key}"


def _check_constant(where: str, number: float) -> None:
    key = where.rpartition(".")[2]
    if key == "restitution" and not 0.0 <= number <= GREATEST_R:
        raise DefinitionError(f"{where}: found {number:g} at the defaults, must be 0 to {GREATEST_R:g}")
    if key in ("stiffness", "preload", "kinetic") and number < 0.0:
        raise DefinitionError(f"{where}: found {number:g} at the defaults, must be 0 or more")


def _check_damping(definition: Definition, machine: Machines) -> None:
    for p, phase in enumerate(definition.phases or ALWAYS):
        for c, contact in enumerate(definition.contacts):
            damping = machine.contact_constants[p, c, 1]
            if contact.release == "force" and damping < 0.0:
                where = _constant_in(phase.contacts, p, "contacts", contact.name, "damping", f"system.contacts[{c}]")
                right = 'must be 0 or more with release = "force", or release = "displacement"'
                raise DefinitionError(f"{where}: found {damping:g} at the defaults, {right}")


def _check_static(definition: Definition, machine: Machines) -> None:
    for piece, (p, phase) in enumerate(_phases(definition)):
        for f, friction in enumerate(definition.friction):
            for kinetic, static, _ in machine.friction_constants[piece, f]:
                if static >= kinetic:
                    continue
                where = _constant_in(phase.friction, p, "friction", friction.name, "static", f"system.friction[{f}]")
                levels = f"found {static:g}, kinetic {kinetic:g} at the defaults"
                raise DefinitionError(f"{where}: {levels}, must not be below kinetic")


def _check_law(where: str, element: Contact | Friction | Spring, table: Array) -> None:
    """Raise DefinitionError unless the vertices ``table`` (V, 2) of an element's law are valid."""
    if not np.isfinite(table).all():
        description = "no bound or value" if isinstance(element.law, Expression) else _shown(table)
        raise DefinitionError(
            f"{where}: found {description} at the defaults, must be finite numbers"
            + OF_EXPRESSION * (description[0] == "n")
        )
    if (n := segments_of(element, table)) > SEGMENTS:
        assert element.within is not None
        enough = 1.1 * (len(table) - 1) ** 2 / SEGMENTS**2  # the number of segments falls as the root of the bound
        right = (
            "a larger within" if element.within.constant is None else f"within = {enough * element.within.constant:.2g}"
        )
        raise DefinitionError(f"{where}: takes {n} segments at the defaults, must be at most {SEGMENTS}; give {right}")
    (x, F), argument = table.T, {Contact: "depth", Friction: "|v|", Spring: "y"}[type(element)]
    for i in range(len(x) - 1):
        if not x[i] < x[i + 1]:
            raise DefinitionError(
                f"{where}: found {argument} {x[i + 1]:g} after {x[i]:g} at the defaults, must increase"
            )
        if isinstance(element, Contact) and F[i + 1] < F[i]:
            raise DefinitionError(
                f"{where}: found a fall from {F[i]:g} to {F[i + 1]:g} at the defaults, up to depth {x[i + 1]:g}; a "
                "contact's law must not fall; that of a spring may, see [[system.springs]]"
            )
    if isinstance(element, Spring):
        return
    if x[0] != 0.0:
        raise DefinitionError(f"{where}: found {argument} {x[0]:g} in the first row at the defaults, must be 0")
    if not np.all(F >= 0.0):
        raise DefinitionError(f"{where}: found force {np.min(F):g} at the defaults, must be 0 or more")
    if F[-1] < F[-2]:
        raise DefinitionError(
            f"{where}: falls without end from {argument} {x[-2]:g} on at the defaults; "
            "repeat the last force in one more row"
        )


def _check_measures(definition: Definition, outputs: tuple[Array, Array, Array]) -> None:
    (rows,), _, (weights,) = outputs
    for (name, measure), row, weight in zip(definition.measures, rows, weights, strict=True):
        for key, numbers in ((measure.kind, row), ("weight", weight)):
            if getattr(measure, key) is not None and not np.isfinite(numbers).all():
                raise DefinitionError(
                    f"system.measures.{name}.{key}: found {_shown(numbers)} at the defaults, must be finite numbers"
                )
        if definition.drift and measure.displacement and row[definition.coordinates.index(definition.drift)] != 0.0:
            raise DefinitionError(
                f"system.measures.{name}.displacement: found {definition.drift}, which drifts; "
                "its advance is drift_per_period"
            )
        if not row.any():
            raise DefinitionError(
                f"system.measures.{name}.{measure.kind}: found zeros only; give the row of the measured output"
            )


def _check_stops(definition: Definition, machine: Machines) -> None:
    for c, (lower, upper) in enumerate(machine.stops[: len(definition.contacts)]):
        if not lower < upper:
            raise DefinitionError(
                f"{_contact(definition, c)}.upper: found {upper:g}, lower {lower:g} at the defaults, "
                "must be above lower; stops are positions of the gap coordinate"
            )


def _check_starts(starts: Array) -> None:
    for p in range(1, len(starts) - 1):
        if not starts[p - 1] < starts[p] < 1.0:
            raise DefinitionError(
                f"system.phases[{p}].start: found {starts[p]:g} after {starts[p - 1]:g} at the defaults, "
                "must rise and stay below 1; it is a share of the forcing period"
            )


def _check_independent(named: list[str], rows: Array) -> None:
    """Raise DefinitionError if rows, weights of coordinates that can stick together, are linearly dependent.

    named  keys of the definition that give the rows
    rows   (1, R, n) rows of rigid contacts and friction, zeros for other elements
    """
    for k, where in enumerate(named):
        if dependent(rows[:, : k + 1])[0]:
            raise DefinitionError(
                f"{where}: found {_shown(rows[0, k])} at the defaults, depends on rows of rigid contacts and friction "
                "before it; must be independent, or friction on the row of a contact or a multiple of it"
            )


def _check_mass(mass: Array) -> None:
    size = np.abs(mass).max(axis=1, keepdims=True)
    values = np.linalg.svd(mass / np.where(size > 0.0, size, 1.0), compute_uv=False)
    if not values[-1] > ZERO_SHARE * values[0]:
        raise DefinitionError(f"system.mass: found {_shown(mass)} at the defaults, is singular; must have an inverse")


def _check_yields(rows: dict[str, Array], many: Machines) -> None:
    if yields(many)[0]:
        return
    for where, row in rows.items():
        along = float(row @ np.linalg.solve(many.mass[0], row))
        if not along > 0.0:
            raise DefinitionError(
                f"{where}: found {_shown(row)} at the defaults, g.M^-1 g = {along:g}; must be above 0, so that a force "
                "along the row moves it that way"
            )
    raise DefinitionError(
        f"system.mass: found {_shown(many.mass[0])} at the defaults, with rows of rigid contacts and friction G; "
        "the principal minors of G M^-1 G' must be above 0, so that a force along a row moves it that way while others "
        "are held"
    )


def _check_free_motions(definition: Definition, machine: Machines, where: str, stiffness: Array) -> None:
    """Raise DefinitionError unless each free motion, K x = 0, changes a gap or is that of the drifting coordinate.

    ``stiffness`` (n, n) is K, and ``where`` its key in the definition. Two motions that change the same gap combine to
    a motion that leaves the gap unchanged.
    """
    with np.errstate(all="ignore"):
        free, over_mass = _free_motions(machine.mass, stiffness)
    if not np.isfinite(over_mass).all():
        raise DefinitionError(
            f"system.mass: found {_shown(machine.mass)} at the defaults, with stiffness {_shown(stiffness)}, "
            "must be large enough that stiffness over mass is within double precision"
        )
    rows = machine.row
    if definition.drift:
        i = definition.coordinates.index(definition.drift)
        for what, entries in ((where, stiffness[i]), ("the gap row of a contact", rows[:, i])):
            if entries.any():
                raise DefinitionError(
                    f"system.drift: {what} ties {definition.drift} down at the defaults; leave out this entry or drift"
                )
        rows = np.concatenate([rows, np.eye(len(stiffness))[[i]]])
    rows = rows / np.abs(rows).max(axis=1, keepdims=True)  # whose squares might overflow
    most = np.sqrt(np.vecdot(rows, np.linalg.solve(machine.mass, rows.T).T))  # of a mode in each row
    seen = (rows @ free) / np.where(most > 0.0, most, 1.0)[:, None]
    if free.shape[1] and np.linalg.matrix_rank(seen, tol=UNSEEN) < free.shape[1]:
        others = "" if definition.is_short_form else ", or let one coordinate drift: drift = NAME"
        raise DefinitionError(
            f"{where}: leaves a free motion that the gap does not see; tie it down by a spring, or take the "
            f"relative displacement as the coordinate{others}"
        )


def _free_motions(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Return the null space of K, in columns, and M^-1 K or, for symmetric matrices, the undamped modes."""
    even = all(np.array_equal(of, of.T) for of in (mass, stiffness))
    squares, modes = (of[0] for of in undamped_modes(mass[None], stiffness[None]))
    if even and np.isfinite(modes).all():
        return modes[:, np.abs(squares) <= ZERO_SHARE * max(float(np.max(np.abs(squares))), 1e-300)], modes
    over_mass: Array = np.asarray(np.linalg.solve(mass, stiffness), np.float64)
    if not np.isfinite(over_mass).all():
        return over_mass, over_mass
    _, values, turned = np.linalg.svd(over_mass)
    return np.asarray(turned[values <= ZERO_SHARE * max(float(values[0]), 1e-300)].T, np.float64), over_mass


def _shown(entries: Array) -> str:
    return str(np.asarray(entries).tolist())
