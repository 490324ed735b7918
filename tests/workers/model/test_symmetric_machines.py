"""Which machines are symmetric: decided to the rounding of their entries, and then exactly so."""

from typing import Any

import numpy as np
import pytest
from mpmath import mp

from atlas.query.machine import has_twins
from tests.oscillators import build_one, rigid_machines
from tests.workers.model.test_systems import table
from workers import System, solve_tile
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import STUCK
from workers.kernel.period import mirror, propagate
from workers.model.oscillator import COLUMN, Oscillator
from workers.results import NO_IMPACT, NO_REASON, PERIODIC


def positive(rng: np.random.Generator, n: int, decades: float) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    matrix = turn @ np.diag(10.0 ** rng.uniform(0.0, decades, n)) @ turn.T
    return 0.5 * (matrix + matrix.T)


def chain(of: np.ndarray) -> np.ndarray:
    """The matrix of springs or dampers in a row, tied to nothing."""
    matrix = np.zeros((len(of) + 1, len(of) + 1))
    for i, k in enumerate(of):
        matrix[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return matrix


def machine(**given: Any) -> Oscillator:
    n = len(given["mass"])
    fields = {
        "force_sin": np.ones((1, n)), "force_cos": np.zeros((1, n)), "load": np.zeros(n), "omega": 1.0, "tau": 0.0,
        "R": 0.8,
    } | given  # fmt: skip
    return build_one(rigid_machines(**{name: np.asarray(v)[None] for name, v in fields.items()}))


def preloaded(rng: np.random.Generator, decades: float = 2.0) -> dict[str, Any]:
    """A machine under a load, with stops at equal distances from where it rests: truth from 40 digits."""
    n = int(rng.integers(1, 6))
    stiffness, row, load = positive(rng, n, decades), rng.normal(size=n), rng.normal(size=n)
    with mp.workdps(40):
        x = mp.lu_solve(mp.matrix(stiffness.tolist()), mp.matrix(load.tolist()))
        y0 = float(sum(mp.mpf(float(g)) * x[i] for i, g in enumerate(row)))
    half = 10.0 ** rng.uniform(-2.0, 1.0)
    return {
        "mass": positive(rng, n, 1.0), "damping": 0.1 * positive(rng, n, 1.0), "stiffness": stiffness, "gap_row": row,
        "load": load, "upper": y0 + half, "lower": y0 - half,
    }  # fmt: skip


def afloat(rng: np.random.Generator, loaded: bool) -> dict[str, Any]:
    """A machine tied to nothing, between stops off centre, under loads that cancel."""
    n = int(rng.integers(2, 6))
    middle, half = rng.normal() * 10.0 ** rng.uniform(-1, 2), 10.0 ** rng.uniform(-2.0, 1.0)
    load = rng.normal(size=n) * loaded
    return {
        "mass": np.diag(rng.uniform(0.5, 2.0, n)), "damping": chain(rng.random(n - 1)),
        "stiffness": chain(10.0 ** rng.uniform(0.0, 3.0, n - 1)), "gap_row": np.eye(n)[rng.integers(n)],
        "load": load - load.mean(), "upper": middle + half, "lower": middle - half,
    }  # fmt: skip


@pytest.mark.parametrize("decades", [0.5, 3.0, 6.0])
def test_stops_equally_far_from_rest_under_a_load_are_symmetric(decades: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        found = machine(**preloaded(rng, decades))
        assert found.symmetric == 1.0 and found.b_upper == found.b_lower


@pytest.mark.parametrize("loaded", [False, True])
def test_equal_stops_of_a_machine_tied_to_nothing_are_symmetric_wherever_they_are(loaded: bool) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        found = machine(**afloat(rng, loaded))
        assert found.symmetric == 1.0 and found.b_upper == found.b_lower


def test_stops_that_differ_by_more_than_rounding_are_not_symmetric() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        given = preloaded(rng, 0.5)
        off = 1e-12 * (abs(given["upper"]) + abs(given["lower"]) + np.abs(given["load"]).sum())
        assert machine(**(given | {"upper": given["upper"] + off})).symmetric == 0.0
        tied = afloat(rng, loaded=True)
        assert machine(**(tied | {"load": tied["load"] + 1e-9})).symmetric == 0.0


def test_what_holds_y_at_either_stop_of_a_symmetric_machine_is_exactly_opposite() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        held = machine(**preloaded(rng)).sticking  # counted from rest, the stops lie at opposite places
        assert held.offset[0, 0] == 0.0
        assert not held.blocks[..., COLUMN.rest0 :].any()


def test_two_half_turns_of_a_loaded_machine_that_sticks_are_a_whole_one() -> None:
    """G o G = P with G(z) = -P_{T/2}(z), where the mass rests on both stops."""
    given = {
        "mass": np.diag([1.0, 2.0]), "damping": [[0.1, -0.1], [-0.1, 0.6]], "stiffness": [[1.0, -1.0], [-1.0, 6.0]],
        "gap_row": [1.0, 0.0], "load": [0.3, -0.7], "force_sin": [[1.0, 0.0]],
    }  # fmt: skip
    y0 = float(np.linalg.solve(given["stiffness"], given["load"])[0])
    osc = machine(**given, omega=0.7, upper=y0 + 0.15, lower=y0 - 0.15, R=0.3)
    whole, half = (motion_from(osc, np.array([y0, 0.0, 0.0, 0.0])) for _ in range(2))
    assert osc.symmetric == 1.0
    for _ in range(3):
        propagate(osc, whole, osc.period)
        for _ in range(2):
            propagate(osc, half, 0.5 * osc.period)
            mirror(half)
        assert blocks_to_physical(osc, half) == pytest.approx(blocks_to_physical(osc, whole), abs=1e-12)
    assert whole.tally[STUCK] > 0.0


def test_matrices_that_rounding_has_made_unsymmetric_are_made_symmetric() -> None:
    system = System.from_mapping(table(stiffness=[[1.0, "-0.1 * 3"], [-0.3, "1 + k"]]))
    machines = system.definition.machines({p.name: np.array([p.default]) for p in system.parameters})
    assert machines.stiffness[0, 0, 0, 1] == machines.stiffness[0, 0, 1, 0] == pytest.approx(-0.3, rel=1e-15)
    values = {p.name: np.full(2, p.default) for p in system.parameters}
    assert system.build_many(values)[1].tolist() == [NO_REASON, NO_REASON]


def test_matrices_that_differ_by_more_than_rounding_stay_as_they_are() -> None:
    system = System.from_mapping(table(stiffness=[[1.0, -0.3], [-0.3 * (1.0 + 1e-13), "1 + k"]]))
    machines = system.definition.machines({p.name: np.array([p.default]) for p in system.parameters})
    assert machines.stiffness[0, 0, 0, 1] != machines.stiffness[0, 0, 1, 0]
    values = {p.name: np.full(2, p.default) for p in system.parameters}
    assert system.build_many(values)[1].tolist() == [NO_REASON, NO_REASON]


# Machines with modes

LOADED = {
    "name": "loaded", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.2]], "stiffness": [[1.0]], "force": [1.0],
    "load": [3.0],
}  # fmt: skip
STOPS = {"gap": [1.0], "upper": 4.0, "lower": 2.0}


def twins(system: System) -> bool:
    return bool(has_twins(system, {p.name: p.default for p in system.parameters}, {"omega": np.ones(1)})[0])


@pytest.mark.parametrize(
    "contacts",
    [
        STOPS | {"restitution": 0.8},
        {"contacts": [{"name": "stops", "restitution": 0.8, **STOPS},
                      {"name": "far", "gap": [1.0], "upper": 30.0, "lower": -24.0, "stiffness": 1.0}]},
        {"contacts": [{"name": "stops", "stiffness": 20.0, **STOPS}]},
    ],
    ids=["rigid", "with modes", "soft"],
)  # fmt: skip
def test_symmetry_counts_from_rest_in_all_kinds_of_machine(contacts: dict[str, Any]) -> None:
    """Rest is at 3, midway between the stops; two motions strike both, and one strikes none."""
    system = System.from_mapping(LOADED | contacts)
    found = solve_tile(system, {"omega": np.array([1.0, 1.3, 2.0]), "x": 3.1})
    assert found["regime"].tolist() == [PERIODIC, PERIODIC, NO_IMPACT]
    assert found["symmetric"].all()
    assert twins(system)
    aside = System.from_mapping(LOADED | {"load": [3.0 + 1e-9]} | contacts)
    assert not twins(aside)
    assert not solve_tile(aside, {"omega": np.array([1.0, 1.3, 2.0]), "x": 3.1})["symmetric"].any()


def test_a_free_mass_with_modes_is_symmetric_wherever_its_stops_are() -> None:
    soft = [{"name": "stops", "gap": [1.0], "upper": 7.0, "lower": 6.0, "stiffness": 20.0}]
    free = {key: value for key, value in LOADED.items() if key not in ("stiffness", "load")} | {"contacts": soft}
    assert twins(System.from_mapping(free))
    assert not twins(System.from_mapping(free | {"load": [0.1]}))
