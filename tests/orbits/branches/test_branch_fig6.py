"""The branches of the machine of Fig. 6 on its line b = 0.15 against direct simulation: its map, sweeps both ways."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest

from atlas.cell.trajectory import cell_orbit
from atlas.orbits.branches.from_cell import tree_from
from atlas.orbits.branches.seed import seed_of_point
from atlas.orbits.branches.table import pattern
from atlas.orbits.branches.tree import Branch, BranchTree
from workers import Settings
from workers.continuation import Event, section_states
from workers.kernel.coordinates import motion_from
from workers.kernel.motion import FLIGHT, RUNNING, STATUS
from workers.model.oscillator import Oscillator
from workers.model.system import find_system
from workers.orbit.map import map_with_jacobian
from workers.results import CHAOTIC, PERIODIC, UNDETERMINED
from workers.sweep import solve_lines
from workers.tile import solve_tile

pytestmark = pytest.mark.slow

TWO_MASS = find_system("two-mass")


@dataclass(frozen=True)
class Bifurcation:
    """Where one orbit gives way to another.

    kind            "symmetry breaking" (multiplier of G is -1), "period doubling" (-1; "subcritical" where no stable
                    orbit of twice the period succeeds it), "fold" (+1) or "grazing"
    omega           where
    steps, half     the orbit's map: so many steps of G (half) or of the stroboscopic map
    stable_side     +1 or -1: the side of omega on which the orbit is stable
    stable, beyond  (period, symmetric) on that side and on the other; None: not this orbit, nothing periodic near it
    """

    kind: str
    omega: float
    steps: int
    half: bool
    stable_side: int
    stable: tuple[int, bool]
    beyond: tuple[int, bool] | None

    def __str__(self) -> str:
        return f"{self.kind}, period {self.stable[0]}, omega={self.omega:.8f}"


KNOWN = [
    Bifurcation("symmetry breaking", 3.0040942351, 1, True, +1, (1, True), (1, False)),
    Bifurcation("period doubling", 2.4495892973, 1, False, +1, (1, False), (2, False)),
    Bifurcation("period doubling", 2.2352569808, 2, False, +1, (2, False), (4, False)),
    Bifurcation("period doubling", 2.2178961545, 4, False, +1, (4, False), (8, False)),
    Bifurcation("subcritical period doubling", 2.1032479935, 2, False, -1, (2, False), None),
    Bifurcation("period doubling", 2.0646871370, 2, False, +1, (2, False), (4, False)),
    Bifurcation("period doubling", 2.0565331377, 4, False, +1, (4, False), (8, False)),
    Bifurcation("period doubling", 2.0285149868, 2, False, +1, (2, False), (4, False)),
    Bifurcation("fold", 2.2823005239, 2, False, -1, (2, False), None),
    Bifurcation("fold", 2.0352965860, 2, False, -1, (2, False), None),
    Bifurcation("grazing", 2.3770110394, 2, False, +1, (2, False), None),
]
"""By Newton's method on the map of simulated motion and bisection, to 1e-9; the branches have to find them again."""


def oscillator(omega: float) -> Oscillator:
    """The system of Fig. 6 (the defaults) at this forcing frequency."""
    return TWO_MASS.build({p.name: p.default for p in TWO_MASS.parameters} | {"omega": omega})


SEEDS = (3.5, 2.24, 2.1, 2.034)
"""Frequencies at which cells from rest settle on the orbits whose bifurcations are KNOWN."""

CELL = 2.0 / 999.0
"""The width of a cell of Fig. 6."""


@pytest.fixture(scope="module")
def trees() -> list[BranchTree]:
    return [tree_from(seed_of_point({"omega": omega}), "omega", (2.0, 4.0), switch=True, limit=5) for omega in SEEDS]


def nearest(trees: list[BranchTree], bifurcation: Bifurcation) -> Event:
    """The event of that kind that is nearest to a bifurcation."""
    kind = {"grazing": "graze"}.get(bifurcation.kind, bifurcation.kind.removeprefix("subcritical ").replace(" ", "_"))
    events = [event for tree in trees for branch in tree.branches for event in branch.run.events if event.kind == kind]
    return min(events, key=lambda event: abs(event.point.values[0] - bifurcation.omega))


@pytest.mark.parametrize("bifurcation", KNOWN, ids=str)
def test_events_lie_where_newton_on_the_direct_map_finds_them(
    trees: list[BranchTree], bifurcation: Bifurcation
) -> None:
    event = nearest(trees, bifurcation)
    assert event.point.values[0] == pytest.approx(bifurcation.omega, abs=1e-9)
    assert event.point.orbit.itinerary.periods == bifurcation.stable[0]


@pytest.mark.parametrize("bifurcation", [known for known in KNOWN if known.kind != "grazing"], ids=str)
def test_the_direct_map_closes_there_and_has_the_multiplier(trees: list[BranchTree], bifurcation: Bifurcation) -> None:
    event = nearest(trees, bifurcation)
    osc = oscillator(float(event.point.values[0]))
    state = section_states(TWO_MASS, {"omega": event.point.values}, [event.point.orbit])[0, 0]
    h = motion_from(osc, state).h
    motion, jacobian = map_with_jacobian(osc, h, FLIGHT, bifurcation.steps, bifurcation.half)
    assert motion.tally[STATUS] == RUNNING
    assert motion.h == pytest.approx(h, abs=1e-11)
    critical = 1.0 if bifurcation.kind == "fold" else -1.0
    multipliers = np.linalg.eigvals(jacobian)
    assert np.min(np.abs(multipliers - critical)) < 1e-8


@pytest.mark.parametrize("distance", [1e-3, -1e-3, 1e-5, -1e-5])
@pytest.mark.parametrize("bifurcation", KNOWN, ids=str)
def test_a_thousandth_from_a_bifurcation_the_class_is_right_and_nearer_to_it_never_wrong(
    trees: list[BranchTree], bifurcation: Bifurcation, distance: float
) -> None:
    """From a thousandth beside the orbit; a hundred-thousandth from the bifurcation the class may stay open."""
    point = nearest(trees, bifurcation).point
    state = section_states(TWO_MASS, {"omega": point.values}, [point.orbit])[0, 0]
    start = dict(zip(TWO_MASS.states, (0.999 * state).tolist(), strict=True))
    found = solve_tile("two-mass", start | {"omega": bifurcation.omega + distance})
    right = bifurcation.stable if distance * bifurcation.stable_side > 0 else bifurcation.beyond
    shown = (int(found["period"]), bool(found["symmetric"]))
    is_open = abs(distance) < 1e-3 and found["regime"] == UNDETERMINED
    if right is None:
        assert found["regime"] == CHAOTIC or is_open or shown != bifurcation.stable
    else:
        assert is_open or (int(found["regime"]), *shown) == (PERIODIC, *right)


class End(NamedTuple):
    """Where a stable stretch of a branch ends: the event's parameter, the way out, and a point well inside."""

    branch: Branch
    omega: float
    out: int
    inside: int


def ends(tree: BranchTree) -> Iterator[End]:
    """The ends at events of all stable stretches that are longer than eight cells."""
    for branch in tree.branches:
        points, values = branch.run.points, branch.values
        marks = {id(event.point) for event in branch.run.events}
        events = [k for k, point in enumerate(points) if id(point) in marks]
        for k in events:
            for step in (1, -1):
                reach = [j for j in range(k + step, len(points) if step > 0 else -1, step)]
                stretch = []
                for j in reach:
                    if points[j].unstable or j in events:
                        break
                    stretch.append(j)
                inside = next((j for j in stretch if abs(values[j] - values[k]) > 8 * CELL), None)
                if inside is not None:
                    yield End(branch, float(values[k]), int(np.sign(values[k] - values[inside])), inside)


def test_sweeps_both_ways_change_class_in_the_cell_of_the_event(trees: list[BranchTree]) -> None:
    """Each stable stretch is swept in cells of Fig. 6, towards rising and towards falling frequency, past its end."""
    found = {(round(end.omega, 6), end.out): end for tree in trees for end in ends(tree)}
    assert len(found) >= 8
    assert {end.out for end in found.values()} == {1, -1}
    for end in found.values():
        cells = end.omega + end.out * CELL * (np.arange(-7, 5) + 0.5)
        orbit = end.branch.run.points[end.inside]
        start = section_states(TWO_MASS, {"omega": orbit.values}, [orbit.orbit])[0, 0]
        line = {"omega": cells} | dict(zip(TWO_MASS.states, start.tolist(), strict=True))
        swept = solve_lines("two-mass", line, Settings(exponents="none"))
        own = pattern(end.branch.itinerary)
        names = ("period", "impacts_upper", "impacts_lower", "symmetric")
        same = [
            int(swept["regime"][k]) == PERIODIC and tuple(int(swept[name][k]) for name in names) == own
            for k in range(len(cells))
        ]
        assert same == [True] * 7 + [False] * 5, (end.omega, end.out, own)


def test_the_step_of_the_sweep_at_2_906_is_between_mirror_images_of_one_orbit() -> None:
    """Cells 452 and 453 of Fig. 6, from rest; the mirror image is -x(t + T/2) on the path of the other."""
    below, above = (cell_orbit({"omega": 2.0 + k * CELL}) for k in (452, 453))
    for found in (below, above):
        assert (found.cell["period"], bool(found.cell["symmetric"])) == (1, False)
    half = [-np.interp(orbit.period / 2, orbit.times, orbit.states[:, 0]) for orbit in (below, above)]
    assert below.section[0, 0] == pytest.approx(0.0350, abs=5e-5)
    assert above.section[0, 0] == pytest.approx(0.0312, abs=5e-5)
    assert half == pytest.approx([above.section[0, 0], below.section[0, 0]], abs=2e-4)
