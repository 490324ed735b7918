"""The definition of a system as expressions of its parameters, and the machines of given values."""

import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from workers.model import laws
from workers.model.clock import natural_frequency
from workers.model.elements import ALWAYS, STOP, Contact, Friction, Phase, Spring, pad, rub, stops
from workers.model.expression import Expression, Matrix, Row, evaluated
from workers.model.force import Harmonic, amplitudes, changed, turns_of
from workers.model.free import ULPS
from workers.model.hybrid_machines import HybridMachines
from workers.model.measures import ORDERS, Measures
from workers.model.oscillator import Array, Machines
from workers.model.parameter import OMEGA, TAU

MATRICES = ("mass", "damping", "stiffness")
OF_FORCE = ("force_sin", "force_cos")


@dataclass(frozen=True)
class Definition:
    """A linear oscillator with contacts and friction, every entry an expression of parameters:

        M x'' + C x' + K x = load + harmonics + contacts + friction

    The force repeats after ``turns`` periods 2 pi / omega: its machines have the frequency omega / turns. A machine
    without a force and phases has neither omega nor tau, see ``clock``.
    ``let`` are names for expressions that others may use, each after those it uses itself. ``phases`` are parts of the
    forcing period in which entries differ, ``drift`` is a coordinate that may drift, ``measures`` what is reported by
    name. Tables have the order of these fields, which digests of curves depend on.
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

    @property
    def stop(self) -> Contact:
        """The contact of a definition that has one: what ``machines`` are made of."""
        (contact,) = self.contacts
        return contact

    @property
    def unforced(self) -> bool:
        """Whether it declares neither a force nor phases: its motions begin at any time alike."""
        return not self.harmonics and not self.phases

    @property
    def short(self) -> bool:
        """Whether its contact is written as entries of the machine itself: one, rigid, named STOP."""
        return len(self.contacts) == 1 and self.stop.rigid and self.stop.name == STOP

    @property
    def shown(self) -> Row:
        """The row of the coordinate that pictures show: that of the first contact, else the first coordinate."""
        if self.contacts:
            return self.contacts[0].gap
        return tuple(Expression(repr(float(i == 0))) for i in range(len(self.coordinates)))

    @np.errstate(all="ignore")
    def shown_rows(self, values: Mapping[str, Array]) -> Array:
        """``shown`` (N, n) of many values (N,) of each parameter."""
        return np.ascontiguousarray(evaluated(self.shown, self._named(values))[: _count(values)])

    def machines(self, values: Mapping[str, Array]) -> Machines:
        """The machines of many values (N,) of each parameter."""
        return Machines(**self.fields(values, Machines._fields))

    @np.errstate(all="ignore")
    def fields(self, values: Mapping[str, Array], wanted: Collection[str]) -> dict[str, Array]:
        """These fields of the machines of many values (N,) of each parameter, by name."""
        named, count = self._named(values), _count(values)
        found = {name: evaluated(entries, named) for name, entries in self._entries.items() if name in wanted}
        found |= {name: symmetrised(found[name]) for name in MATRICES if name in wanted}
        if not set(OF_FORCE).isdisjoint(wanted):
            found |= zip(OF_FORCE, self._force(named, self.harmonics), strict=True)
        return {name: np.ascontiguousarray(field[:count]) for name, field in found.items()}

    @np.errstate(all="ignore")
    def hybrid(self, values: Mapping[str, Array]) -> HybridMachines:
        """The machines of many values (N,) of each parameter with all contacts, friction and phases."""
        named, count, n = self._named(values), _count(values), len(self.coordinates)
        contacts, friction, phases = self.contacts, self.friction, self.phases or ALWAYS
        forces = [self._force(named, changed(self.harmonics, phase.force, phase.cosine)) for phase in phases]

        def of_phases(key: str) -> list[Array]:
            return [evaluated(getattr(phase, key) or getattr(self, key), named) for phase in phases]

        def table(entries: list[Any], *shape: int) -> Array:
            return evaluated(entries, named).reshape(named[OMEGA].size, *shape)

        C, F, P, N = len(contacts), len(friction), len(phases), named[OMEGA].size
        pads = table([[pad(each, phase.contacts) for each in contacts] for phase in phases], P, C, 3)
        rubs = table([[rub(each, phase.friction) for each in friction] for phase in phases], P, F, 3)
        law, grip = [laws.none(N, 2)] * C, [laws.none(N)] * F
        for c, contact in enumerate(contacts):
            if contact.law is not None:
                first, found = laws.one_sided(laws.vertices(contact, named), falls=False)
                pads[:, :, c, 2], law[c] = first[:, None], np.stack([found, found], axis=1)
        for f, each in enumerate(friction):
            if each.law is not None:
                first, grip[f] = laws.one_sided(laws.vertices(each, named), falls=True)
                rubs[:, :, f, 0] = first[:, None]
                rubs[:, :, f, 1] = np.where(np.isnan(rubs[:, :, f, 1]), first[:, None], rubs[:, :, f, 1])
        machines = HybridMachines(
            mass=symmetrised(evaluated(self.mass, named)),
            damping=np.stack([symmetrised(each) for each in of_phases("damping")], axis=1),
            stiffness=np.stack([symmetrised(each) for each in of_phases("stiffness")], axis=1),
            load=np.stack(of_phases("load"), axis=1),
            force_sin=np.stack([sines for sines, _ in forces], axis=1),
            force_cos=np.stack([cosines for _, cosines in forces], axis=1),
            omega=named[OMEGA] / self.turns,
            tau=named[TAU] / self.turns,
            starts=table([*(each.start for each in phases), 1.0], P + 1),
            row=table([each.gap for each in contacts], C, n),
            stops=table([stops(each) for each in contacts], C, 2),
            R=table([each.restitution or 1.0 for each in contacts], C),
            soft=table([float(not each.rigid) for each in contacts], C),
            by_force=table([float(each.release == "force") for each in contacts], C),
            pad=pads,
            slide=table([each.row for each in friction], F, n),
            belt=table([each.belt for each in friction], F),
            rub=rubs,
            law=laws.widened(law, (N, 2)),
            grip=laws.widened(grip, (N,)),
            counted=np.ones((N, C)),
            drift=np.full_like(named[OMEGA], self.coordinates.index(self.drift) if self.drift else -1),
        )
        for spring in self.springs:
            row = evaluated(spring.row, named)
            machines = laws.sprung(machines, row, laws.two_sided(laws.vertices(spring, named)))
        return HybridMachines(*(np.ascontiguousarray(field[:count]) for field in machines))

    def laws(self, values: Mapping[str, Array]) -> Iterator[tuple[str, Contact | Friction | Spring, Array]]:
        """The entry of each law, whose it is, and its vertices (N, V, 2) of values (N,) of each parameter."""
        named, count = self._named(values), _count(values)
        for kind in ("contacts", "friction", "springs"):
            for i, element in enumerate(getattr(self, kind)):
                if element.law is not None:
                    yield f"system.{kind}[{i}].law", element, laws.vertices(element, named, math.inf)[:count]

    @np.errstate(all="ignore")
    def outputs(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Rows (N, M, n) of the measures for many values (N,) of each parameter, the derivatives (N, M) that these are
        rows on, by their place in ORDERS, and weights (N, M), NaN where there are none."""
        named, count, n = self._named(values), _count(values), len(self.coordinates)
        every = [measure for _, measure in self.measures]
        orders = np.tile([float(ORDERS.index(each.kind)) for each in every], (count, 1))
        rows = evaluated([each.row for each in every], named).reshape(named[OMEGA].size, len(every), n)
        weights = evaluated([each.weight or np.nan for each in every], named).reshape(named[OMEGA].size, len(every))
        return rows[:count], orders, weights[:count]

    def _named(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """These values (N,) and those of each name in ``let``; two alike in the place of a lone one.

        Of a lone number numpy computes a power by other means: its last bits would depend on the others' absence.
        """
        alone = _count(values) == 1
        named = {name: value.repeat(2) if alone else value for name, value in values.items()}
        clocked = self.unforced and OMEGA not in named
        if self.unforced:
            named = dict.fromkeys((OMEGA, TAU), np.zeros(2 if alone else _count(values))) | named
        for name, expression in self.let:
            named[name] = expression(named)
        if clocked:
            named[OMEGA] = natural_frequency(*(evaluated(of, named) for of in (self.mass, self.stiffness)))
        return named

    @property
    def used(self) -> set[str]:
        """The names that its motion, or a measure, takes; those of ``let`` whose own name is among them included."""
        found = set().union(
            *(_names(getattr(self, each.name)) for each in dataclasses.fields(self) if each.name != "let")
        )
        for name, expression in reversed(self.let):
            found |= expression.names if name in found else set()
        return found

    def depending(self, names: Collection[str]) -> frozenset[str]:
        """The fields of machines that depend on parameters of these names."""
        changing = set(names)
        for name, expression in self.let:
            if not expression.names.isdisjoint(changing):
                changing.add(name)
        entries = self._entries | dict.fromkeys(OF_FORCE, self.harmonics)
        return frozenset(field for field, of in entries.items() if not _names(of).isdisjoint(changing))

    @property
    def _entries(self) -> dict[str, Any]:
        """The expressions, or numbers, of each field of machines except the force."""
        lower, upper = stops(self.stop)
        return {
            **{name: getattr(self, name) for name in (*MATRICES, "load")},
            "gap_row": self.stop.gap, "upper": upper, "lower": lower, "R": self.stop.restitution,
            **{name: Expression(f"{name} / {float(self.turns)!r}") for name in (OMEGA, TAU)},
        }  # fmt: skip

    @cached_property
    def turns(self) -> int:
        """Periods 2 pi / omega of one period of the machine."""
        return turns_of(each.order for each in self.harmonics)

    @cached_property
    def highest(self) -> int:
        """The highest order of the force, as a multiple of the frequency omega / turns of the machine."""
        first = not self.harmonics or any(phase.force or phase.cosine for phase in self.phases)
        return int(self.turns * max([Fraction(first), *(each.order for each in self.harmonics)]))

    def _force(self, named: Mapping[str, Array], harmonics: Collection[Harmonic]) -> tuple[Array, Array]:
        """The force (N, H, n) of harmonics as amplitudes of the sines and of the cosines."""
        return amplitudes(harmonics, self.turns, self.highest, named, len(self.coordinates))

    def table(self) -> dict[str, Any]:
        """The definition as a TOML file has it, in one spelling of its own: equal definitions make equal tables."""
        found: dict[str, Any] = {}
        for name, entries in _written(self).items():
            short = name == "contacts" and self.short
            found |= {key: entry for key, entry in entries[0].items() if key != "name"} if short else {name: entries}
        return found


def symmetrised(matrices: Array) -> Array:
    """Matrices (N, n, n) with each pair of entries [i][k] and [k][i] made equal that differs by rounding alone.

    That is by at most ULPS of the larger one, or of sqrt([i][i] [k][k]), which bounds it in a matrix that is positive.
    """
    other = matrices.swapaxes(1, 2)
    if np.array_equal(matrices, other):
        return matrices
    root = np.sqrt(np.abs(np.diagonal(matrices, axis1=1, axis2=2)))
    size = np.maximum(np.maximum(np.abs(matrices), np.abs(other)), root[:, :, None] * root[:, None, :])
    near = np.abs(matrices - other) <= ULPS * np.finfo(np.float64).eps * size
    return np.where(near & (matrices != other), 0.5 * matrices + 0.5 * other, matrices)


def _count(values: Mapping[str, Array]) -> int:
    """How many machines values (N,) of each parameter are of."""
    return next(iter(values.values())).size


def _names(entries: Any) -> set[str]:
    """The names that these expressions use."""
    if isinstance(entries, Expression):
        return entries.names
    if isinstance(entries, Mapping):
        entries = tuple(entries.values())
    elif dataclasses.is_dataclass(entries):
        entries = tuple(getattr(entries, each.name) for each in dataclasses.fields(entries))
    return set().union(*map(_names, entries)) if isinstance(entries, tuple) else set()


def _written(entries: Any) -> Any:
    """Entries as a TOML file has them: records, and pairs of a name and an entry, are tables without what is empty."""
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
    if entries and all(isinstance(each, tuple) and isinstance(each[0], str) for each in entries):
        return {name: _written(of) for name, of in entries}
    return [_written(entry) for entry in entries]
