"""An independent simulator of linear machines with one gap: it shares no code and no method with the solver.

``OracleMachine``             matrices, stops and initial state of any such machine; ``two_mass`` makes one from
                              parameters
``simulate``            any orbit, chatter and sticking included, in multiprecision arithmetic (mpmath)
``section_jacobian``    derivative of the stroboscopic map by differences of such orbits
``first_hit``           first impact of a free flight
``symmetric_orbit``     the symmetric orbit with one impact a side, in closed form
``one_sided_orbit``     the orbit with one impact in n periods, in closed form

Motions are those of the simulator of piecewise-linear machines in ``piecewise``, where such a machine has one rigid
contact. The parameters of the two-mass oscillator are accepted in place of a machine.
"""

from tests.support.oracle.closed_form import ImpactOrbit, one_sided_orbit, symmetric_orbit
from tests.support.oracle.model import OracleMachine, two_mass
from tests.support.oracle.simulate import Impact, RestInterval, SimulatedMotion, first_hit, section_jacobian, simulate

__all__ = [
    "Impact",
    "ImpactOrbit",
    "OracleMachine",
    "RestInterval",
    "SimulatedMotion",
    "first_hit",
    "one_sided_orbit",
    "section_jacobian",
    "simulate",
    "symmetric_orbit",
    "two_mass",
]
