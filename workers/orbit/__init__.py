"""Exact orbits. The map of many periods with its Jacobian, Newton's method on it and Floquet multipliers; and orbits as
equations of their impacts, their branches in one parameter and their bifurcation and grazing curves in two.
"""

from workers.orbit.branches import Start, branch, leaving_branch
from workers.orbit.curves import curve
from workers.orbit.equations import Itinerary, Orbit
from workers.orbit.events import Event, Point
from workers.orbit.extended import Condition
from workers.orbit.follow import Way
from workers.orbit.linear import Family, Linear, family_of
from workers.orbit.seeds import orbit_from_state, section_state, section_states

__all__ = [
    "Condition",
    "Event",
    "Family",
    "Itinerary",
    "Linear",
    "Orbit",
    "Point",
    "Start",
    "Way",
    "branch",
    "curve",
    "family_of",
    "leaving_branch",
    "orbit_from_state",
    "section_state",
    "section_states",
]
