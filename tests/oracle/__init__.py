"""An independent simulator of the two-mass oscillator: it shares no code and no method with the solver it checks.

``simulate``            any orbit, chatter and sticking included, in multiprecision arithmetic (mpmath)
``section_jacobian``    derivative of the stroboscopic map by differences of such orbits
``first_impact_dense``  first impacts of many flights in double precision, by dense sampling
``dense_violation``     how far given flights pass beyond a stop
``symmetric_orbit``     the symmetric orbit with one impact a side, in closed form

The solver flies in modal blocks and marches by curvature bounds. Here a flight is the Taylor series of the physical
state with the forcing as two more unknowns, so that damping, resonance and mass ratios are no special cases, and the
first crossing of a stop is isolated with Bernstein coefficients.
"""

from tests.oracle.closed_form import SymmetricOrbit, symmetric_orbit
from tests.oracle.dense import FirstImpacts, dense_violation, first_impact_dense
from tests.oracle.simulate import Impact, Orbit, Stuck, section_jacobian, simulate

__all__ = [
    "FirstImpacts",
    "Impact",
    "Orbit",
    "Stuck",
    "SymmetricOrbit",
    "dense_violation",
    "first_impact_dense",
    "section_jacobian",
    "simulate",
    "symmetric_orbit",
]
