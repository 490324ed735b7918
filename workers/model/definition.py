"""The definition of a system as expressions of its parameters, and its machines at given parameter values."""

import dataclasses
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from workers.model import laws
from workers.model.elements import ALWAYS, STOP, Contact, Friction, Phase, Spring, pad, rub, stops
from workers.model.expression import Expression, Matrix, Row, evaluate_entries
from workers.model.force import Harmonic, amplitudes, replace_first_harmonic, turns_of
from workers.model.free_flight import ULPS
from workers.model.machines import Machines
from workers.model.measures import ORDERS, Measures
from workers.model.natural_period import natural_frequency
from workers.model.oscillator import Array
from workers.model.parameter import OMEGA, PHASE, TAU
from workers.model.smooth import STEPS, gauss_angles, of_halves, starts_of_halves


@dataclass(frozen=True)
class Definition:
    """A linear oscillator with contacts and friction, every entry an expression of parameters:

        M x'' + C x' + K x = load + harmonics + contacts + friction

    let       pairs of a name and the expression that it stands for, each before the expressions that use it
    phases    parts of the forcing period with entries of their own
    drift     the coordinate that may drift, empty if there is none
    measures  outputs of which numbers are reported, by name
    period    the period 2 pi / omega; None if omega is a parameter
    within    error bound of coefficients that are expressions of PHASE; None if there are none
    steps     number of steps in each phase that replace them, see smooth.py; None if it is not known yet

    The force repeats after ``turns`` periods 2 pi / omega, so its machines have the frequency omega / turns. A machine
    without a force and phases has neither omega nor tau, see ``natural_period``. ``table`` writes the entries in the
    order of these fields; digests of stored curves depend on this order.
    """

    coordinates: tuple[str, ...]
    velocities: tuple[str, ...]
    mass: Matrix
    damping: Matrix
    stiffness: Matrix
    harmonics: tuple[Harmonic, ...]
    load: Row
    contacts: tuple[Contact, ...]
    let: tuple[tuple[str, Expression], ...]
    friction: tuple[Friction, ...] = ()
    phases: tuple[Phase, ...] = ()
    drift: str = ""
    measures: Measures = ()
    springs: tuple[Spring, ...] = ()
    period: Expression | None = None
    within: float | None = None
    steps: int | None = None

    @property
    def stop(self) -> Contact:
        """The only contact of a definition that has exactly one."""
        (contact,) = self.contacts
        return contact

    @property
    def unforced(self) -> bool:
        """True if there is neither a force nor a phase, so that motions do not depend on their starting time."""
        return not self.harmonics and not self.phases and self.within is None

    @property
    def pieces(self) -> int:
        """Number of phases of its machines in the place of each of its phases: two for each step."""
        return 1 if self.within is None else 2 * (self.steps or STEPS)

    @property
    def phase_count(self) -> int:
        """Number of phases of its machines, with all steps."""
        return len(self.phases or ALWAYS) * self.pieces

    @property
    def is_short_form(self) -> bool:
        """True if the only contact is rigid, named STOP, and written in [system] itself, without a table of its own."""
        return len(self.contacts) == 1 and self.stop.rigid and self.stop.name == STOP

    @property
    def picture_row(self) -> Row:
        """Weights of the coordinates in the displacement that pictures show.

        It is the gap of the first contact, or the first coordinate if there is no contact.
        """
        if self.contacts:
            return self.contacts[0].gap
        return tuple(Expression(repr(float(i == 0))) for i in range(len(self.coordinates)))

    @np.errstate(all="ignore")
    def picture_rows(self, values: Mapping[str, Array]) -> Array:
        """Return the weights ``picture_row`` as numbers (N, n), at values (N,) of each parameter."""
        return np.ascontiguousarray(evaluate_entries(self.picture_row, self._named(values))[: _count(values)])

    @np.errstate(all="ignore")
    def machines(self, values: Mapping[str, Array]) -> Machines:
        """Return the machines with all contacts, friction and phases at values (N,) of each parameter."""
        named, count, n = self._named(values), _count(values), len(self.coordinates)
        contacts, friction, phases = self.contacts, self.friction, self.phases or ALWAYS
        forces = [
            self._force(named, replace_first_harmonic(self.harmonics, phase.force, phase.cosine)) for phase in phases
        ]

        def table(entries: list[Any], *shape: int) -> Array:
            return evaluate_entries(entries, named).reshape(named[OMEGA].size, *shape)

        C, F, N = len(contacts), len(friction), named[OMEGA].size
        starts = table([*(phase.start for phase in phases), 1.0], len(phases) + 1)
        moments = [(phase, named) for phase in phases]
        if self.within is not None:
            many = {name: np.tile(value, self.pieces) for name, value in named.items()}
            angles = [gauss_angles(starts[:, p : p + 2], self.pieces // 2) for p in range(len(phases))]
            moments = [(phase, self._with_let(many | {PHASE: of})) for phase, of in zip(phases, angles, strict=True)]
            starts = starts_of_halves(starts, self.pieces // 2)

        def of_phases(entries: Callable[[Phase], Any], *shape: int, odd: bool = False) -> Array:
            fields = [evaluate_entries(entries(phase), at).reshape(at[OMEGA].size, *shape) for phase, at in moments]
            fields = [symmetrised(field) if shape == (n, n) else field for field in fields]
            field = np.concatenate([field.reshape(self.pieces, N, *shape) for field in fields]).swapaxes(0, 1)
            return field if self.within is None else of_halves(field, odd)

        pads = of_phases(lambda phase: tuple(pad(contact, phase.contacts) for contact in contacts), C, 3)
        rubs = of_phases(lambda phase: tuple(rub(element, phase.friction) for element in friction), F, 3)
        rubs = np.repeat(rubs[..., None, :], 2, axis=3)
        law, grip = [laws.none(N, 2)] * C, [laws.none(N, 2)] * F
        for c, contact in enumerate(contacts):
            if contact.law is not None:
                first, segments = laws.one_sided(laws.vertices(contact, named), falls=False)
                pads[:, :, c, 2], law[c] = first[:, None], np.stack([segments, segments], axis=1)
        for f, element in enumerate(friction):
            if element.law is not None:
                sides = [laws.one_sided(laws.vertices(of, named), falls=True) for of in (element.back, element)]
                grip[f] = laws.widened([segments for _, segments in sides], (N,))
                first = np.stack([level for level, _ in sides], axis=1)[:, None]
                rubs[:, :, f, :, 0] = first
                rubs[:, :, f, :, 1] = np.where(np.isnan(rubs[:, :, f, :, 1]), first, rubs[:, :, f, :, 1])
        machines = Machines(
            mass=symmetrised(evaluate_entries(self.mass, named)),
            damping=of_phases(lambda phase: phase.damping or self.damping, n, n),
            stiffness=of_phases(lambda phase: phase.stiffness or self.stiffness, n, n),
            load=of_phases(lambda phase: phase.load or self.load, n, odd=True),
            force_sin=np.stack([sines for sines, _ in forces], axis=1).repeat(self.pieces, axis=1),
            force_cos=np.stack([cosines for _, cosines in forces], axis=1).repeat(self.pieces, axis=1),
            omega=named[OMEGA] / self.turns,
            tau=named[TAU] / self.turns,
            starts=starts,
            row=table([contact.gap for contact in contacts], C, n),
            stops=table([stops(contact) for contact in contacts], C, 2),
            R=table([contact.restitution or 1.0 for contact in contacts], C),
            soft=table([float(not contact.rigid) for contact in contacts], C),
            by_force=table([float(contact.release == "force") for contact in contacts], C),
            contact_constants=pads,
            friction_rows=table([element.row for element in friction], F, n),
            belt=table([element.belt for element in friction], F),
            friction_constants=rubs,
            contact_laws=laws.widened(law, (N, 2)),
            friction_laws=laws.widened(grip, (N, 2)),
            counted=np.ones((N, C)),
            drift=np.full_like(named[OMEGA], self.coordinates.index(self.drift) if self.drift else -1),
        )
        for spring in self.springs:
            row = evaluate_entries(spring.row, named)
            machines = laws.sprung(machines, row, laws.two_sided(laws.vertices(spring, named)))
        return Machines(*(np.ascontiguousarray(field[:count]) for field in machines))

    def laws(self, values: Mapping[str, Array]) -> Iterator[tuple[str, Contact | Friction | Spring, Array]]:
        """Yield (entry, element, vertices) for each piecewise linear force law, at values (N,) of each parameter.

        entry     key of the law in the definition, for error messages
        element   contact, friction or spring with the law
        vertices  (N, V, 2) argument and force at the ends of the segments
        """
        named, count = self._named(values), _count(values)
        for kind in ("contacts", "friction", "springs"):
            for i, element in enumerate(getattr(self, kind)):
                if element.law is not None:
                    yield f"system.{kind}[{i}].law", element, laws.vertices(element, named, math.inf)[:count]
                if isinstance(element, Friction) and element.law_back is not None:
                    yield f"system.{kind}[{i}].law_back", element.back, laws.vertices(element.back, named)[:count]

    @property
    def fitted(self) -> tuple[Contact | Friction | Spring, ...]:
        """Contacts, friction and springs whose law is an expression, which the solver replaces by straight segments."""
        every: tuple[Contact | Friction | Spring, ...] = (*self.contacts, *self.friction, *self.springs)
        return tuple(element for element in every if isinstance(element.law, Expression))

    def law_use(
        self, element: Contact | Friction | Spring, values: Mapping[str, Array], low: Array, high: Array
    ) -> tuple[Array, Array]:
        """Return how far motions used the range of a law that is an expression, and the error bound of its segments.

        element    contact, friction or spring with the law
        values     values (N,) of each parameter
        low, high  (N,) least and greatest argument of the law during the motions

        The two results (N,) are those of ``laws.law_use``.
        """
        named = {name: value[: len(low)] for name, value in self._named(values).items()}
        return laws.law_use(element, named, low, high)

    @np.errstate(all="ignore")
    def outputs(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Return (rows, orders, weights) of the M measures, the outputs to report, at values (N,) of each parameter.

        rows     (N, M, n) weights of the coordinates in each output
        orders   (N, M) derivative of the displacements on which a row acts, as an index in ORDERS
        weights  (N, M) factor of the power of an output, NaN for an output without one
        """
        named, count, n = self._named(values), _count(values), len(self.coordinates)
        every = [measure for _, measure in self.measures]
        orders = np.tile([float(ORDERS.index(measure.kind)) for measure in every], (count, 1))
        rows = evaluate_entries([measure.row for measure in every], named).reshape(named[OMEGA].size, len(every), n)
        weights = evaluate_entries([measure.weight or np.nan for measure in every], named)
        return rows[:count], orders, weights.reshape(named[OMEGA].size, len(every))[:count]

    @np.errstate(all="ignore")
    def value(self, expression: Expression, values: Mapping[str, Array]) -> Array:
        """Return an expression of parameters and names in ``let`` at values (N,) of each parameter."""
        return expression(self._named(values))[: _count(values)]

    def frequency(self, values: Mapping[str, Array]) -> Array:
        """Return omega of a machine with a ``period``, at arrays of equal shape for the parameters of the period."""
        assert self.period is not None
        return np.asarray(2.0 * np.pi / self.period({OMEGA: next(iter(values.values()))} | dict(values)))

    def _named(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Return the values (N,) of all parameters and of all names in ``let``; a single value is doubled, N = 2.

        numpy computes powers of a single number differently, so its last bits would depend on the number of cells. A
        machine without a force has tau = 0 and its natural frequency as omega, unless they are given.
        """
        alone = _count(values) == 1
        named = {name: value.repeat(2) if alone else value for name, value in values.items()}
        clocked = self.unforced and OMEGA not in named
        if self.unforced:
            named = dict.fromkeys((OMEGA, TAU), np.zeros(2 if alone else _count(values))) | named
        if self.period:
            named[OMEGA] = self.frequency(named)
        if self.within is not None:
            named |= {PHASE: np.zeros_like(named[OMEGA])}
        named = self._with_let(named)
        if clocked:
            named[OMEGA] = natural_frequency(*(evaluate_entries(of, named) for of in (self.mass, self.stiffness)))
        return named

    def _with_let(self, named: Mapping[str, Array]) -> dict[str, Array]:
        """Return these values (N,) with the values of all names in ``let``."""
        values = dict(named)
        for name, expression in self.let:
            values[name] = expression(values)
        return values

    @property
    def used(self) -> set[str]:
        """Names of parameters and of expressions in ``let`` that the motion or a measure uses."""
        return self._used_outside("let")

    def _used_outside(self, *left_out: str) -> set[str]:
        """Return the names used in all fields except ``left_out``.

        Names in ``let`` are included if they are used, with the names in their expressions.
        """
        fields = (field.name for field in dataclasses.fields(self) if field.name not in left_out)
        names = set().union(*(_names(getattr(self, name)) for name in fields))
        for name, expression in reversed(self.let):
            names |= expression.names if name in names else set()
        return names | (self.period.names if self.period and OMEGA in names else set())

    def changes_with(self, names: Collection[str]) -> bool:
        """Return True if the machines, apart from forcing frequency and phase, depend on parameters of these names."""
        return not self._used_outside("let", "measures", "period").isdisjoint(names)

    @np.errstate(all="ignore")
    def forcing(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return frequency omega / turns and phase tau / turns (N,) of the whole force at values (N,) of parameters."""
        named, count = self._named(values), _count(values)
        return named[OMEGA][:count] / self.turns, named[TAU][:count] / self.turns

    @cached_property
    def turns(self) -> int:
        """Number of periods 2 pi / omega after which the whole force repeats: the period of the machine."""
        return turns_of(harmonic.order for harmonic in self.harmonics)

    @cached_property
    def highest(self) -> int:
        """Highest order of the force's harmonics, in multiples of the frequency omega / turns of the machine."""
        first = not self.harmonics or any(phase.force or phase.cosine for phase in self.phases)
        return int(self.turns * max([Fraction(first), *(harmonic.order for harmonic in self.harmonics)]))

    def _force(self, named: Mapping[str, Array], harmonics: Collection[Harmonic]) -> tuple[Array, Array]:
        """Return the force (N, H, n) of harmonics as amplitudes of the sines and of the cosines."""
        return amplitudes(harmonics, self.turns, self.highest, named, len(self.coordinates))

    def table(self) -> dict[str, Any]:
        """Return the definition as in a TOML file, in a normal form: equal definitions make equal tables."""
        table: dict[str, Any] = {}
        for name, entries in _written(self).items():
            short = name == "contacts" and self.is_short_form
            table |= {key: entry for key, entry in entries[0].items() if key != "name"} if short else {name: entries}
        return table


def symmetrised(matrices: Array) -> Array:
    """Return matrices (N, n, n) in which entries [i][k] and [k][i] that differ only by rounding are equal.

    The difference may be ULPS of the larger entry, or of sqrt([i][i] [k][k]), a bound in positive matrices.
    """
    other = matrices.swapaxes(1, 2)
    if np.array_equal(matrices, other):
        return matrices
    root = np.sqrt(np.abs(np.diagonal(matrices, axis1=1, axis2=2)))
    size = np.maximum(np.maximum(np.abs(matrices), np.abs(other)), root[:, :, None] * root[:, None, :])
    near = np.abs(matrices - other) <= ULPS * np.finfo(np.float64).eps * size
    return np.where(near & (matrices != other), 0.5 * matrices + 0.5 * other, matrices)


def _count(values: Mapping[str, Array]) -> int:
    """Return the number of machines at values (N,) of each parameter."""
    return next(iter(values.values())).size


def _names(entries: Any) -> set[str]:
    """Return the names used by an expression, or by all expressions in nested tuples, mappings and dataclasses."""
    if isinstance(entries, Expression):
        return entries.names
    if isinstance(entries, Mapping):
        entries = tuple(entries.values())
    elif dataclasses.is_dataclass(entries):
        entries = tuple(getattr(entries, field.name) for field in dataclasses.fields(entries))
    return set().union(*map(_names, entries)) if isinstance(entries, tuple) else set()


def _written(entries: Any) -> Any:
    """Return entries of a definition in the form of a TOML file.

    An entry is an expression, or a dataclass or tuple of expressions. A dataclass, or a tuple of pairs of a name and an
    entry, becomes a table. Empty entries of a dataclass are left out.
    """
    if isinstance(entries, Expression):
        return entries.text if entries.constant is None else entries.constant
    if isinstance(entries, Fraction):
        return int(entries) if entries.denominator == 1 else str(entries)
    if isinstance(entries, Harmonic):
        return {key: _written(of) for key, of in entries._asdict().items() if of != ()}
    if dataclasses.is_dataclass(entries):
        pairs = ((field.name, _written(getattr(entries, field.name))) for field in dataclasses.fields(entries))
        return {key: entry for key, entry in pairs if entry not in (None, "", [])}
    if not isinstance(entries, tuple):
        return entries
    if entries and all(isinstance(entry, tuple) and isinstance(entry[0], str) for entry in entries):
        return {name: _written(of) for name, of in entries}
    return [_written(entry) for entry in entries]
