"""Exact orbits as equations of their events: branches in one parameter, bifurcation and grazing curves in two.

The equations are solved by Newton's method and give the Floquet multipliers of each orbit.
"""

from workers.continuation.branches import BranchRun, BranchStart, branch, switch_branch
from workers.continuation.curves import curve
from workers.continuation.events import Event, SolutionPoint
from workers.continuation.extended_system import Condition
from workers.continuation.families import Family, family_of
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.orbits import orbit_from_state, section_state, section_states
from workers.model.family import OrbitMachines

__all__ = [
    "BranchRun",
    "BranchStart",
    "Condition",
    "Event",
    "Family",
    "Itinerary",
    "Orbit",
    "OrbitMachines",
    "SolutionPoint",
    "branch",
    "curve",
    "family_of",
    "orbit_from_state",
    "section_state",
    "section_states",
    "switch_branch",
]
