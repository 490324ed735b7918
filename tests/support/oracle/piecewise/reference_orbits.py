"""The machines of the table of reference orbits; table.py finds their orbits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.machine import (
    HarmonicForce,
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewisePhase,
    Rows,
    Vector,
)


def oscillator(
    omega: Number, cos: Number = 0.0, *, damping: Number = 0.1, stiffness: Number = 1.0, load: Number = 0.0,
    contact: PiecewiseContact | None = None, friction: PiecewiseFriction | None = None, phases: tuple[PiecewisePhase,
    ...] = (PiecewisePhase(0.0),),
) -> PiecewiseMachine:  # fmt: skip
    """x'' + damping x' + stiffness x = cos cos(omega t) + load."""
    return PiecewiseMachine(
        mass=[[1.0]],
        damping=[[damping]],
        stiffness=[[stiffness]],
        load=[load],
        omega=omega,
        forces=(HarmonicForce(1, [0.0], [cos]),) if cos else (),
        contacts=() if contact is None else (contact,),
        friction=() if friction is None else (friction,),
        phases=phases,
    )


def soft(
    omega: Number, *, d: float = 0.02, k: float = 29.0, c: float = 0.0, p: float = 0.0, release: str = "displacement"
) -> PiecewiseMachine:
    """x'' + d x' + x = .8 omega^2 / 1.26 cos(omega t) with a soft stop at 1."""
    stop = PiecewiseContact([1.0], 1.0, stiffness=k, damping=c, preload=p, release=release)
    return oscillator(omega, 0.8 * omega**2 / 1.26, damping=d, contact=stop)


def rubbed(omega: Number, static: float = 1.2, amplitude: float = 2.0) -> PiecewiseMachine:
    """x'' + .1 x' + x + sgn x' = amplitude cos(omega t)."""
    return oscillator(omega, amplitude, friction=PiecewiseFriction([1.0], 1.0, static))


def belt(velocity: Number = 0.5, omega: float = 1.0, amplitude: float = 0.0) -> PiecewiseMachine:
    """x'' + .1 x' + x + .4 sgn(x' - velocity) = amplitude cos(omega t), static friction 1."""
    return oscillator(omega, amplitude, friction=PiecewiseFriction([1.0], 0.4, 1.0, velocity))


def two_mass(omega: float, *contacts: PiecewiseContact) -> PiecewiseMachine:
    """Two masses of Fig. 3 of Li & Tan (2011): mu_k = 5, mu_m = 2, zeta = .05, f2 = 0, tau = pi."""
    K = [[1.0, -1.0], [-1.0, 6.0]]
    C = [[0.1, -0.1], [-0.1, 0.6]]
    return PiecewiseMachine(
        [[1.0, 0.0], [0.0, 2.0]], C, K, [0.0, 0.0], omega, (HarmonicForce(1, [-1.0, 0.0], [0.0, 0.0]),), contacts
    )


def capsule() -> PiecewiseMachine:
    """Inner mass at r from its capsule at x2: soft stop at r = .02, ground friction .5, forced inside."""
    return PiecewiseMachine(
        mass=[[1.0, 1.0], [1.0, 6.0]],
        damping=[[0.1, 0.0], [0.0, 0.0]],
        stiffness=[[1.0, 0.0], [0.0, 0.0]],
        load=[0.0, 0.0],
        omega=0.9,
        forces=(HarmonicForce(1, [0.0, 0.0], [1.0, 1.0]),),
        contacts=(PiecewiseContact([1.0, 0.0], 0.02, stiffness=15.0),),
        friction=(PiecewiseFriction([0.0, 1.0], 0.5, 0.5),),
    )


def _between(omega: Number) -> PiecewiseMachine:
    return oscillator(omega, 2.0, contact=PiecewiseContact([1.0], 1.0, -1.0, stiffness=10.0))


def _rubbed_and_stopped(omega: float) -> PiecewiseMachine:
    stop = PiecewiseContact([1.0], 0.8, restitution=0.6)
    return oscillator(omega, 1.2, contact=stop, friction=PiecewiseFriction([1.0], 0.3, 0.4))


def _switched(omega: float, amplitude: float, at: float, contact: PiecewiseContact | None = None) -> PiecewiseMachine:
    stiffness: Rows = [[0.5]]
    return oscillator(
        omega,
        amplitude,
        stiffness=1.5,
        contact=contact,
        phases=(PiecewisePhase(0.0), PiecewisePhase(at, stiffness=stiffness)),
    )


def _stop(row: Vector, R: float, *, upper: float | None = None, lower: float | None = None) -> PiecewiseContact:
    return PiecewiseContact(row, upper, lower, restitution=R)


@dataclass(frozen=True)
class ReferenceOrbit:
    """One orbit, reached by a transient from rest; ``later``: counted from this many sections after."""

    name: str
    machine: PiecewiseMachine
    periods: int = 1
    symmetric: bool = False
    drift: int | None = None
    later: int = 0


def orbits() -> list[ReferenceOrbit]:
    """The periodic orbits of the table, except those at bifurcation points."""
    first, second, between = [1.0, 0.0], [0.0, 1.0], [-1.0, 1.0]
    both = PiecewiseContact(first, 0.15, -0.15, stiffness=100.0, damping=0.2)
    square = oscillator(
        1.0, load=0.5, phases=(PiecewisePhase(0.0), PiecewisePhase(0.5, load=[-0.5])),
        contact=PiecewiseContact([1.0], 1.0, stiffness=20.0, damping=0.1),
    )  # fmt: skip
    rig = _stop([1.0], 0.7, upper=0.5)
    left = _stop(first, 0.8, upper=0.3)
    narrow = (_stop(first, 0.8, upper=0.15), _stop(second, 0.6, lower=-0.05))
    return [
        ReferenceOrbit("row 2", soft(0.95)),
        ReferenceOrbit("row 3", soft(0.86), 2),
        ReferenceOrbit("row 4", soft(0.95, c=0.5)),
        ReferenceOrbit("row 5", soft(0.95, c=0.5, release="force")),
        ReferenceOrbit("row 6", soft(1.0, d=0.2, k=10.0, p=0.5)),
        ReferenceOrbit("row 7", soft(0.8, d=0.2, k=10.0, p=0.5), 2, later=1),
        ReferenceOrbit("row 8", soft(0.95, k=10.0, p=0.5, c=0.4, release="force")),
        ReferenceOrbit("row 9", _between(1.4), symmetric=True),
        ReferenceOrbit("row 11", two_mass(4.0, both), symmetric=True),
        ReferenceOrbit("row 12", rubbed(0.9), symmetric=True),
        ReferenceOrbit("row 13", rubbed(1.2), symmetric=True),
        ReferenceOrbit("row 15", rubbed(0.4), symmetric=True),
        ReferenceOrbit("row 16", rubbed(0.4, static=1.0), symmetric=True),
        ReferenceOrbit("row 19", belt(amplitude=0.3)),
        ReferenceOrbit("row 20", belt(omega=1.2, amplitude=0.3)),
        ReferenceOrbit("row 21", _rubbed_and_stopped(1.0)),
        ReferenceOrbit("row 22", _rubbed_and_stopped(0.8)),
        ReferenceOrbit("row 23", two_mass(2.0, left, _stop(second, 0.6, lower=-0.1))),
        ReferenceOrbit("row 24", two_mass(3.0, *narrow), 2),
        ReferenceOrbit("row 25", two_mass(2.0, left, _stop(between, 0.6, upper=0.2))),
        ReferenceOrbit("row 26, omega 2", _switched(2.0, 0.5, 0.5)),
        ReferenceOrbit("row 26, omega 1.3", _switched(1.3, 0.5, 0.5)),
        ReferenceOrbit("row 27, omega 1", _switched(1.0, 1.0, 0.4, rig)),
        ReferenceOrbit("row 27, omega 1.5", _switched(1.5, 1.0, 0.4, rig)),
        ReferenceOrbit("row 28", square),
        ReferenceOrbit("row 29", capsule(), drift=1),
        ReferenceOrbit("row 30", two_mass(1.0, _stop(first, 0.3, upper=0.15, lower=-0.15)), symmetric=True),
    ]


def once_in_two(omega: Number) -> PiecewiseMachine:
    """``soft`` with a stop that is absent in the middle of every two forcing periods, which are one period here.

    Row 3 has one contact in two periods. Before its period doubling the mass grazes the stop half-way: the real orbit
    continues with a second contact, and only a solution of the equations doubles its period.
    """
    machine = soft(omega)
    away = {0: {"upper": None}}
    return replace(
        machine,
        omega=omega / 2,
        forces=tuple(replace(force, order=2) for force in machine.forces),
        phases=(PiecewisePhase(0.0), PiecewisePhase(0.25, contacts=away), PiecewisePhase(0.75)),
    )


@dataclass(frozen=True)
class BifurcationOrbit:
    """An orbit with a multiplier 1 or -1, near a section state and a forcing frequency.

    It closes after one period of ``machine_at``; ``shown_at`` and ``periods``, if given, are for the record.
    """

    name: str
    kind: str
    machine_at: Callable[[Number], PiecewiseMachine]
    omega: float
    start: tuple[float, float]
    multiplier: int
    symmetric: bool = False
    shown_at: Callable[[Number], PiecewiseMachine] | None = None
    periods: int = 1


CRITICAL = (
    BifurcationOrbit("row 2, PD", "period doubling", soft, 0.9157, (1.12446, 0.15392), -1),
    BifurcationOrbit(
        "row 3, PD", "period doubling", once_in_two, 0.91585, (1.2431, 0.2153), -1, shown_at=soft, periods=2
    ),
    BifurcationOrbit("row 10, SB", "symmetry breaking", _between, 1.052, (1.4752, 0.26603), -1, symmetric=True),
    BifurcationOrbit("row 10, fold", "fold", _between, 3.018, (-1.0002515, 18.8791616), 1, symmetric=True),
)

ONSETS = (
    ("row 14", rubbed(0.655453162351025)),
    ("row 14, lower", rubbed(0.658629504734325, 1.05, 1.8)),
    ("row 14, upper", rubbed(2.52030194267901, 1.05, 1.8)),
)
"""Orbits that turn where the force to hold them equals static friction: here a stick begins."""

GRAZES = (0.782204086871376, 1.65477114143231)
"""Frequencies at which the linear response of ``soft`` touches the stop."""
