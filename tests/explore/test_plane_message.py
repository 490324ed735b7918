"""What the server sends of the cells in view, and what the browser's modules make of it, without a browser."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from atlas.explore.compose import VisibleCells, compose_view
from atlas.explore.plane_message import ends_of, maps_of, message
from atlas.explore.subject import Subject, exploration_settings, subject_of
from atlas.explore.view_state import ViewState, initial_view, style_query
from atlas.explore.viewport import TILE_CELLS, Viewport
from atlas.orbits.curves.table import write_curves
from atlas.query.plane import Plane
from atlas.render.kinds import KIND_TABLE
from atlas.render.layers import MapView, paint
from atlas.render.layout import STANDARD
from atlas.render.painters import PAINTERS
from atlas.render.request import PictureRequest
from atlas.spec.spec import Spec
from atlas.store.store import open_store
from tests.explore.messages import opened, styled
from tests.explore.modules import run
from tests.pictures import curves
from workers.results import CHAOTIC, FAILED, NO_IMPACT, PENDING, PERIODIC, REGIME

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")

SIZE = (240, 160)
REGIMES = [PERIODIC, CHAOTIC, NO_IMPACT, PENDING, FAILED]
COLORS = """
const { colorsOf } = await import("/front/colors.mjs")
return [...colorsOf(given.map, given.codes, given.values, given.ends)]
"""


@pytest.fixture
def subject(finished: Path) -> Subject:
    write_curves(open_store(finished), curves())
    return subject_of(str(finished))


def seen_of(subject: Subject, chosen: ViewState) -> VisibleCells:
    """Made-up cells of several regimes in the window that is chosen."""
    sight = subject.viewport(chosen.x, chosen.y, SIZE)
    rng, tiles = np.random.default_rng(7), []
    for key in sight.tiles(0):
        arrays = subject.without_results(subject.variables, (TILE_CELLS, TILE_CELLS))
        regime = rng.choice(REGIMES, (TILE_CELLS, TILE_CELLS), p=[0.4, 0.4, 0.1, 0.05, 0.05])
        for values in arrays.values():
            if values.dtype.kind == "f":
                values[...] = rng.random(values.shape)
            elif values.ndim == 2:
                values[...] = rng.integers(1, 9, values.shape)
        arrays[REGIME.name][...] = regime
        arrays["largest"] *= np.where(regime == CHAOTIC, 1.0, -1.0)
        tiles.append((key, arrays))
    return replace(compose_view(subject, chosen.plane, sight, tiles, chosen.names), view_id="one")


def sent(
    subject: Subject, chosen: ViewState, others: bool = True, scales: Any = None
) -> tuple[Any, Any, str, VisibleCells]:
    """A message, opened, what it lacks, and the cells that it is of."""
    seen = seen_of(subject, chosen)
    made, lacking = message(seen, subject, chosen, maps_of(seen, chosen, others), scales or {}, SIZE)
    return *opened(made), lacking, seen


def view_of(subject: Subject, **fields: Any) -> ViewState:
    return replace(initial_view(subject), x=(2.3, 2.9), y=(0.2, 0.3), **fields)


def queries() -> Iterator[tuple[str, tuple[float, float] | None]]:
    yield "kind=exponent", None
    yield "kind=exponent", (-0.3, 0.7)
    yield "kind=combined", (0.2, 0.5)
    yield "kind=period", None
    yield "kind=impacts", None
    yield "kind=scalar&variable=largest", (-0.25, 0.75)
    yield "kind=scalar&variable=peak_to_peak&log=1", (0.1, 0.9)


@pytest.mark.parametrize(("query", "ends"), list(queries()))
def test_the_browser_colours_a_view_as_paint_does_by_the_numbers_that_it_was_sent(
    subject: Subject, browser: Any, query: str, ends: tuple[float, float] | None
) -> None:
    chosen = styled(subject, view_of(subject), query)
    about, arrays, _, seen = sent(subject, chosen, others=False)
    (made,) = about["maps"]
    own = {name: arrays[name].ravel().tolist() for name in made["needs"]}
    finite = {name: [None if np.isnan(value) else value for value in values] for name, values in own.items()}
    own_ends = made["bar"] and made["bar"]["ends"]
    given = {"map": made, "codes": arrays[made["codes"]].ravel().tolist(), "values": finite, "ends": ends or own_ends}
    found = np.array(run(browser, COLORS, given), "<u4").view(np.uint8).reshape(*seen.sight.shape, 4)

    rounded = seen.ds.assign({name: (seen.ds[name].dims, arrays[name]) for name in made["needs"]})
    kind = KIND_TABLE[chosen.kind]
    wanted = ends or own_ends
    page = STANDARD if wanted is None else replace(STANDARD, vmin=wanted[0], vmax=wanted[1])
    variable = chosen.variable if chosen.kind == "scalar" else None
    asked = PictureRequest(page, kind.name, variable=variable, log=chosen.log)
    layers = PAINTERS[kind.name](MapView(kind, rounded, Plane.from_dataset(rounded, made["needs"]), asked))
    expected = paint(layers)
    expected[expected[..., 3] == 0] = 255
    assert np.array_equal(found, expected)
    assert len(np.unique(found.reshape(-1, 4), axis=0)) > 5


def test_numbers_have_four_digits_on_the_page_and_the_regime_is_exact(subject: Subject) -> None:
    about, arrays, _, seen = sent(subject, view_of(subject))
    exact, found = seen.ds.largest.values, arrays["largest"]
    assert about["arrays"]["largest"]["digits"] == 4
    assert np.all(np.abs(found - exact) <= 0.5e-3 * np.abs(exact)) and np.any(found != exact)
    assert np.array_equal(arrays[REGIME.name], seen.ds.regime.values)


def test_a_view_that_is_known_comes_with_every_map_of_its_variables(subject: Subject) -> None:
    names = [entry["name"] for entry in sent(subject, styled(subject, view_of(subject), "kind=combined"))[0]["maps"]]
    assert names[0] == "combined"
    assert {*names} == {"combined", "exponent", "period", "number-largest", "number-period", "number-period-log"}
    alone = sent(subject, styled(subject, view_of(subject), "kind=combined"), others=False)[0]
    assert [entry["name"] for entry in alone["maps"]] == ["combined"]


def test_a_scale_keeps_its_ends_and_says_which_would_fit_the_view(subject: Subject) -> None:
    held = (-3.0, 2.0)
    about, _, _, seen = sent(subject, view_of(subject), scales={"exponent": held})
    bar = about["maps"][0]["bar"]
    assert tuple(bar["ends"]) == held
    (first, *_) = maps_of(seen, view_of(subject), others=False)
    assert tuple(bar["fit"]) == ends_of(first) != held


def test_lines_come_clipped_to_the_view_and_what_cannot_be_drawn_is_said(subject: Subject) -> None:
    chosen = view_of(subject, overlays=("grazing", "boundaries", "curves"))
    about, arrays, lacking, seen = sent(subject, chosen)
    assert lacking == "" and {*about["lines"]} == {*chosen.overlays}
    for line in about["lines"]["curves"]["lines"]:
        x = np.reshape(line["points"], (-1, 2))[:, 0]
        assert x.min() < 2.9 and x.max() > 2.3 and np.count_nonzero((x < 2.25) | (x > 2.95)) <= 2
    assert arrays["regions"].shape == seen.sight.shape
    moved = replace(chosen, plane=chosen.plane.with_value("R", 0.7), overlays=("curves",))
    about, _, lacking, _ = sent(subject, moved)
    assert "a store has curves only of its own plane" in lacking
    assert about["lines"]["curves"]["lines"] == []  # known to be lacking: the page asks no more


def test_a_name_fits_into_a_region_as_wide_as_it_is_drawn_on_a_logarithmic_axis_in_a_narrow_window() -> None:
    """Truth: omega below 1.11 takes 20 pixels of a page and a name 15; evenly drawn, as in files, it would take 10."""
    axes = {
        "omega": {"start": 0.5, "stop": 8.0, "num": 60, "scale": "log"},
        "b": {"start": 0.1, "stop": 0.5, "num": 30},
    }
    spec = Spec("two-mass", axes=axes)
    subject = Subject(spec, exploration_settings(spec.settings))
    chosen = replace(initial_view(subject), x=(1.0, 3.5), y=(0.1, 0.5), kind="impacts")
    seen = seen_of(subject, chosen)
    ones = np.ones(seen.sight.shape, dtype=np.int32)
    upper = np.where(seen.ds.omega.values < 1.11, 2 * ones, ones)
    made = {REGIME.name: PERIODIC * ones, "period": ones, "impacts_lower": ones, "impacts_upper": upper}
    seen = replace(seen, ds=seen.ds.assign({name: (seen.ds.regime.dims, values) for name, values in made.items()}))
    about = opened(message(seen, subject, chosen, maps_of(seen, chosen, others=False), {}, SIZE)[0])[0]
    found = {name["text"]: name["x"] for name in about["names"]["impacts"]}
    assert found.keys() == {"1-1-1", "1-2-1"} and found["1-2-1"] < 1.11 < found["1-1-1"]


def test_a_map_without_such_numbers_is_refused_as_a_whole(subject: Subject) -> None:
    from atlas.errors import InputError

    chosen = styled(subject, view_of(subject), "kind=scalar&variable=largest&log=1")
    with pytest.raises(InputError, match="values below zero, which a logarithmic scale cannot show"):
        sent(subject, chosen)


def test_a_look_comes_back_from_its_query(subject: Subject) -> None:
    given = "kind=scalar&variable=largest&log=1&overlay=grazing,curves&without=fold&vmin=0.25&vmax=2.0"
    assert style_query(styled(subject, view_of(subject), given)) == given


def test_the_cells_of_a_view_say_where_they_are(subject: Subject) -> None:
    about, _, _, seen = sent(subject, view_of(subject))
    for axis, lattice, stretch in zip(about["axes"], (subject.x, subject.y), seen.sight, strict=True):
        assert tuple(axis["edges"]) == lattice.edges(stretch.level, stretch.first, stretch.last)
        assert (axis["count"], axis["first"], axis["level"]) == (stretch.count, stretch.first, stretch.level)
    assert isinstance(seen.sight, Viewport) and json.dumps(about)
