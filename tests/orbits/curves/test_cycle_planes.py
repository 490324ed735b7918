"""Claims about the curves of planes of machines without a force. Truth: closed forms."""

from pathlib import Path

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.orbits.curves.queries import curves_of
from tests.workers.continuation.test_equilibria import chords_of, machine

END = 0.658855574469523615
"""The speed of the belt at which row 18 of piecewise.md has the end of the cycle: its machine is that of zeta .05."""

SOLVE = {"max_periods": 2000, "survival": 0}


def test_a_plane_of_belts_is_parted_by_the_curve_at_which_the_cycle_ends(tmp_path: Path, client: Client) -> None:
    axes = {"u": np.linspace(0.3, 1.2, 8).tolist(), "zeta": [0.03, 0.05, 0.07]}
    atlas.run(atlas.Spec("belt", axes, solve=SOLVE), tmp_path / "belt.zarr", client=client)
    atlas.find_curves(tmp_path / "belt.zarr", client=client)
    curves = curves_of(atlas.open(tmp_path / "belt.zarr"))
    (curve,) = curves
    assert (curve.kind, curve.period, curve.ends) == ("grazing_sliding", 1, ("edge", "edge"))
    u, zeta = curve.points[np.argsort(curve.points[:, 1])].T
    assert np.interp(0.05, zeta, u) == pytest.approx(END, abs=1e-3)  # between two points of the curve
    counts = curves.report["edges"]["regions"]
    assert counts["curve"] + counts["basins"] == counts["all"] > 0


@pytest.mark.slow
def test_a_plane_is_parted_by_a_hopf_curve_where_sliding_loses_stability(tmp_path: Path, client: Client) -> None:
    """At the vertex at 1 for dampings between the slopes beside it, .0855 and .2325."""
    system = machine(damping=[["c"]], friction=[chords_of(0.5)], parameters={"u": 1.3, "c": 0.1, "x": 0.55})
    axes = {"u": np.linspace(0.8, 1.3, 6).tolist(), "c": [0.1, 0.12, 0.14]}
    store = tmp_path / "law.zarr"
    atlas.run(atlas.Spec(system.table(), axes, solve=SOLVE), store, client=client)
    atlas.find_curves(store, client=client)
    curves = curves_of(atlas.open(store))
    (hopf,) = (curve for curve in curves if curve.kind == "hopf")
    assert hopf.points[:, 0] == pytest.approx(1.0, abs=1e-9)
    assert hopf.ends == ("edge", "edge")
    entry = atlas.open(store).atlas.distance_to(u=1.3, c=0.12).to_dict("records")[0]
    assert (entry["axis"], entry["kind"], entry["value"]) == ("u", "hopf", pytest.approx(1.0, abs=1e-12))
