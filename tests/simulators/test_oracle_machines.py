"""The oracle on machines of every kind: against matrix exponentials, invariants and other coordinates."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpmath import mp

from tests.exponential import flown
from tests.paths import DATA
from tests.support.oracle import (
    OracleMachine,
    simulate,
    two_mass,
)
from tests.support.oracle.machines import DAMPINGS, random_machine, rigid_mode
from tests.support.oracle.simulate import first_hit

pytestmark = pytest.mark.slow

EARLIER: dict[str, Any] = json.loads((DATA / "oracle_two_mass.json").read_text())
FREE = {"upper": math.inf, "lower": -math.inf}


def drawn(seed: int, n: int, **kind: Any) -> OracleMachine:
    return random_machine(np.random.default_rng([seed, n]), n, **kind)


def distance(a: list, b: list) -> mp.mpf:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def floats(matrix: Any) -> np.ndarray:
    return np.array(matrix, dtype=float)


# Two masses


@pytest.mark.parametrize("name", EARLIER)
def test_two_masses_move_as_an_earlier_simulator_of_them_alone_said(name: str) -> None:
    """Truth: this oracle before it knew other machines; it also jumped to rest within 1e-13 of a time scale."""
    known = EARLIER[name]
    run = simulate(known["params"], known["periods"], rest=1e-13)
    with mp.workdps(40):
        assert distance(run.sections[-1], [mp.mpf(value) for value in known["section"]]) < 1e-32
        assert abs(run.impacts[-1].t - mp.mpf(known["last_impact"])) < 1e-31
    assert (len(run.impacts), len(run.stuck)) == (known["impacts"], known["stuck"])


@pytest.mark.parametrize("name", ["chaos of fig. 5", "rests"])
def test_the_motion_does_not_depend_on_the_coordinates_in_which_the_matrices_are_given(name: str) -> None:
    """x = P w turns every matrix full, and the gap row too; impacts and rest of w are those of x."""
    with mp.workdps(40):
        plain = two_mass(EARLIER[name]["params"])
        P = mp.matrix([[1, mp.mpf("0.5")], [mp.mpf("-0.75"), 2]])
        mass, damping, stiffness = (
            (P.T * mp.matrix(rows) * P).tolist() for rows in (plain.mass, plain.damping, plain.stiffness)
        )
        other = replace(
            plain, mass=mass, damping=damping, stiffness=stiffness, gap_row=list(P.T * mp.matrix(plain.gap_row)),
            force_sin=[list(P.T * mp.matrix(plain.force_sin[0]))],
        )  # fmt: skip
        a, b = simulate(plain, 3, rest=1e-14), simulate(other, 3, rest=1e-14)
        assert len(a.impacts) == len(b.impacts) > 3
        for x, w in zip(a.sections, b.sections, strict=True):
            assert distance(x, [*(P * mp.matrix(w[:2])), *(P * mp.matrix(w[2:]))]) < 1e-31


# Flights and rests against matrix exponentials


@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("rigid", [False, True], ids=["", "rigid"])
@pytest.mark.parametrize("n", [1, 3, 8])
def test_a_flight_is_the_matrix_exponential(n: int, rigid: bool, damping: str) -> None:
    machine = replace(drawn(1, n, rigid=rigid, damping=damping, one_sided=False), **FREE)
    with mp.workdps(40):
        T = 2 * mp.pi / mp.mpf(machine.omega)
        exact = flown(machine, machine.start, 2 * T)
        size = max(abs(value) for value in exact)
        assert distance(simulate(machine, 2).sections[2], exact) < 1e-34 * size


def pressed(n: int, rigid: bool, side: int) -> OracleMachine:
    """A machine that a large load presses on a stop on which it lies."""
    free = replace(drawn(2, n, rigid=rigid, damping="general", one_sided=False), **FREE)
    g = mp.matrix([mp.mpf(value) for value in free.gap_row])
    x, v = (np.array(half) for half in np.split(np.array(free.start), 2))
    v -= free.gap_row * (free.gap_row @ v) / (free.gap_row @ free.gap_row)
    stop = (g.T * mp.matrix([mp.mpf(value) for value in x]))[0]
    ends = {"upper": stop, "lower": -math.inf} if side > 0 else {"upper": math.inf, "lower": stop}
    with mp.workdps(60):  # the velocity of the gap coordinate is to vanish beyond the digits of the simulation
        v = mp.matrix([mp.mpf(value) for value in v])
        v -= g * (g.T * v)[0] / (g.T * g)[0]
    return replace(free, load=side * 1e3 * free.gap_row, start=[*map(mp.mpf, x), *v], **ends)


@pytest.mark.parametrize("rigid", [False, True], ids=["", "rigid"])
@pytest.mark.parametrize(("n", "side"), [(2, 1), (3, -1), (8, 1)])
def test_a_machine_pressed_on_a_stop_moves_as_the_constrained_matrix_exponential(
    n: int, side: int, rigid: bool
) -> None:
    with mp.workdps(40):
        machine = pressed(n, rigid, side)
        T = 2 * mp.pi / mp.mpf(machine.omega)
        run = simulate(machine, 1)
        assert [(stay.side, stay.end) for stay in run.stuck] == [(side, T)]
        exact = flown(machine, machine.start, T, held=True)
        assert distance(run.sections[1], exact) < 1e-33 * max(abs(value) for value in exact)


@pytest.mark.parametrize("n", [1, 3, 8])
def test_one_impact_turns_the_gap_velocity_and_kicks_along_the_gap_row_only(n: int) -> None:
    """Truth: matrix exponentials to the impact and from it, and Newton's law between them."""
    machine = drawn(5, n, one_sided=True, R=0.6)
    with mp.workdps(40):
        hit, *later = simulate(machine, 3).impacts
        end = 2 * mp.pi / mp.mpf(machine.omega) * mp.ceil(hit.t * mp.mpf(machine.omega) / (2 * mp.pi))
        others = [impact for impact in later if impact.t < end]
        g = mp.matrix([mp.mpf(value) for value in machine.gap_row])
        kick = mp.lu_solve(mp.matrix([list(map(mp.mpf, row)) for row in machine.mass]), g)
        before = flown(machine, machine.start, hit.t)
        x, v = mp.matrix(before[:n]), mp.matrix(before[n:])
        stop = machine.upper if hit.side > 0 else machine.lower
        speed = (g.T * v)[0]
        assert abs((g.T * x)[0] - stop) < 1e-33
        assert abs(hit.side * speed - hit.speed) < 1e-33
        v -= (1 + mp.mpf(0.6)) * speed * kick / (g.T * kick)[0]
        following = first_hit(machine, [*x, *v], hit.t, float(end - hit.t))
        second = others[0].t - hit.t if others else None
        assert (following is None) == (second is None)
        if following is not None:
            assert abs(following.t - second) < 1e-33


# Laws


@pytest.mark.parametrize("rigid", [False, True], ids=["", "rigid"])
@pytest.mark.parametrize("n", [1, 3, 8])
def test_elastic_impacts_keep_the_energy_of_an_undamped_machine_under_its_load(n: int, rigid: bool) -> None:
    machine = drawn(3, n, rigid=rigid, damping="none", one_sided=False, R=1.0)
    none = np.zeros_like(machine.force_sin)
    machine = replace(machine, force_sin=none, force_cos=none, start=machine.start * np.repeat([1.0, 20.0], n))

    def energy(state: list) -> mp.mpf:
        x, v = mp.matrix(state[:n]), mp.matrix(state[n:])
        M, K = (mp.matrix([list(map(mp.mpf, row)) for row in rows]) for rows in (machine.mass, machine.stiffness))
        load = mp.matrix([mp.mpf(value) for value in machine.load])
        return (v.T * M * v / 2 + x.T * K * x / 2 - load.T * x)[0]

    run = simulate(machine, 3)
    assert len(run.impacts) > 2
    with mp.workdps(40):
        first, last = energy([mp.mpf(value) for value in machine.start]), energy(run.sections[-1])
        assert abs(last - first) < 1e-33 * max(1, abs(first))


def test_two_free_masses_collide_head_on_as_in_the_textbook() -> None:
    """Masses 1 and 3, speeds 2 and -1, R = 1/2: momentum stays, the relative velocity is halved and turned."""
    none = [[0, 0], [0, 0]]
    pair = OracleMachine([[1, 0], [0, 3]], none, none, [1, -1], [[0, 0]], [[0, 0]], [0, 0], 4.0, 0.0, 0.0, -math.inf,
    0.5,
                   start=[-1, 1, 2, -1])  # fmt: skip
    run = simulate(pair, 1)
    with mp.workdps(40):
        assert abs(run.impacts[0].t - mp.mpf(2) / 3) < 1e-38
        left = mp.pi / 2 - mp.mpf(2) / 3
        velocities = [mp.mpf(-11) / 8, mp.mpf(1) / 8]
        exact = [mp.mpf(1) / 3 + velocity * left for velocity in velocities]
        assert distance(run.sections[1], [*exact, *velocities]) < 1e-37


# Random machines


@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_random_machines_are_what_they_are_asked_to_be(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(50):
        machine = random_machine(rng, n)
        M, C, K, g = (np.asarray(part) for part in (machine.mass, machine.damping, machine.stiffness, machine.gap_row))
        assert np.linalg.eigvalsh(M)[0] > 0.1
        assert np.linalg.eigvalsh(K)[0] > -1e-12
        assert np.linalg.eigvalsh(C)[0] > -1e-12
        assert machine.lower < g @ machine.start[:n] < machine.upper
        assert np.any(machine.force_sin) or np.any(machine.force_cos)


@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_a_rigid_machines_springs_are_singular_exactly_and_its_gap_sees_the_mode(n: int) -> None:
    for seed in range(20):
        machine = drawn(seed, n, rigid=True)
        mode = rigid_mode(machine)
        assert abs(machine.gap_row @ mode) > 0.1 * np.linalg.norm(machine.gap_row)
        exact = np.round(mode / mode[0] * 2.0**n) / 2.0**n  # short binary fractions, as the springs are
        assert not np.any(machine.stiffness @ exact)


def test_random_machines_hit_stops_and_some_of_them_rest() -> None:
    runs = [simulate(drawn(seed, 2), 3, digits=25) for seed in range(30)]
    assert sum(bool(run.impacts) for run in runs) > 20
    assert 3 < sum(bool(run.stuck) for run in runs) < 20
