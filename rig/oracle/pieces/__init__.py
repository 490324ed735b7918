"""An independent simulator of piecewise-linear machines: soft and rigid contacts, friction, phases of the forcing.

``Machine``       matrices, forces, contacts, friction elements and phases; ``Machine.of`` reads a JSON record
``simulate``      any motion, with sticking, chatter and rest, in multiprecision arithmetic (mpmath)
``monodromy``     derivative of the stroboscopic map by differences of such motions
``orbit``         a periodic orbit by Newton's method on that map
``bifurcation``   parameter at which a multiplier of an orbit becomes 1 or -1
``measures``      shares of time, losses and extremes on the way

The solver flies in modal blocks, marches by curvature bounds and multiplies saltation matrices. Here a leg is the
Taylor series of displacements, velocities and forcing in physical coordinates, sticking and rest are algebraic
constraints, and the first guard is isolated with Bernstein coefficients.
"""

from rig.oracle.pieces.bifurcations import bifurcation
from rig.oracle.pieces.law import Mode
from rig.oracle.pieces.machine import Contact, Force, Friction, Machine, Phase
from rig.oracle.pieces.measures import measures
from rig.oracle.pieces.motion import Event, Run, simulate
from rig.oracle.pieces.orbits import Orbit, monodromy, orbit

__all__ = [
    "Contact",
    "Event",
    "Force",
    "Friction",
    "Machine",
    "Mode",
    "Orbit",
    "Phase",
    "Run",
    "bifurcation",
    "measures",
    "monodromy",
    "orbit",
    "simulate",
]
