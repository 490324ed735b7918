"""Benchmarks run, in their light modes, and what they measure is right. No time is asserted."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scripts.general_integrator import FIGURES, GeneralIntegrator, compiled_rates, numpy_rates
from scripts.heyoka_reference import INSTALLED, Taylor
from tests.paths import ROOT
from tests.script import script
from tests.support.oracle import symmetric_orbit

pytestmark = pytest.mark.slow

# Figs 3 and 4 in 40-digit arithmetic, Fig. 5 from long averages; so far may 2100 periods be off, four standard errors
# of the chaotic one among it.
EXACT = {
    "3": [-0.235569640371152, -0.235569640371152, -0.524876727616246, -0.524876727616246],
    "4": [-0.475914135412643, -2.614830482264854, -2.614830482264854, -7.598746373733903],
    "5": [1.123, -1.577, -1.582, -4.38],
}
ROOM = {"3": 2e-3, "4": 5e-3, "5": 0.08}
# Of the soft stop: half the logarithm of the product of its multipliers -.8074860407841 +- .4733540570223 i.
SOFT = [0.5 * math.log(0.8074860407841**2 + 0.4733540570223**2)] * 2
# Flights in a period: one more than impacts, of which Figs 3 and 4 have two and four, Fig. 5 2.63 on average.
FLIGHTS = {"3": 3.0, "4": 5.0, "5": 3.63}


def test_the_general_integrator_has_the_closed_form_exponents_of_fig_3() -> None:
    reference = GeneralIntegrator(FIGURES["3"], 4, compiled_rates)
    reference.run(110)
    multipliers = np.linalg.eigvals(reference.one_period(np.eye(4)))
    exact = [float(value) for value in symmetric_orbit(FIGURES["3"])[0].exponents]
    assert sorted(np.log(np.abs(multipliers)), reverse=True) == pytest.approx(exact, abs=1e-9)


def test_both_right_hand_sides_of_the_general_integrator_are_the_same() -> None:
    reference = GeneralIntegrator(FIGURES["5"], 4)
    flat = np.random.default_rng(1).normal(size=20)
    arguments = (0.7, flat, reference.A, reference.force, 3.0, 0.4)
    assert compiled_rates(*arguments) == pytest.approx(numpy_rates(*arguments), abs=1e-12)


@pytest.mark.skipif(not INSTALLED, reason="heyoka is not installed")
@pytest.mark.parametrize("figure", ["3", "4"])
def test_heyoka_finds_the_40_digit_exponents(figure: str) -> None:
    """Its schedule of 2000 periods, averaged plainly, is as good as 1 / 2000."""
    _, _, (largest,) = Taylor(1).run(FIGURES[figure], (2000,))[0]
    assert largest == pytest.approx(EXACT[figure][0], abs=1e-3)


def test_periods_are_measured_with_the_right_exponents_at_every_figure() -> None:
    every = json.loads(script("bench_kernel", "--light", "--json"))
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


def test_cells_are_measured_that_are_what_their_names_say_beside_another_version() -> None:
    shown = script("bench_cell", "--light", "--against", str(ROOT))
    assert f"\n{shown}".count("\n| ") == 2 + 6 + 9
    assert "nan" not in shown


def test_work_and_precision_of_every_method_are_reported_and_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "work_precision.png"
    result = json.loads(script("bench_work_precision", "--light", "--json", "--picture", str(picture)))
    methods = {point["method"] for point in result["points"]}
    assert methods == {"adaptive", "fixed", "DOP853"} | ({"heyoka"} if INSTALLED else set())
    assert {cell["group"] for cell in result["cells"]} == {"figures", "orbits", "window", "chaotic"}
    assert result["curves"]["adaptive"]["periodic"][0]["error"] < 1e-10
    assert picture.stat().st_size > 10000


def test_the_service_is_measured_on_a_cluster_and_at_each_look_at_the_store() -> None:
    shown = script("bench_scale", "--workers", "2", "--seconds", "0.05", "--side", "2048", "--delay", "0.001")
    assert "| 2 | 64 |" in shown
    assert "| status of a running atlas, first and next |" in shown
    assert "| status of a finished atlas, first and next |" in shown


def test_more_watching_costs_more_and_leaves_no_more_wrong() -> None:
    options = ("--side", "16", "--far", "20000", "--tolerance", "0.05", "--survivals", "0,40000")
    rows = script("bench_survival", "--planes", "zeta .005", *options).splitlines()[2:]
    least, most = ([float(cell.split("(")[0].replace(",", "")) for cell in row.split("|")[3:8]] for row in rows)
    chaotic, wrong, of_all, undetermined, periods = zip(least, most, strict=True)
    assert chaotic[0] >= chaotic[1] > 0
    assert wrong[0] > wrong[1]
    assert of_all[0] > of_all[1]
    assert max(undetermined) < 5.0
    assert periods[0] < periods[1]


def test_the_benchmark_of_pictures_reads_two_chunks_for_the_shares_of_a_whole_plane(tmp_path: Path) -> None:
    """Shares and cells of the last level; reasons are of the records."""
    shown = script("bench_render", "--cells", "300", "--tile", "100", "--store", str(tmp_path / "a.zarr"), "--light")
    whole = next(line for line in shown.splitlines() if line.startswith("| fractions of the whole plane |"))
    assert whole.endswith(" 2 |")


def test_killed_runs_end_with_the_arrays_of_an_undisturbed_one_and_waste_no_more_than_was_under_way() -> None:
    """The exit code is 0 for that alone."""
    shown = script("kill_test", "--kills", "5", "--seed", "1")
    assert "25 tiles, 5 kills (" in shown
    assert shown.partition("5 kills (")[2].partition(")")[0].count(",") >= 1, "of more than one kind of process"
    assert "arrays bit for bit as undisturbed" in shown


@pytest.mark.parametrize("name", ["kill_test", "bench_work_precision"])
def test_examples_in_scripts_hold(name: str) -> None:
    command = [sys.executable, "-m", "doctest", "-v", f"scripts/{name}.py"]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, check=True
    )
    assert b"Test passed." in done.stdout
