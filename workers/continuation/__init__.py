"""Exact orbits. The map of many periods with its Jacobian, Newton's method on it and Floquet multipliers; and orbits as
equations of their events, their branches in one parameter and their bifurcation and grazing curves in two.
"""

from workers.continuation.branches import BranchRun, Start, branch, leaving_branch
from workers.continuation.curves import curve
from workers.continuation.events import Event, Point
from workers.continuation.extended import Condition
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.orbits import orbit_from_state, section_state, section_states
from workers.continuation.oscillator import Family, family_of
from workers.model.family import OrbitMachines

__all__ = [
    "BranchRun",
    "Condition",
    "Event",
    "Family",
    "Itinerary",
    "Orbit",
    "OrbitMachines",
    "Point",
    "Start",
    "branch",
    "curve",
    "family_of",
    "leaving_branch",
    "orbit_from_state",
    "section_state",
    "section_states",
]
