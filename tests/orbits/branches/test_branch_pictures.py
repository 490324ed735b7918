"""Claims about pictures of branches: alone, and over the section values of sweeps; read off the artists."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

import atlas
from atlas import render
from atlas.accessor import PlottableBranches
from atlas.errors import InputError
from atlas.orbits.branches.from_sweep import tree_through
from atlas.render.sweep import ORBITS
from tests.orbits.branches.test_branch_fig6 import KNOWN
from tests.pictures import atlas as atlas_of
from tests.pictures import labels, line, plane
from workers import Settings, solve_tile

BREAKING = KNOWN[0].omega
OMEGA = np.linspace(2.95, 3.05, 6)
SAMPLES = 4
"""As many as a state has components, since the made-up atlas has one name for both axes."""


@pytest.fixture(scope="module")
def swept() -> xr.Dataset:
    """Six cells of Fig. 6 on both sides of its symmetry breaking."""
    solved = solve_tile("two-mass", {"omega": OMEGA}, Settings(max_periods=2000, survival=0, section_samples=SAMPLES))
    assert solved["symmetric"].tolist() == (OMEGA > BREAKING).tolist()
    return atlas_of({"omega": OMEGA}, **{name: values for name, values in solved.items() if name != "reason"})


@pytest.fixture(scope="module")
def found() -> PlottableBranches:
    settings = Settings(max_periods=2000, survival=0)
    return atlas.branch({"omega": 3.02}, along="omega", window=(2.95, 3.05), settings=settings, switch_branches=True)


@pytest.fixture(scope="module")
def over(swept: xr.Dataset) -> Axes:
    """The bifurcation diagram of these cells with its branches."""
    ax: Axes = render.figure(swept, overlay="branches").axes[0]
    return ax


def drawn_lines(ax: Axes, stable: bool) -> list[np.ndarray]:
    """The lines of stable or of unstable orbits."""
    kinds: list[Any] = [
        layer for layer in ax.collections if isinstance(layer, LineCollection) and layer.get_zorder() == 4
    ]
    solid = [line for line in kinds if (line.get_linestyle()[0][1] is None) is stable]
    return [np.asarray(path) for collection in solid for path in collection.get_segments()]


def test_stable_and_unstable_parts_meet_at_the_event(found: PlottableBranches) -> None:
    ax = found.plot().axes[0]
    solid, dashed = drawn_lines(ax, True), drawn_lines(ax, False)
    assert ORBITS[True].dashes == ()
    assert len(dashed) == 1
    assert dashed[0][:, 0].max() == pytest.approx(BREAKING, abs=1e-9)
    assert dashed[0][:, 0].min() == 2.95
    ends = [float(np.min(np.abs(path[[0, -1], 0] - BREAKING))) for path in solid]
    assert len(solid) == 3  # the symmetric orbit, the one that leaves it, and the mirror image of that
    assert max(ends) < 1e-9


def test_events_are_marked_where_they_lie(found: PlottableBranches) -> None:
    ax = found.plot().axes[0]
    (marks,) = [line for line in ax.lines if line.get_marker() == "s"]
    assert np.asarray(marks.get_xdata()) == pytest.approx(BREAKING, abs=1e-9)
    assert np.asarray(marks.get_ydata()) == pytest.approx(found.events.x1.iloc[0], abs=1e-8)
    assert labels(ax.figure) == ["stable orbit", "unstable orbit", "symmetry breaking"]  # type: ignore[arg-type]


def test_a_picture_of_branches_has_axes_with_symbols_and_is_written(found: PlottableBranches, tmp_path: Path) -> None:
    ax = found.plot(tmp_path / "branch.svg").axes[0]
    assert ax.get_xlabel() == r"forcing frequency $\omega$"
    assert "$x_1$ at $t = kT$" in ax.get_ylabel()
    assert "$b = 0.15$" in ax.get_title(loc="left")
    assert ax.get_xlim() == (2.95, 3.05)
    assert found.digest in (tmp_path / "branch.svg").read_text()


def test_branches_pass_through_the_section_values_of_every_cell(swept: xr.Dataset, over: Axes) -> None:
    lines = [line[np.argsort(line[:, 0])] for line in drawn_lines(over, True)]
    gap = swept["section"].values[..., 0]
    for omega, values in zip(OMEGA, gap, strict=True):
        here = [np.interp(omega, line[:, 0], line[:, 1], left=np.nan, right=np.nan) for line in lines]
        assert np.nanmin(np.abs(np.array(here)[:, None] - values), axis=0) == pytest.approx(0.0, abs=1e-5)


def test_the_unstable_orbit_between_is_drawn_though_no_cell_holds_it(over: Axes) -> None:
    (dashed,) = drawn_lines(over, False)
    assert (dashed[:, 0].min(), dashed[:, 0].max()) == (pytest.approx(2.95), pytest.approx(BREAKING, abs=1e-9))


@pytest.mark.slow
def test_cells_on_known_branches_add_none(swept: xr.Dataset) -> None:
    tree = tree_through([swept, swept])
    assert sorted(branch.itinerary.symmetric for branch in tree.branches) == [False, True]


@pytest.mark.slow
def test_two_sweeps_together_take_branches_too(swept: xr.Dataset) -> None:
    figure = render.figure(swept, against=swept, overlay="branches")
    assert len(drawn_lines(figure.axes[0], False)) == 1
    assert "unstable orbit" in labels(figure)


def test_branches_over_a_map_or_a_sweep_without_sections_are_refused() -> None:
    with pytest.raises(InputError, match="overlay 'branches' is drawn over a sweep, found two axes"):
        render.figure(plane(), overlay="branches")
    with pytest.raises(InputError, match="needs section values, and this atlas has none; see section_samples"):
        render.figure(line().drop_vars("section"), overlay="branches")


def test_branches_of_an_atlas_without_states_are_refused() -> None:
    with pytest.raises(InputError, match="branches need the variable 'impacts_upper' of cells"):
        render.figure(line(), overlay="branches")
