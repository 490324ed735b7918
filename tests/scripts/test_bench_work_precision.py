"""The work-precision benchmark runs, and what it measures is right. No time is asserted."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts import bench_work_precision as bench
from scripts.general_integrator import FIGURES
from tests.paths import ROOT

pytestmark = pytest.mark.slow


def test_light_mode_reports_every_method_and_draws(tmp_path: Path) -> None:
    picture = tmp_path / "work_precision.png"
    command = [sys.executable, "scripts/bench_work_precision.py", "--light", "--json", "--picture", str(picture)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    printed = subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
    result = json.loads(printed)
    methods = {point["method"] for point in result["points"]}
    assert methods == {"adaptive", "fixed", "DOP853"} | ({"heyoka"} if bench.INSTALLED else set())
    assert {cell["group"] for cell in result["cells"]} == {"figures", "orbits", "window", "chaotic"}
    assert result["curves"]["adaptive"]["periodic"][0]["error"] < 1e-10
    assert picture.stat().st_size > 10000


@pytest.mark.skipif(not bench.INSTALLED, reason="heyoka is not installed")
@pytest.mark.parametrize(("figure", "exact"), [("3", -0.235569640371152), ("4", -0.475914135412643)])
def test_heyoka_finds_the_40_digit_exponents(figure: str, exact: float) -> None:
    """Its schedule of 2000 periods, averaged plainly, is as good as 1 / 2000."""
    _, _, (largest,) = bench.Taylor(1).run(FIGURES[figure], (2000,))[0]
    assert largest == pytest.approx(exact, abs=1e-3)


def test_time_to_reach_an_error_is_read_off_the_line_in_log_log() -> None:
    rows = [{"error": 1e-2, "seconds": 1.0}, {"error": 1e-3, "seconds": 10.0}]
    assert bench.seconds_to_reach(rows, 1e-4) == pytest.approx(100.0)
