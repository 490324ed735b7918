"""The fast simulator of free masses against the slow one, and random cells of the solver against the fast one."""

import math

import numpy as np
import pytest

from scripts.check_free_masses import check
from tests.oracle import simulate
from tests.oracle.machines import single_mass
from tests.oracle.shaken_mass import follow

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("seed", range(6))
def test_the_fast_simulator_of_free_masses_agrees_with_the_one_in_multiprecision(seed: int) -> None:
    """Truth: Taylor series in 30 digits. Chatter, rest and release are among the motions."""
    rng = np.random.default_rng(seed)
    box = seed % 2
    machine = {
        "load": -1.0 if not box else -float(rng.uniform(0.0, 0.5)),
        "omega": float(rng.uniform(0.5, 2.0)), "R": float(rng.uniform(0.1, 0.8)), "tau": float(rng.uniform(0.0, 6.0)),
    }  # fmt: skip
    force, lower, upper = float(rng.uniform(1.0, 2.0)), -1.0 * box, 1.0 if box else math.inf
    start = (float(rng.uniform(0.0, 0.9)), float(rng.uniform(-0.5, 0.5)))
    run = follow(force=force, lower=lower, upper=upper, start=start, periods=4, **machine)
    true = simulate(
        single_mass(damping=0, stiffness=0, force_sin=force, lower=lower, upper=upper, start=start, **machine),
        4, digits=30,
    )  # fmt: skip
    assert bool(true.stuck) == bool(run.rests.any())
    assert np.allclose(run.states, np.array(true.sections, dtype=float), rtol=0.0, atol=1e-8)


def test_random_cells_of_the_ball_and_the_impact_pair_are_what_an_independent_simulator_says() -> None:
    counts, faults = check(cells=60, seed=2, tolerance=0.02)
    assert not faults
    assert all(found.get("sticking") and found.get("periodic") for found in counts.values())
