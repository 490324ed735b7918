"""Random machines with contacts, friction and phases, and states inside their stops, for comparing solvers."""

import numpy as np
from numpy.typing import NDArray

from tests.support.oracle.piecewise.machine import (
    HarmonicForce,
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewisePhase,
)

Array = NDArray[np.float64]
Generator = np.random.Generator


def random_machine(seed: int, *, switched_elements: bool = False, general: bool = False) -> PiecewiseMachine:
    """A damped machine of one to three masses with at least one contact, friction element or switch.

    Matrices are full as often as not. Forces (one to three harmonics) are scaled so that the answer without elements
    is about 1; stops are on either side or both of outputs within that reach, rigid and soft together. The rows of all
    elements are independent, except friction on a contact's row. The simulator raises ArithmeticError for a machine
    that hops on the edge of a preload; no seed below 900 does in four periods from ``random_state``.
    ``switched_elements``: phases may change the stiffness of soft contacts and kinetic friction too. ``general``: C and
    K are arbitrary, M is asymmetric in some draws, and friction may fall with speed faster than damping rises.
    """
    rng = np.random.default_rng([seed, 32 + 2 * general])
    n = int(rng.choice([1, 2, 3], p=[0.4, 0.4, 0.2]))
    mass = _positive(rng, n, 0.5, 2.0)
    stiffness = _positive(rng, n, 0.5, 8.0)
    damping = rng.uniform(0.02, 0.3) * mass + rng.uniform(0.0, 0.1) * stiffness
    if rng.random() < 0.5:
        damping += _positive(rng, n, 0.01, 0.3)
    if general:
        mass, damping, stiffness = _general(rng, mass, damping, stiffness)
    omega = float(rng.uniform(0.5, 3.0))
    orders = [1] if rng.random() < 0.6 else sorted(rng.choice([1, 2, 3], 2, replace=False).tolist())
    rows = _rows(rng, n)
    machine = PiecewiseMachine(
        mass=mass.tolist(),
        damping=damping.tolist(),
        stiffness=stiffness.tolist(),
        load=(rng.normal(size=n) * 0.3).tolist() if rng.random() < 0.4 else [0.0] * n,
        omega=omega,
        forces=_forces(rng, orders, mass, damping, stiffness, omega),
        contacts=_contacts(rng, rows),
        friction=_friction(rng, rows, least_slope=-0.4 if general else -0.01),
    )
    bare = not machine.contacts and not machine.friction
    return _with_phases(rng, machine, switched_elements) if bare or rng.random() < 0.4 else machine


def random_state(machine: PiecewiseMachine, seed: int) -> list[float]:
    """(x, v) with every contact open."""
    rng = np.random.default_rng([seed, 33])
    x = rng.normal(size=machine.n) * 0.2
    if machine.contacts:
        G = np.array([contact.row for contact in machine.contacts], dtype=float)
        inside = np.array([_inside(rng, contact) for contact in machine.contacts])
        x += np.linalg.pinv(G) @ (inside - G @ x)
    return [*x.tolist(), *(rng.normal(size=machine.n) * 0.3).tolist()]


def _positive(rng: Generator, n: int, low: float, high: float) -> Array:
    """A symmetric matrix with eigenvalues between two bounds, diagonal in half of the draws."""
    values = rng.uniform(low, high, n)
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0] if rng.random() < 0.5 else np.eye(n)
    matrix: Array = axes @ np.diag(values) @ axes.T
    return (matrix + matrix.T) / 2


def _general(rng: Generator, mass: Array, damping: Array, stiffness: Array) -> tuple[Array, Array, Array]:
    """The matrices with a gyroscopic, a circulatory, a negative part, or several of them."""
    n = len(mass)

    def skew(size: float) -> Array:
        part: Array = rng.normal(size=(n, n)) * size
        return part - part.T

    kinds = rng.random(5) < [0.5, 0.5, 0.4, 0.4, 0.2]
    damping = damping + skew(1.0) * kinds[0]
    stiffness = stiffness + skew(1.5) * kinds[1]
    damping = damping - rng.uniform(0.05, 0.6) * mass * kinds[2]
    stiffness = stiffness - rng.uniform(0.5, 5.0) * mass * kinds[3]
    return mass + skew(0.1) * kinds[4], damping, stiffness


def _rows(rng: Generator, n: int) -> list[list[float]]:
    """n independent rows: coordinates and differences of neighbours, in any order."""
    rows = np.eye(n)
    for i in range(1, n):
        if rng.random() < 0.5:
            rows[i, i - 1] = -1.0
    return rng.permutation(rows).tolist()


def _forces(
    rng: Generator, orders: list[int], mass: Array, damping: Array, stiffness: Array, omega: float
) -> tuple[HarmonicForce, ...]:
    n = len(mass)
    parts = rng.normal(size=(len(orders), 2, n))
    reach = 0.0
    for order, (sine, cosine) in zip(orders, parts, strict=True):
        w = order * omega
        answer = np.linalg.solve(stiffness - w**2 * mass + 1j * w * damping, cosine - 1j * sine)
        reach += float(np.abs(answer).max())
    parts /= max(reach, 0.05)
    return tuple(HarmonicForce(order, *part.tolist()) for order, part in zip(orders, parts, strict=True))


def _contacts(rng: Generator, rows: list[list[float]]) -> tuple[PiecewiseContact, ...]:
    count = int(rng.integers(0, len(rows) + 1))
    return tuple(_contact(rng, row) for row in rows[:count])


def _contact(rng: Generator, row: list[float]) -> PiecewiseContact:
    upper, lower = float(rng.uniform(0.05, 0.8)), -float(rng.uniform(0.05, 0.8))
    sides = rng.choice(["upper", "lower", "both", "equal"], p=[0.35, 0.25, 0.2, 0.2])
    stops = (
        None if sides == "lower" else upper,
        None if sides == "upper" else -upper if sides == "equal" else lower,
    )
    if rng.random() < 0.4:
        return PiecewiseContact(row, *stops, restitution=float(rng.choice([0.0, 0.5, 0.8, rng.uniform(0.2, 0.95)])))
    return PiecewiseContact(
        row,
        *stops,
        stiffness=float(rng.uniform(5.0, 50.0)),
        damping=float(rng.uniform(0.0, 0.6) * (rng.random() < 0.6)),
        preload=float(rng.uniform(0.02, 0.3) * (rng.random() < 0.25)),
        release=str(rng.choice(["displacement", "force"])),
    )


def _friction(rng: Generator, rows: list[list[float]], least_slope: float) -> tuple[PiecewiseFriction, ...]:
    count = int(rng.integers(0, min(len(rows), 2) + 1))
    chosen = [rows[i] for i in rng.permutation(len(rows))[:count]]
    elements = []
    for row in chosen:
        kinetic = float(rng.uniform(0.02, 0.5))
        static = kinetic * float(rng.uniform(1.0, 1.6) if rng.random() < 0.6 else 1.0)
        belt = float(rng.uniform(-0.5, 0.5)) if rng.random() < 0.3 else 0.0
        slope = float(rng.uniform(least_slope, 0.2)) if rng.random() < 0.4 else 0.0
        elements.append(PiecewiseFriction(row, kinetic, static, belt, slope))
    return tuple(elements)


def _with_phases(rng: Generator, machine: PiecewiseMachine, switched_elements: bool) -> PiecewiseMachine:
    starts = [0.0, *np.sort(rng.uniform(0.1, 0.9, int(rng.integers(1, 3)))).tolist()]
    return PiecewiseMachine(
        **{key: getattr(machine, key) for key in machine.__dataclass_fields__ if key != "phases"},
        phases=(PiecewisePhase(0.0), *(_phase(rng, machine, start, switched_elements) for start in starts[1:])),
    )


def _phase(rng: Generator, machine: PiecewiseMachine, start: float, switched_elements: bool) -> PiecewisePhase:
    def scaled(rows: object) -> list[list[float]] | None:
        return (np.array(rows) * rng.uniform(0.6, 1.5)).tolist() if rng.random() < 0.5 else None

    contacts = {i: {"stiffness": float(c.stiffness * rng.uniform(0.5, 2.0))} for i, c in enumerate(machine.contacts)}
    friction = {i: {"kinetic": float(f.kinetic * rng.uniform(0.3, 1.0))} for i, f in enumerate(machine.friction)}
    return PiecewisePhase(
        start,
        stiffness=scaled(machine.stiffness),
        damping=scaled(machine.damping),
        load=(rng.normal(size=machine.n) * 0.3).tolist() if rng.random() < 0.5 else None,
        contacts=contacts if switched_elements and contacts else None,
        friction=friction if switched_elements and friction else None,
    )


def _inside(rng: Generator, contact: PiecewiseContact) -> float:
    """A value of row.x off both stops."""
    stops = contact.stops
    high = float(stops.get(1, stops.get(-1, 0.0) + 1.0))
    low = float(stops.get(-1, high - 1.0))
    return float(rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low)))


__all__ = ["random_machine", "random_state"]
