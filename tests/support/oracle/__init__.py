"""An independent simulator of linear machines with one gap: it shares no code and no method with the solver.

``OracleMachine``             matrices, stops and initial state of any such machine; ``two_mass`` makes one from
                              parameters
``simulate``            any orbit, chatter and sticking included, in multiprecision arithmetic (mpmath)
``section_jacobian``    derivative of the stroboscopic map by differences of such orbits
``first_impact_dense``  first impacts of many flights in double precision, by dense sampling
``dense_violation``     how far given flights pass beyond a stop
``symmetric_orbit``     the symmetric orbit with one impact a side, in closed form
``one_sided_orbit``     the orbit with one impact in n periods, in closed form

The solver flies in modal blocks and marches by curvature bounds. Here a flight is the Taylor series of displacements
and velocities with the forcing among the unknowns, so that damping of any kind, resonance, rigid modes and mass ratios
are no special cases; the first crossing of a stop is isolated with Bernstein coefficients. The parameters of the
two-mass oscillator are accepted in place of a machine.
"""

from tests.support.oracle.closed_form import ImpactOrbit, one_sided_orbit, symmetric_orbit
from tests.support.oracle.dense import FirstImpacts, dense_violation, first_impact_dense
from tests.support.oracle.model import OracleMachine, two_mass
from tests.support.oracle.simulate import Impact, RestInterval, SimulatedMotion, section_jacobian, simulate

__all__ = [
    "FirstImpacts",
    "Impact",
    "ImpactOrbit",
    "OracleMachine",
    "RestInterval",
    "SimulatedMotion",
    "dense_violation",
    "first_impact_dense",
    "one_sided_orbit",
    "section_jacobian",
    "simulate",
    "symmetric_orbit",
    "two_mass",
]
