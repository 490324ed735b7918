"""An independent simulator of piecewise-linear machines: soft and rigid contacts, friction, phases of the forcing.

``PiecewiseMachine``       matrices, forces, contacts, friction elements and phases; ``PiecewiseMachine.of`` reads a
                           JSON record
``simulate``      any motion, with sticking, chatter and rest, in multiprecision arithmetic (mpmath)
``monodromy``     derivative of the stroboscopic map by differences of such motions
``orbit``         a periodic orbit by Newton's method on that map
``measures``      shares of time, losses and extremes on the way

The solver flies in modal blocks, marches by curvature bounds and multiplies saltation matrices. Here a leg is the
Taylor series of displacements, velocities and forcing in physical coordinates, sticking and rest are algebraic
constraints, and the first guard is isolated with Bernstein coefficients.
"""

from tests.support.oracle.piecewise.machine import (
    HarmonicForce,
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewisePhase,
)
from tests.support.oracle.piecewise.measures import measures
from tests.support.oracle.piecewise.mode_law import PiecewiseMode
from tests.support.oracle.piecewise.motion import PiecewiseEvent, PiecewiseRun, simulate
from tests.support.oracle.piecewise.orbits import PiecewiseOrbit, monodromy, orbit

__all__ = [
    "HarmonicForce",
    "PiecewiseContact",
    "PiecewiseEvent",
    "PiecewiseFriction",
    "PiecewiseMachine",
    "PiecewiseMode",
    "PiecewiseOrbit",
    "PiecewisePhase",
    "PiecewiseRun",
    "measures",
    "monodromy",
    "orbit",
    "simulate",
]
