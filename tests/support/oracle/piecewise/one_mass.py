"""One mass with a contact or friction, as in many of the reference orbits."""

from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.machine import (
    HarmonicForce,
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewisePhase,
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


def belt(velocity: Number = 0.5, omega: float = 1.0, amplitude: float = 0.0) -> PiecewiseMachine:
    """x'' + .1 x' + x + .4 sgn(x' - velocity) = amplitude cos(omega t), static friction 1."""
    return oscillator(omega, amplitude, friction=PiecewiseFriction([1.0], 0.4, 1.0, velocity))
