"""Links between attractors of neighbouring cells that are one orbit: the orbit is followed from one cell to the other.

Newton's method on the initial state and the impact times finds the orbit at the other cell's parameters, in a few
steps. The orbit is an attractor of that cell if one of its section states, taken once per period, is the stored state
of the attractor. Its mirror image does not count. A link counts if both directions agree, since close to a bifurcation
Newton's method may find another orbit. In symmetric machines, mirror images of linked orbits are linked too, whether
Newton's method finds the link or not.

A machine may have modes, that is laws of motion between events, such as sliding and sticking. Its remaining orbits are
followed along branches, which continue where contacts and slides change though nothing jumps.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from atlas.orbits.labels.attractor_orbits import AttractorOrbitTable, with_images
from atlas.orbits.orbit_table import Array, Rows, are_on_orbit
from atlas.orbits.stored_orbits import StoredOrbits
from workers.continuation import Orbit, branch, section_states
from workers.continuation.orbits import OrbitBatch, many_of
from workers.results import NO_IMPACT

STEPS = (2, 8)
"""Numbers of equal parameter steps in which Newton's method follows an orbit from one cell to the next.

The first number is for the first attempt, the second for the attempt after a failure.
"""

MAX_GAP_CELLS = 4
"""Maximum distance, in cells, over which an orbit is followed to another orbit that no chain of links connects with
it.
"""

STEP = 0.5
"""Maximum step of a branch from one cell to the next, relative to the distance between the cells."""


class OrbitLinks(NamedTuple):
    """Links between orbits of neighbouring cells.

    Rows below A are stored orbits. Rows from A on are unseen mirror images: no initial state has reached them.

    pairs (L, 2)       rows of linked orbits; with a pair its mirror image is linked, with the same change
    change (L,)        change of the orbit between the cells: the largest of an impact time, in radians of the force, or
                       of a speed relative to the fastest
    cell (A+unseen,)   cell of each orbit
    image (A+unseen,)  row of its mirror image, -1 if the machine is not symmetric
    known (A,)         mask of orbits that can be followed: Newton's method finds them
    one_way            number of omitted pairs: followed from one cell, an orbit becomes that of the other cell, but not
                       back
    """

    pairs: Rows
    change: Array
    cell: Rows
    image: Rows
    known: NDArray[np.bool_]
    one_way: int


def find_links(attractors: AttractorOrbitTable) -> OrbitLinks:
    """Return all links between orbits of neighbouring cells, followed in both directions.

    Motion without impact is the same orbit in all cells. Orbits that these links do not connect are followed over up to
    MAX_GAP_CELLS cells, since the initial states of the cells between may have missed the orbit.
    """
    # in machines with modes, motion without impact depends on where they slide
    still = (attractors.regime == NO_IMPACT) & (attractors.impacts_upper == 0) & (not attractors.system.has_modes)
    free, follower = np.flatnonzero(still), AttractorOrbits(attractors)
    cell, image = with_images(attractors)
    follower.find(range(len(attractors)))
    known = still | np.array([follower.orbit_of_row(row) is not None for row in range(len(attractors))], dtype=np.bool_)
    known |= (attractors.twin >= 0) & known[attractors.twin]
    pairs, change = np.stack([free[:-1], free[1:]], axis=1), np.zeros(max(0, len(free) - 1))
    one_way = np.zeros((0, 2), dtype=np.int64)
    for away in range(1, MAX_GAP_CELLS + 1):
        candidates = attractors.same_kind_pairs(away)
        candidates = candidates[~still[candidates[:, 0]] & known[candidates].all(axis=1)]
        if away > 1:
            candidates = candidates[_apart(candidates, pairs, len(cell))]
        forward, size = follower.follow_pairs(candidates, away)
        back, _ = follower.follow_pairs(candidates[:, ::-1], away)
        both_ways = forward & back
        pairs, change = np.concatenate([pairs, candidates[both_ways]]), np.concatenate([change, size[both_ways]])
        pairs, change = _mirrored(pairs, change, image)
        one_way = np.concatenate([one_way, np.sort(candidates[forward != back], axis=1)])
    candidates = _left_over(attractors, pairs)
    candidates = candidates[known[candidates].all(axis=1) & ~still[candidates].any(axis=1)]
    reached, size = follower.follow_along_branches(candidates)
    pairs, change = _mirrored(np.concatenate([pairs, reached]), np.concatenate([change, size]), image)
    left = {*map(tuple, one_way.tolist())} - {*map(tuple, pairs.tolist())}
    return OrbitLinks(pairs, change, cell, image, known, len(left))


def _mirrored(pairs: Rows, change: Array, image: Rows) -> tuple[Rows, Array]:
    """Return links together with the links between the mirror images of their orbits, each once and sorted.

    A link and its mirror image get the smaller of their two changes.
    """
    images = image[pairs]
    has_image = (images >= 0).all(axis=1)
    every = np.sort(np.concatenate([pairs, images[has_image]]), axis=1)
    pairs_once, index = np.unique(every, axis=0, return_inverse=True)
    least = np.full(len(pairs_once), np.inf)
    np.minimum.at(least, index.ravel(), np.concatenate([change, change[has_image]]))
    return pairs_once, least


def _apart(candidates: Rows, pairs: Rows, count: int) -> NDArray[np.bool_]:
    """Return the mask of candidate pairs (N, 2) whose two orbits no chain of the links ``pairs`` (L, 2) connects.

    ``count`` is the number of orbits.
    """
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    return np.asarray(part[candidates[:, 0]] != part[candidates[:, 1]])


def _left_over(attractors: AttractorOrbitTable, pairs: Rows) -> Rows:
    """Return pairs (N, 2) of orbits of one period in neighbouring cells, neither of which is linked to the other's
    cell.
    """
    table = attractors
    orbits, others = np.concatenate([pairs, pairs[:, ::-1]]).T
    seen = others < len(table)  # unseen mirror images have no row
    linked = {*zip(orbits[seen].tolist(), table.cell[others[seen]].tolist(), strict=True)}
    candidates = table.neighbour_pairs()
    candidates = candidates[table.period[candidates[:, 0]] == table.period[candidates[:, 1]]]
    free = [(a, table.cell[b]) not in linked and (b, table.cell[a]) not in linked for a, b in candidates.tolist()]
    return np.asarray(candidates[np.array(free, dtype=np.bool_)])


class AttractorOrbits(StoredOrbits):
    """The periodic orbits of an atlas of all attractors, solved by Newton's method and followed to other cells."""

    def __init__(self, attractors: AttractorOrbitTable) -> None:
        super().__init__(attractors)
        self.attractors = attractors

    def follow_pairs(self, pairs: Rows, away: int) -> tuple[NDArray[np.bool_], Array]:
        """Follow the first orbit of each pair (N, 2) to the cell of the second orbit.

        Return the mask (N,) of pairs in which the first orbit becomes the second, and the change (N,) of the orbit on
        the way. ``away`` is the distance between the cells, in cells.
        """
        reached, change = np.zeros(len(pairs), dtype=np.bool_), np.full(len(pairs), np.nan)
        for rows, orbits in self.group_by_itinerary(pairs[:, 0]):
            reached[rows], change[rows] = self._reach_alike(pairs[rows], orbits, away)
        return reached, change

    def _reach_alike(self, pairs: Rows, orbits: list[Orbit], away: int) -> tuple[NDArray[np.bool_], Array]:
        """Do the work of ``follow_pairs`` for first orbits that all have the same sequence of impacts and other
        events.
        """
        attractors = self.attractors
        start_values, end_values = (attractors.values(pairs[:, k]) for k in (0, 1))
        arrived = self.continue_orbits(orbits, start_values, end_values, STEPS[0] * away)
        arrived = arrived._replace(orbits=arrived.orbits.at_rows(np.arange(len(orbits))))  # a copy, to be changed
        for steps in STEPS[1:]:
            again = np.flatnonzero(~arrived.converged)
            if len(again):
                more = self.continue_orbits(
                    [orbits[r] for r in again], start_values[again], end_values[again], steps * away
                )
                for field, better in zip(arrived.orbits[1:], more.orbits[1:], strict=True):
                    field[again] = better
                arrived.converged[again] = more.converged
        reached = arrived.converged.copy()
        rows = np.flatnonzero(reached)
        if len(rows):
            values = dict(zip(attractors.axes, end_values[rows].T, strict=True))
            fixed = {name: np.full(len(rows), value) for name, value in attractors.fixed.items()}
            states = section_states(attractors.system, fixed | values, [arrived.orbit(int(r)) for r in rows])
            reached[rows] = are_on_orbit(states, attractors.state[pairs[rows, 1]])
        return reached, _change(many_of(orbits, start_values), arrived, self.family.model(end_values).omega)

    def follow_along_branches(self, pairs: Rows) -> tuple[Rows, Array]:
        """Return those pairs (N, 2) of orbits that are connected by a branch from cell to cell, and the change along
        each.

        The change is the largest change of a component of the section state, relative to the largest component on the
        orbit. A branch that turns back on the way connects no pair.
        """
        attractors, pairs_on_branches, change = self.attractors, list[list[int]](), list[float]()
        reached = dict[tuple[int, int], Array | None]()
        for one, other in pairs.tolist():
            cell = int(attractors.cell[other])
            if (one, cell) not in reached:
                reached[one, cell] = self._along_branch(one, cell)
            states = reached[one, cell]
            if states is None:
                continue
            if are_on_orbit(states, attractors.state[other]):
                pairs_on_branches.append([one, other])
                change.append(
                    float(np.abs(attractors.state[other] - attractors.state[one]).max() / np.abs(states).max())
                )
        return np.array(pairs_on_branches, dtype=np.int64).reshape(-1, 2), np.array(change)

    def _along_branch(self, row: int, cell: int) -> Array | None:
        """Follow the branch of an orbit to the parameters of a neighbouring cell and return its section states (n, 2d)
        there.

        None if the branch ends or turns back before.
        """
        attractors, orbit = self.attractors, self.orbit_of_row(row)
        start_point, end_point = attractors.points[attractors.cell[row]], attractors.points[cell]
        axis = int(np.flatnonzero(start_point != end_point)[0])
        begin, end = float(start_point[axis]), float(end_point[axis])
        window = (min(begin, end), max(begin, end))
        try:
            run = (
                None
                if orbit is None
                else branch(self.family_along(axis, start_point), orbit, begin, window, resolution=STEP)
            )
        except (ValueError, np.linalg.LinAlgError):
            return None
        if run is None:
            return None
        steps = np.diff([float(point.values[0]) for point in run.points])
        last = run.points[-1 if end > begin else 0]
        if not len(steps) or np.any(steps < 0.0) or float(last.values[0]) != end:
            return None
        parameters = {**attractors.fixed, **dict(zip(attractors.axes, end_point.tolist(), strict=True))}
        values = {name: np.array([value]) for name, value in parameters.items()}
        return section_states(attractors.system, values, [last.orbit])[0]


def _change(before: OrbitBatch, after: OrbitBatch, omega: Array) -> Array:
    _, times, speeds, _ = after.orbits
    later = np.abs(times - before.orbits.times).max(axis=1, initial=0.0) * omega
    fastest = np.abs(speeds).max(axis=1, initial=1e-300)
    faster = np.abs(speeds - before.orbits.speeds).max(axis=1, initial=0.0) / fastest
    return np.asarray(np.maximum(later, faster))
