"""Exact orbits. The map of many periods with its Jacobian, Newton's method on it and Floquet multipliers; and orbits as
equations of their events, their branches in one parameter and their bifurcation and grazing curves in two.
"""

from workers.continuation.branches import BranchRun, BranchStart, branch, leaving_branch
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
    "leaving_branch",
    "orbit_from_state",
    "section_state",
    "section_states",
]
