"""The benchmark of curves runs in its light mode and counts few Newton steps. No time is asserted."""

import pytest

from scripts.bench_curves import measure, of_plane

pytestmark = pytest.mark.slow


def test_light_mode_reports_every_curve_with_few_newton_steps() -> None:
    rows = measure(repeats=1, budget=10)
    assert [row["kind"] for row in rows] == ["symmetry_breaking", "period_doubling", "fold", "graze"]
    assert all(row["newton_steps_per_point"] < 3.0 for row in rows)


def test_the_curves_of_a_coarse_plane_explain_its_borders() -> None:
    row = of_plane(10)
    assert row["cells"] == "28 x 22"
    assert row["explained"] == 1.0
    assert row["points"] > 0
