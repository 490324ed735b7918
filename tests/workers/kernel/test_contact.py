"""The contact of a state: carried with it, and one rule for a physical state alone."""

import numpy as np
import pytest

from atlas.cell.trajectory import cell_orbit
from tests import naive
from tests.oscillators import mass_spring
from workers import Settings, solve_tile
from workers.attractors.basins import AttractorTable, section_points
from workers.attractors.initial_states import AttractorSettings
from workers.attractors.matching import mirror_states
from workers.cell.cell_batch import CellBatch
from workers.cell.outcome import end_stopped
from workers.kernel.cell_loops import physical_states, start_motions
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import BEYOND, FLIGHT, STARTED_BEYOND, STATUS, motion_at, motions_at
from workers.kernel.period import propagate
from workers.model.hybrid_modes import DETACHED, ON, OPEN
from workers.model.oscillator import Oscillator, at_rows, many_of
from workers.model.system import find_system, system_names
from workers.results import BEYOND_STOP, INVALID, NO_REASON, InvalidError, empty_results, result_variables
from workers.sweep import solve_lines

EPS = float(np.finfo(np.float64).eps)
MANY = 60
HELD_AT_THE_SECTION = {
    "omega": [0.41797895930485846, 0.9239843009501818, 1.5005892077185106, 0.7476029724453628, 0.8587062795321496],
    "b": [0.9793474223262524, 0.44422778325219503, 0.059553859227722425, 1.0801507581111363, 0.14411791025369586],
    "R": [0.3125221060913206, 0.3348785395614185, 0.15939137711396484, 0.049771439293739755, 0.061924622664184796],
    "mu": [0.8287025575364736, 0.062357289706141024, 0.46412216228416475, 0.7394663395863396, 0.2745046303644355],
    "tau": [3.0906735813455866, 4.774195142222605, 5.106413183807297, 0.3273219261046932, 5.017737537467905],
}
"""Impact dampers that rest on a stop at every section; rounding decides on which side of it x2 - x1 comes out."""


def packaged(name: str) -> Oscillator:
    """Many machines of a system, with phases, and clearances where it has any, of awkward digits."""
    system, rng = find_system(name), np.random.default_rng(4)
    values = {p.name: np.full(MANY, p.default) for p in system.parameters} | {"tau": rng.uniform(0.0, 6.0, MANY)}
    values |= {"b": rng.uniform(0.1, 3.0, MANY)} if "b" in values else {}
    oscillators, reasons = system.build_many(values)
    assert np.all(reasons == NO_REASON)
    return oscillators


def own(*gap: float, stop: float = 0.3) -> Oscillator:
    """A chain of masses with this gap row, many times."""
    n = len(gap)
    spring = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    osc = mass_spring(
        mass=np.diag(np.linspace(1.0, 0.3, n)), damping=0.1 * spring, stiffness=spring, gap_row=gap,
        force=np.ones(n), omega=1.1, tau=0.7, b_upper=stop, b_lower=0.9, R=0.5,
    )  # fmt: skip
    return at_rows(many_of(osc), np.zeros(MANY, dtype=np.int64))


MACHINES = {
    **{name: lambda name=name: packaged(name) for name in system_names() if not find_system(name).has_modes},
    "weight .3": lambda: own(0.3),
    "weight .3, stop at 0": lambda: own(0.3, stop=0.0),
    "weights .3, -.7": lambda: own(0.3, -0.7),
    "weights .3, -.7, stop at 0": lambda: own(0.3, -0.7, stop=0.0),
    "three weights": lambda: own(1.0 / 3.0, 2.0 / 7.0, -0.9),
}


@pytest.mark.parametrize("kind", MACHINES)
def test_a_resting_state_keeps_its_stop_and_its_place_through_blocks_and_back(kind: str) -> None:
    """Truth: the state that began. Terms that add up to it are rounded, at most 32 times each."""
    oscillators = MACHINES[kind]()
    rng, rows, n = np.random.default_rng(9), np.arange(MANY), oscillators.gap_row.shape[1]
    upper, lower = np.isfinite(oscillators.upper), np.isfinite(oscillators.lower)
    side = np.where(upper & (~lower | (rows % 2 == 0)), 1, -1)
    given = motions_at(rng.normal(size=(MANY, n, 2)), FLIGHT + side[:, None] * ON)
    states = physical_states(oscillators, given, rows)
    found = motions_at(np.zeros((MANY, n, 2)))
    start_motions(oscillators, found, states, rows)
    mode = found.mode[:, 0].copy()
    np.testing.assert_array_equal(np.sign(mode - FLIGHT), side)
    assert set(np.abs(mode - FLIGHT)) <= {ON, DETACHED}
    again = physical_states(oscillators, found, rows)
    blocks = np.abs(oscillators.to_blocks) @ np.abs(states)[..., None]
    terms = blocks[..., 0] + (oscillators.gap.swing + np.abs(oscillators.gap.rest)).reshape(MANY, 2 * n)
    size = (np.abs(oscillators.to_physical) @ terms[..., None])[..., 0]
    assert np.all(np.abs(again - states) <= 32.0 * EPS * size)
    start_motions(oscillators, found, again, rows)
    np.testing.assert_array_equal(found.mode[:, 0], mode)


@pytest.mark.parametrize(
    ("beyond", "rate", "mode"),
    [
        (0.0, 0.0, FLIGHT + ON),
        (4.0, 4.0, FLIGHT + ON),
        (-4.0, -4.0, FLIGHT + ON),
        (4.0, 1e6, FLIGHT),
        (-1e6, 0.0, FLIGHT),
    ],
)
def test_what_is_within_rounding_of_a_stop_is_on_it(beyond: float, rate: float, mode: int) -> None:
    """Two coordinates that add up to the gap, in units in the last place of these; a load presses on the stop."""
    osc = mass_spring(
        mass=np.eye(2), damping=0.1 * np.eye(2), stiffness=np.eye(2), gap_row=[-1.0, 1.0], force=[0.1, 0.0],
        omega=1.0, tau=0.0, b_upper=1.0, b_lower=2.0, R=0.5, load=[-5.0, 5.0],
    )  # fmt: skip
    state = np.array([-0.5, 0.5 + beyond * EPS, 0.7, 0.7 + rate * EPS])
    assert motion_from(osc, state).mode[0] == mode


def test_a_state_further_out_than_rounding_has_no_motion() -> None:
    osc, _ = naive.two_mass(**naive.STICKING)
    with pytest.raises(InvalidError, match="beyond a stop"):
        motion_from(osc, np.array([osc.upper * (1.0 + 32.0 * EPS), 0.0, 0.0, 0.0]))


def test_a_motion_beyond_a_stop_goes_nowhere_and_is_invalid_for_that_reason() -> None:
    osc, _ = naive.two_mass(**naive.STICKING)
    h = np.full((2, 2), 0.1)
    motion = motion_at(h, BEYOND)
    propagate(osc, motion, osc.period)
    assert motion.tally[STATUS] == STARTED_BEYOND
    np.testing.assert_array_equal(motion.h, h)
    settings = Settings()
    found = empty_results(result_variables(settings), (1,), {"exponent": 4, "state": 4, "sample": 0})
    cells = CellBatch(many_of(osc), np.array([NO_REASON], dtype=np.int8), np.zeros((1, 4)), settings, found)
    cells.batch.motions.mode[0, 0] = BEYOND
    cells.set_interval(cells.unfinished, 1)
    cells.run(cells.unfinished)
    assert cells.unfinished.size == 1 and end_stopped(cells, cells.unfinished).size == 0
    assert (found["regime"][0], found["reason"][0]) == (INVALID, BEYOND_STOP)


def test_a_motion_that_goes_on_has_the_contact_that_it_had() -> None:
    """Truth: the contact given, about to leave, where the load shows the state held."""
    osc, _ = naive.two_mass(**naive.STICKING)
    settings, state = Settings(), np.array([[osc.upper, 0.4, 0.0, 0.0]])
    shown = motion_from(osc, state[0]).mode[0]
    other = FLIGHT + (DETACHED if shown == FLIGHT + ON else ON)
    for mode, expected in ((None, shown), (np.array([other]), other)):
        found = empty_results(result_variables(settings), (1,), {"exponent": 4, "state": 4, "sample": 0})
        cells = CellBatch(many_of(osc), np.array([NO_REASON], dtype=np.int8), state, settings, found, mode)
        assert cells.batch.motions.mode[0, 0] == expected


def test_a_mirror_image_has_the_contact_of_its_own_instant() -> None:
    """Truth: half a period of the motion itself, turned round; motions that begin at rest on a stop."""
    seen = set()
    for tau, x2, side in ((0.0, -1.2, -1), (0.0, 0.4, 1), (0.0, 0.4, -1), (1.0, 0.0, 1), (2.0, 0.0, 1), (5.0, 0.0, 1)):
        osc, _ = naive.two_mass(**(naive.STICKING | {"tau": tau}))
        motion = motion_from(osc, np.array([side * osc.upper, x2, 0.0, 0.0]))
        mode = int(motion.mode[0])
        images, its = mirror_states(many_of(osc), blocks_to_physical(osc, motion)[None], motion.mode.copy())
        propagate(osc, motion, 0.5 * osc.period)
        later = osc._replace(tau=osc.tau + 0.5 * osc.period * osc.gap.omega)
        assert images[0] == pytest.approx(-blocks_to_physical(later, motion), abs=1e-12)
        assert its[0] - FLIGHT == FLIGHT - motion.mode[0]
        seen.add((mode - FLIGHT, int(motion.mode[0]) - FLIGHT))
    assert seen >= {(ON, OPEN), (ON, ON), (ON, -ON), (DETACHED, ON), (-DETACHED, ON)}


def test_cells_that_rest_at_the_section_have_the_same_orbit_from_their_stored_state() -> None:
    settings = Settings(max_periods=500, survival=0)
    found = solve_tile("impact-damper", HELD_AT_THE_SECTION, settings)
    names = find_system("impact-damper").states
    again = solve_tile("impact-damper", HELD_AT_THE_SECTION | dict(zip(names, found["state"].T, strict=True)), settings)
    assert np.all(found["sticks"]) and np.all(found["period"] == 1)
    for name in ("regime", "reason", "period", "sticks", "symmetric"):
        np.testing.assert_array_equal(again[name], found[name])
    assert again["state"] == pytest.approx(found["state"], abs=1e-12)
    assert again["largest"] == pytest.approx(found["largest"], rel=1e-6)


def test_a_sweep_goes_on_past_cells_that_rest_at_the_section() -> None:
    """Truth: each cell begins at a state on the attractor of the one before, with the same stops: inside them."""
    swept = {"omega": np.linspace(1.5, 0.5, 20), "b": 0.3, "R": 0.2, "mu": 0.5}
    found = solve_lines("impact-damper", swept, Settings(max_periods=500, survival=0))
    assert not np.any(found["regime"] == INVALID)
    assert np.count_nonzero(found["sticks"]) > 10


def test_a_gap_of_two_coordinates_that_closes_in_leaves_no_mass_beyond_its_stop() -> None:
    """Truth: solve_tile calls a start beyond a stop invalid; 200 clearances of awkward digits."""
    b = np.stack([np.full(200, 0.9), np.random.default_rng(5).uniform(1e-6, 0.2, 200)])
    settings = Settings(exponents="none", max_periods=1)
    solved = solve_lines("impact-damper", {"omega": 1.0, "b": b, "x1": 0.7, "x2": 1.5}, settings, axis=0)
    assert not np.any(solved["regime"] == INVALID)


def test_section_points_of_an_attractor_that_rests_at_the_section_stay_there() -> None:
    """Truth: orbits of one period, each followed for three as if it did not close."""
    system = find_system("impact-damper")
    for k in range(5):
        cell = {name: values[k] for name, values in HELD_AT_THE_SECTION.items()}
        values = {p.name: p.default for p in system.parameters} | cell
        table = AttractorTable(system, values, Settings(max_periods=500, survival=0), AttractorSettings(1))
        (only,) = table.attractors
        assert (abs(only.mode - FLIGHT), only.period) == (ON, 1)
        only.period = 0
        points = section_points(table, 3)[0]
        assert points == pytest.approx(np.tile(only.result["state"], (3, 1)), abs=1e-12)


@pytest.mark.slow
def test_the_path_of_a_cell_that_rests_at_the_section_closes() -> None:
    cell = {name: values[1] for name, values in HELD_AT_THE_SECTION.items()}
    orbit = cell_orbit(cell, "impact-damper", Settings(max_periods=500, survival=0))
    assert orbit.states[-1] == pytest.approx(orbit.states[0], abs=1e-10)
    assert np.abs(orbit.gap(orbit.states)).max() <= cell["b"] * (1.0 + 1e-12)
