"""What the probe says of the cost of an atlas, against what its solution costs."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.service import probe as probing
from atlas.service.plan import ProbeResult, make_plan
from tests import naive
from workers import Settings, solve_tile
from workers.cell.schedule import MIN_SURVIVAL_SHARE
from workers.results import CHAOTIC
from workers.sweep import solve_lines

COARSE = {"omega-b": (48, 36), "omega-b-fine": (40, 30), "fig6": (250,), "tiny": (8, 6)}
"""Examples whose cells cost enough, and are alike enough, for so few of them to tell."""
FIG_5 = {name: value for name, value in naive.FIGURES[5].items() if name != "omega"}


def coarse(name: str, continuation: dict[str, str] | None = None) -> atlas.Spec:
    """An example on fewer cells of the same window."""
    spec = atlas.Spec.from_toml(name)
    axes = {
        axis.name: {"start": axis.values[0], "stop": axis.values[-1], "num": num} | (continuation or {})
        for axis, num in zip(spec.axes, COARSE[name], strict=True)
    }
    store = {"tile": list(spec.tile)} if spec.tile else None
    return atlas.Spec(spec.system, axes, spec.parameters, spec.settings, store)


def probed(spec: atlas.Spec) -> ProbeResult:
    return probing.probe(spec, make_plan(spec, workers=2).tiling.tile)


@pytest.mark.slow
@pytest.mark.parametrize("name", COARSE)
def test_an_example_costs_what_its_probe_says_within_a_factor_of_two(name: str, tmp_path: Path, client: Client) -> None:
    """In forcing periods, the same on every machine; seconds follow from them."""
    spec = coarse(name)
    found = probed(spec)
    done = atlas.run(spec, tmp_path / "out.zarr", client=client)
    assert 0.5 < found.periods_per_cell * done.cells_solved / done.periods < 2.0


def test_on_a_processor_half_as_fast_the_same_periods_take_twice_the_seconds() -> None:
    spec = coarse("tiny")
    tile = make_plan(spec, workers=2).tiling.tile
    fast, slow = (probing.probe(spec, tile, clock=itertools.count(0.0, tick).__next__) for tick in (0.01, 0.02))
    assert (slow.cells, slow.periods_per_cell) == (fast.cells, fast.periods_per_cell)
    assert slow.seconds_per_cell == pytest.approx(2.0 * fast.seconds_per_cell, rel=1e-12)


def pretended(monkeypatch: pytest.MonkeyPatch, first: float, each: float) -> ProbeResult:
    """The probe of a plane whose cells cost this many seconds each, and the first to be solved ``first`` more."""
    now, more = [0.0], [first]

    def solve(spec: atlas.Spec, starts: list[tuple[int, ...]], length: int) -> tuple[probing.Array, ...]:
        now[0] += each * len(starts) + (more.pop() if more else 0.0)
        return (np.full((len(starts), 1), 1000.0),) * 3

    monkeypatch.setattr(probing, "_solve", solve)
    spec = coarse("omega-b")
    return probing.probe(spec, make_plan(spec, workers=2).tiling.tile, clock=lambda: now[0])


def test_kernels_that_the_first_cells_load_are_no_cost_of_a_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four cells and half a minute of loading would foretell hours."""
    found = pretended(monkeypatch, first=30.0, each=0.001)
    assert found.seconds_per_cell == pytest.approx(0.001, rel=0.01)
    assert found.cells == probing.CELLS


@pytest.mark.parametrize(("each", "cells"), [(0.3, 16), (5.0, 4)])
def test_a_forecast_is_made_from_more_than_a_handful_of_cells_unless_each_takes_long(
    each: float, cells: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = pretended(monkeypatch, first=0.0, each=each)
    assert (found.cells, found.seconds_per_cell) == (cells, pytest.approx(each))


@pytest.mark.slow
@pytest.mark.parametrize("continuation", ["forward", pytest.param("backward", marks=pytest.mark.slow)])
def test_a_sweep_by_continuation_takes_the_periods_that_parts_of_it_tell(continuation: str) -> None:
    spec = coarse("fig6", {"continuation": continuation})
    backward = continuation == "backward"
    whole = solve_lines(spec.system, spec.cell_params((slice(None),)), spec.settings, backward=backward)
    assert 0.5 < probed(spec).periods_per_cell / whole["periods_used"].mean() < 2.0


def test_cells_that_are_all_probed_leave_no_range() -> None:
    spec = atlas.Spec("two-mass", axes={"omega": [2.5, 3.0, 3.5]}, solve={"max_periods": 1000})
    found = probed(spec)
    used = solve_tile("two-mass", {"omega": [2.5, 3.0, 3.5]}, spec.settings)["periods_used"]
    assert (found.cells, found.periods_per_cell) == (3, pytest.approx(used.mean()))
    assert found.low == found.high == found.seconds_per_cell


def test_cells_probed_are_distinct_and_spread_over_the_plane() -> None:
    starts, _ = probing.spread_cells(coarse("omega-b"))
    assert len(set(starts)) == len(starts) == probing.CELLS
    quarters = np.array(starts) // (18, 24)
    for quarter in itertools.product((0, 1), repeat=2):
        assert (quarters == quarter).all(axis=1).sum() == pytest.approx(64, abs=4)


def test_the_probe_of_costly_cells_ends_with_its_first_step() -> None:
    """On a processor on which the four cells of that step take ten seconds each."""
    spec = coarse("omega-b")
    found = probing.probe(spec, make_plan(spec, workers=2).tiling.tile, clock=itertools.count(0.0, 40.0).__next__)
    assert found.cells == 4
    assert found.low < found.seconds_per_cell < found.high


def test_no_probed_cell_costs_more_than_the_probe_allows() -> None:
    """Truth: a chaotic cell that never comes to its tolerance spends nine tenths of its budget, and survives."""
    settings = Settings(tolerance=1e-9, max_periods=10_000_000)
    solved = solve_tile("two-mass", naive.FIGURES[5], probing.brief(settings))
    assert solved["regime"] == CHAOTIC
    assert solved["periods_used"] <= probing.MAX_PROBE_PERIODS + probing.MAX_SURVIVAL
    spec = atlas.Spec("two-mass", {"omega": [naive.FIGURES[5]["omega"]]}, FIG_5, settings)
    assert probed(spec).periods_per_cell == pytest.approx(0.9 * settings.max_periods, rel=0.01)


def test_a_long_schedule_is_probed_on_a_short_one() -> None:
    settings = Settings(method="fixed", transient_periods=1_000_000, periods=3_000_000)
    found = probed(atlas.Spec("two-mass", {"omega": [naive.FIGURES[5]["omega"]]}, FIG_5, settings))
    assert found.periods_per_cell == pytest.approx(4_000_000, rel=0.01)


@pytest.mark.parametrize("exponents", ["none", "largest"])
def test_the_range_holds_the_periods_for_which_chaos_would_be_watched(exponents: str) -> None:
    """Truth: the cell solved with all of its survival."""
    settings = Settings(exponents=exponents, survival=20 * probing.MAX_SURVIVAL, tolerance=0.03)
    truth = solve_tile("two-mass", naive.FIGURES[5], settings)
    assert truth["survived"] > probing.MAX_SURVIVAL or truth["survived"] >= MIN_SURVIVAL_SHARE * settings.survival
    found = probed(atlas.Spec("two-mass", {"omega": [naive.FIGURES[5]["omega"]]}, FIG_5, settings))
    rate = found.seconds_per_cell / (found.periods_per_cell + 1.0)
    assert found.low / rate <= truth["periods_used"] + 1.0 <= found.high / rate


def test_a_survival_as_short_as_that_of_the_probe_adds_nothing() -> None:
    settings = Settings(survival=probing.MAX_SURVIVAL)
    spec = atlas.Spec("two-mass", {"omega": [naive.FIGURES[5]["omega"]]}, FIG_5, settings)
    assert probed(spec).periods_per_cell == solve_tile("two-mass", naive.FIGURES[5], settings)["periods_used"]


def test_a_cell_that_stays_undetermined_leaves_a_range_up_to_its_whole_budget() -> None:
    """Without exponents and unwatched, chaos stays undetermined: the full budget is a hundred times what was spent."""
    settings = Settings(exponents="none", max_periods=100 * probing.MAX_PROBE_PERIODS, survival=0)
    found = probed(atlas.Spec("two-mass", {"omega": [naive.FIGURES[5]["omega"]]}, FIG_5, settings))
    assert found.high / found.low == pytest.approx(100.0, rel=0.01)
