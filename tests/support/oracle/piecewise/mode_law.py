"""The law of motion in one mode: a linear system in displacements and velocities, and the guards that end it.

A state is z = (x, v, sin(h omega t) and cos(h omega t) for each force, 1). Constraints (a coordinate held on a rigid
stop, friction that sticks) are algebraic: M v' = F + G^T L with G v' = 0, so L = -(G M^-1 G^T)^-1 G M^-1 F.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpmath import mp

from tests.support.oracle.linear import LinearSystem, Number, Row
from tests.support.oracle.piecewise.machine import PiecewiseContact, PiecewiseMachine, Rows, Vector

RESTS = ("held", "edge")
"""States of contacts that hold their row in place."""


@dataclass(frozen=True)
class PiecewiseMode:
    """The phase and the state of each contact and each friction element.

    Contacts: "open"; "held" (rigid), "engaged", "detached" or "edge" (soft), followed by the side, "+" or "-". On its
    edge a preloaded stop pushes with less than its preload, and nothing moves.
    Friction: "slip+", "slip-" or "stick".
    """

    phase: int
    contacts: tuple[str, ...]
    friction: tuple[str, ...]

    def contact(self, index: int, state: str) -> "PiecewiseMode":
        """This mode with another state of one contact."""
        return replace(self, contacts=(*self.contacts[:index], state, *self.contacts[index + 1 :]))

    def rub(self, index: int, state: str) -> "PiecewiseMode":
        """This mode with another state of one friction element."""
        return replace(self, friction=(*self.friction[:index], state, *self.friction[index + 1 :]))


@dataclass(frozen=True)
class Guard:
    """A functional of z: when it rises through zero, ``kind`` happens to element ``index`` (on ``side``)."""

    kind: str
    index: int
    functional: Row
    side: int = 0


@dataclass(frozen=True)
class ModeLaw:
    """``system`` moves z; ``pressure`` holds the constraint forces by ("contact" or "friction", index)."""

    system: LinearSystem
    guards: tuple[Guard, ...]
    pressure: dict[tuple[str, int], Row]


class ModeLaws:
    """The laws of a machine in the current working precision, each made when its mode is first entered."""

    def __init__(self, machine: PiecewiseMachine) -> None:
        self.machine = machine
        self.machines = [machine.during(phase) for phase in machine.phases]
        self.n = machine.n
        self.omega = mp.mpf(machine.omega)
        self.period = 2 * mp.pi / self.omega
        self.inverse = mp.inverse(_matrix(machine.mass))
        self.orders = sorted({force.order for machine in self.machines for force in machine.forces})
        self.size = 2 * self.n + 2 * len(self.orders) + 1
        self._laws: dict[PiecewiseMode, ModeLaw] = {}

    def law(self, mode: PiecewiseMode) -> ModeLaw:
        """The law in a mode."""
        if mode not in self._laws:
            self._laws[mode] = self._make(mode)
        return self._laws[mode]

    def drive(self, time: Number) -> list[Number]:
        """The part of z decided by time alone."""
        angle = self.omega * time
        return [f(h * angle) for h in self.orders for f in (mp.sin, mp.cos)] + [mp.one]

    def kick(self, row: Vector) -> list[Number]:
        """M^-1 row / (row M^-1 row): the change of velocities that changes row.v by one with least work."""
        column = _column(row)
        kick = self.inverse * column
        return list(kick / (column.T * kick)[0])

    def position(self, row: Vector, offset: Number = 0, sign: int = 1) -> Row:
        """sign (row.x - offset) as a functional."""
        return self._output(row, 0, offset, sign)

    def velocity(self, row: Vector, offset: Number = 0, sign: int = 1) -> Row:
        """sign (row.v - offset) as a functional."""
        return self._output(row, self.n, offset, sign)

    def push(self, contact: PiecewiseContact, side: int) -> Row:
        """The force of a soft contact away from the stop of a side."""
        depth = self.position(contact.row, contact.stops[side], side)
        rate = self.velocity(contact.row, 0, side)
        spring = _sum([(mp.mpf(contact.stiffness), depth), (mp.mpf(contact.damping), rate)])
        return self._less(spring, -mp.mpf(contact.preload))

    def rubbing(self, mode: PiecewiseMode, i: int, z: Sequence[Number]) -> str:
        """State of friction element i at v_r = 0: stick if static friction can hold it, else slip."""
        if self.twin(mode, i) is not None:
            return "stick"
        needed = value_of(self.law(mode.rub(i, "stick")).pressure["friction", i], z)
        if abs(needed) <= mp.mpf(self.machines[mode.phase].friction[i].static):
            return "stick"
        return "slip-" if needed > 0 else "slip+"

    def resting(self, mode: PiecewiseMode, i: int, side: int, z: Sequence[Number]) -> PiecewiseMode | None:
        """The mode in which contact i rests on a stop, with row.x at rest, or None if it would leave."""
        contact = self.machines[mode.phase].contacts[i]
        rigid = contact.restitution is not None
        rests = mode.contact(i, named("held" if rigid else "edge", side))
        for k, friction in enumerate(self.machine.friction):
            if self.twin(rests, k) == i and friction.belt == 0:
                rests = rests.rub(k, "stick")
        ends = [g for g in self.law(rests).guards if g.kind in ("leave", "sink") and g.index == i]
        return None if any(value_of(g.functional, z) >= 0 for g in ends) else rests

    def moving(self, mode: PiecewiseMode, i: int, side: int, direction: int) -> PiecewiseMode:
        """The mode with contact i open and moving in a direction: friction on its row acts against that."""
        rests = mode.contact(i, named("held", side))
        for k, friction in enumerate(self.machine.friction):
            if self.twin(rests, k) == i and friction.belt == 0:
                mode = mode.rub(k, named("slip", direction if self._scale(k, i) > 0 else -direction))
        return mode.contact(i, "open")

    def twin(self, mode: PiecewiseMode, friction: int) -> int | None:
        """The contact at rest whose row is parallel to that of a friction element, or None."""
        row = np.array(self.machine.friction[friction].row, dtype=float)
        for index, state in enumerate(mode.contacts):
            gap = np.array(self.machine.contacts[index].row, dtype=float)
            if state[:-1] in RESTS and np.linalg.matrix_rank([row, gap]) == 1:
                return index
        return None

    def _scale(self, friction: int, contact: int) -> Number:
        """The number c of parallel rows: friction row = c contact row."""
        a, b = (list(map(mp.mpf, e.row)) for e in (self.machine.friction[friction], self.machine.contacts[contact]))
        return mp.fdot(a, b) / mp.fdot(b, b)

    def _output(self, row: Vector, first: int, offset: Number, sign: int) -> Row:
        functional = {first + j: sign * mp.mpf(entry) for j, entry in enumerate(row) if entry != 0}
        if offset != 0:
            functional[self.size - 1] = -sign * mp.mpf(offset)
        return functional

    def _make(self, mode: PiecewiseMode) -> ModeLaw:
        n = self.n
        constraints, rows = self._constraints(mode)
        F = self._forces(mode)
        accelerations = self.inverse * F
        pressure: dict[tuple[str, int], Row] = {}
        if rows:
            G = _matrix(rows)
            L = -mp.inverse(G * self.inverse * G.T) * G * accelerations
            accelerations += self.inverse * G.T * L
            pressure = {key: _row(L, i) for i, key in enumerate(constraints)}
        system: list[Row] = [{n + i: mp.one} for i in range(n)]
        system += [_row(accelerations, i) for i in range(n)]
        for k, h in enumerate(self.orders):
            sine = 2 * n + 2 * k
            system += [{sine + 1: h * self.omega}, {sine: -h * self.omega}]
        system.append({})
        weights = self._weights(system)
        return ModeLaw(LinearSystem.of(system, weights), tuple(self._guards(mode, pressure)), pressure)

    def _weights(self, system: Sequence[Row]) -> list[Number]:
        """Weights in whose norm the system stretches by about its fastest rate."""
        n = self.n
        rows = system[n : 2 * n]
        stiffness = max(sum((abs(a) for j, a in row.items() if j < n), mp.zero) for row in rows)
        felt = max((abs(a) for row in rows for j, a in row.items() if j >= 2 * n), default=mp.zero)
        rate = max(mp.sqrt(stiffness), self.omega)
        drive = max(10 * (self.size - 2 * n) * felt / rate**2, mp.one)
        return [mp.one] * n + [1 / rate] * n + [drive] * (self.size - 2 * n)

    def _forces(self, mode: PiecewiseMode) -> Any:
        """F (n, size): the forces on the coordinates as functionals of z, without those of constraints."""
        machine, n = self.machines[mode.phase], self.n
        F = mp.zeros(n, self.size)
        F[:, :n] = -_matrix(machine.stiffness)
        F[:, n : 2 * n] = -_matrix(machine.damping)
        for force in machine.forces:
            at = 2 * n + 2 * self.orders.index(force.order)
            for i in range(n):
                F[i, at] += mp.mpf(force.sin[i])
                F[i, at + 1] += mp.mpf(force.cos[i])
        for i, load in enumerate(machine.load):
            F[i, self.size - 1] += mp.mpf(load)
        pushes: list[tuple[Vector, Row]] = []
        for contact, state in zip(machine.contacts, mode.contacts, strict=True):
            if state[:-1] == "engaged":
                side = side_of(state)
                pushes.append((contact.row, _sum([(mp.mpf(-side), self.push(contact, side))])))
        for friction, state in zip(machine.friction, mode.friction, strict=True):
            if state != "stick":
                sliding = _sum([(-mp.mpf(friction.slope), self.velocity(friction.row, friction.belt))])
                sliding = self._less(sliding, side_of(state) * mp.mpf(friction.kinetic))
                pushes.append((friction.row, sliding))
        for row, push in pushes:
            for i, entry in enumerate(row):
                for j, value in push.items():
                    F[i, j] += mp.mpf(entry) * value
        return F

    def _constraints(self, mode: PiecewiseMode) -> tuple[list[tuple[str, int]], list[Vector]]:
        keys, rows = [], []
        for index, state in enumerate(mode.contacts):
            if state[:-1] in RESTS:
                keys.append(("contact", index))
                rows.append(self.machine.contacts[index].row)
        for index, state in enumerate(mode.friction):
            if state == "stick" and self.twin(mode, index) is None:
                keys.append(("friction", index))
                rows.append(self.machine.friction[index].row)
        return keys, rows

    def _guards(self, mode: PiecewiseMode, pressure: dict[tuple[str, int], Row]) -> Iterator[Guard]:
        machine = self.machines[mode.phase]
        for i, (contact, state) in enumerate(zip(machine.contacts, mode.contacts, strict=True)):
            side, doing = side_of(state), state[:-1]
            if state == "open":
                for end, stop in contact.stops.items():
                    yield Guard("reach", i, self.position(contact.row, stop, end), end)
            elif doing in RESTS:
                pull = _sum([(mp.mpf(side), pressure["contact", i])])
                yield Guard("leave", i, self._less(pull, self._held_back(mode, i)), side)
                if doing == "edge":
                    yield Guard("sink", i, self._less(_sum([(mp.mpf(-1), pull)]), contact.preload), side)
            else:
                yield Guard("open", i, self.position(contact.row, contact.stops[side], -side), side)
                push = self.push(contact, side)
                if contact.release == "force" and doing == "engaged":
                    yield Guard("detach", i, _sum([(mp.mpf(-1), push)]), side)
                elif doing == "detached":
                    yield Guard("engage", i, push, side)
        for i, (friction, state) in enumerate(zip(machine.friction, mode.friction, strict=True)):
            if state != "stick":
                yield Guard("stop", i, self.velocity(friction.row, friction.belt, -side_of(state)))
            elif ("friction", i) in pressure:
                for sign, kind in ((1, "slip-"), (-1, "slip+")):
                    needed = _sum([(mp.mpf(sign), pressure["friction", i])])
                    yield Guard(kind, i, self._less(needed, friction.static))

    def _less(self, functional: Row, number: Number) -> Row:
        return _sum([(mp.one, functional), (-mp.mpf(number), {self.size - 1: mp.one})])

    def _held_back(self, mode: PiecewiseMode, contact: int) -> Number:
        """The force along a contact's row that friction stuck on the same row can hold."""
        friction = self.machines[mode.phase].friction
        stuck = (k for k, state in enumerate(mode.friction) if state == "stick" and self.twin(mode, k) == contact)
        return mp.fsum(abs(self._scale(k, contact)) * mp.mpf(friction[k].static) for k in stuck)


def side_of(state: str) -> int:
    """+1 or -1, the last sign of a state's name."""
    return 1 if state.endswith("+") else -1


def named(state: str, side: int) -> str:
    """A state's name with its side or direction."""
    return state + ("+" if side > 0 else "-")


def value_of(functional: Row, z: Sequence[Number]) -> Number:
    """A functional's value."""
    return mp.fdot((entry, z[j]) for j, entry in functional.items())


def _sum(terms: Sequence[tuple[Number, Row]]) -> Row:
    result: Row = {}
    for factor, functional in terms:
        for j, entry in functional.items():
            result[j] = result.get(j, mp.zero) + factor * entry
    return result


def _row(matrix: Any, i: int) -> Row:
    return {j: matrix[i, j] for j in range(matrix.cols) if matrix[i, j] != 0}


def _column(values: Vector) -> Any:
    return mp.matrix([mp.mpf(value) for value in values])


def _matrix(rows: Rows) -> Any:
    return mp.matrix([[mp.mpf(value) for value in row] for row in rows])


__all__ = ["RESTS", "Guard", "ModeLaw", "ModeLaws", "PiecewiseMode", "named", "side_of", "value_of"]
