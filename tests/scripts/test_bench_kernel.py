"""The benchmark's reference is right, and its light mode runs. No time is asserted."""

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest

from scripts.general_integrator import FIGURES, GeneralIntegrator, compiled_rates, numpy_rates
from tests.oracle import symmetric_orbit
from tests.paths import ROOT

pytestmark = pytest.mark.slow

# Figs 3 and 4 in 40-digit arithmetic, Fig. 5 from long averages; so far may 2100 periods be off, four standard errors
# of the chaotic one among it.
EXACT = {
    "3": [-0.235569640371152, -0.235569640371152, -0.524876727616246, -0.524876727616246],
    "4": [-0.475914135412643, -2.614830482264854, -2.614830482264854, -7.598746373733903],
    "5": [1.123, -1.577, -1.582, -4.38],
}
# Of the soft stop: half the logarithm of the product of its multipliers -.8074860407841 +- .4733540570223 i.
SOFT = [0.5 * math.log(0.8074860407841**2 + 0.4733540570223**2)] * 2
# Flights in a period: one more than impacts, of which Figs 3 and 4 have two and four, Fig. 5 2.63 on average.
FLIGHTS = {"3": 3.0, "4": 5.0, "5": 3.63}
ROOM = {"3": 2e-3, "4": 5e-3, "5": 0.08}


def test_reference_has_the_closed_form_exponents_of_fig_3() -> None:
    reference = GeneralIntegrator(FIGURES["3"], 4, compiled_rates)
    reference.run(110)
    multipliers = np.linalg.eigvals(reference.one_period(np.eye(4)))
    exact = [float(value) for value in symmetric_orbit(FIGURES["3"])[0].exponents]
    assert sorted(np.log(np.abs(multipliers)), reverse=True) == pytest.approx(exact, abs=1e-9)


def test_both_right_hand_sides_are_the_same() -> None:
    reference = GeneralIntegrator(FIGURES["5"], 4)
    flat = np.random.default_rng(1).normal(size=20)
    arguments = (0.7, flat, reference.A, reference.force, 3.0, 0.4)
    assert compiled_rates(*arguments) == pytest.approx(numpy_rates(*arguments), abs=1e-12)


def test_light_mode_reports_the_right_exponents_at_every_figure() -> None:
    command = [sys.executable, "-m", "scripts.bench_kernel", "--light", "--json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    printed = subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
    every = json.loads(printed)
    rows, soft = every[:9], every[9:]
    assert [(row["figure"], row["exponents"]) for row in rows] == [(f, n) for f in "345" for n in (0, 1, 4)]
    for row in rows:
        # Each flight is evaluated at least once, and the certified march needs few evaluations: 2.7 to 3.6 on average.
        assert 1.0 < row["evaluations_per_period"] / FLIGHTS[row["figure"]] < 5.0
        if row["exponents"] == 0:
            continue
        exact = EXACT[row["figure"]][: row["exponents"]]
        assert row["solver_exponents"] == pytest.approx(exact, abs=ROOM[row["figure"]])
        assert np.isfinite(row["dop853_exponents"]).all()
    assert [row["exponents"] for row in soft] == [0, 1, 2]
    for row in soft:
        assert row["solver_exponents"] == pytest.approx(SOFT[: row["exponents"]], abs=2e-3)
