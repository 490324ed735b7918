"""Arguments of public functions of a wrong kind: one line names the argument, what was found and what is right.

Truth is what was given. No value here is one that the argument may have.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import render
from atlas.argument_checks import validate_pixels
from atlas.errors import InputError
from tests.synthetic import complete, spec_of

NONSENSE = [3, -1.0, np.nan, "x", b"x", [], [1], [None], (1, 2, 3), {3: 4}, {"x": 1}, object(), np.zeros(2), len, 2**70]
WINDOWS = [
    3,
    "x",
    np.nan,
    [1],
    object(),
    np.zeros(2),
    {"omega": 3},
    {"omega": (1,)},
    {"omega": ("a", "b")},
    {"omega": 3.0},
]
WINDOWS += [{"omega": (1, 2, 3)}, {"omega": (np.nan, 3)}, {"omega": (None, 3)}]


def nonsense(*fitting: Any) -> list[Any]:
    """All nonsense but what is of these types."""
    return [value for value in NONSENSE if not isinstance(value, fitting)]


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    return atlas.open(complete(tmp_path_factory.mktemp("arguments") / "plane.zarr", spec=spec_of(6, 5)).path)


def assert_refused(ask: Callable[[], object], name: str) -> None:
    with pytest.raises(InputError) as found:
        ask()
    assert name in str(found.value)
    assert "\n" not in str(found.value)


# Pictures

OF_FIGURES = {
    "window": WINDOWS,
    "path": nonsense(str),
    "pixels": nonsense(type(None)),
    "kind": nonsense(str),
    "variable": nonsense(str),
    "title": nonsense(),
    "legend": nonsense(),
    "names": nonsense(),
    "log": nonsense(),
    "width": nonsense(str, int, np.ndarray),
    "vmin": nonsense(int, float, np.ndarray),
    "overlay": nonsense(str, list, np.ndarray),
    "curves": nonsense(str, list, dict),
    "against": nonsense(),
    "ax": [value for value in nonsense() if not (isinstance(value, list) and not value)],
}


@pytest.mark.parametrize("name", OF_FIGURES)
def test_a_picture_refuses_an_argument_of_a_wrong_kind(plane: xr.Dataset, name: str) -> None:
    for value in OF_FIGURES[name]:
        assert_refused(lambda value=value: render.figure(plane, **{name: value}), name)


@pytest.mark.parametrize("titles", [3, ["x"], [1, 2], {"x": 1}, object(), np.zeros(2)])
def test_maps_side_by_side_refuse_titles_that_are_none(plane: xr.Dataset, titles: Any) -> None:
    assert_refused(lambda: render.figure([plane, plane], titles=titles), "titles")


def test_only_subjects_are_drawn(plane: xr.Dataset) -> None:
    for value in nonsense():
        assert_refused(lambda value=value: render.figure(value), "")
        assert_refused(lambda value=value: render.figure([plane, value]), "atlas")


# Questions

ASKED: dict[str, Callable[[xr.Dataset, Any], object]] = {
    "fractions": lambda ds, window: ds.atlas.fractions(window),
    "reasons": lambda ds, window: ds.atlas.count_reasons(window),
    "extremes": lambda ds, window: ds.atlas.extremes("largest", window=window),
    "regions": lambda ds, window: ds.atlas.regions("chaotic", window=window),
    "boundary": lambda ds, window: ds.atlas.boundary("chaotic", window=window),
    "compare": lambda ds, window: ds.atlas.compare(ds, window),
    "beside": lambda ds, window: ds.atlas.plot_side_by_side(ds, window=window),
    "plot": lambda ds, window: ds.atlas.plot(window=window),
}


@pytest.mark.parametrize("ask", ASKED)
def test_a_question_refuses_a_window_that_is_none(plane: xr.Dataset, ask: str) -> None:
    for value in WINDOWS:
        assert_refused(lambda value=value: ASKED[ask](plane, value), "window")


@pytest.mark.parametrize("value", ["x", b"x", ["x"], None, {}, object(), np.zeros(2)])
def test_a_point_has_numbers(plane: xr.Dataset, value: Any) -> None:
    assert_refused(lambda: plane.atlas.at(omega=value, b=0.2), "omega")
    assert_refused(lambda: plane.atlas.portrait(omega=value, b=0.2), "omega")


def test_names_of_variables_classes_and_regimes_are_texts(plane: xr.Dataset) -> None:
    for value in nonsense(str):
        assert_refused(lambda value=value: plane.atlas.extremes(value), "variable")
        assert_refused(lambda value=value: plane.atlas.extremes("largest", by=value), "by")
        assert_refused(lambda value=value: plane.atlas.regions(value), "by")
        assert_refused(lambda value=value: plane.atlas.where_regime(value), "regime")
        assert_refused(lambda value=value: plane.atlas.compare(value), "atlas")
        assert_refused(lambda value=value: plane.atlas.to_html(value), "path")


# Cells and stores

CELL = {"omega": 4.0, "b": 0.1}
LINE = {"along": "b", "window": (0.095, 0.105)}


def test_functions_of_one_cell_refuse_settings_that_are_none() -> None:
    for function in (atlas.point, atlas.attractors, atlas.stability, atlas.portrait, atlas.saddles):
        for value in nonsense():
            assert_refused(lambda f=function, value=value: f(CELL, settings=value), "settings")
    assert_refused(lambda: atlas.branch(CELL, settings=3, **LINE), "settings")  # type: ignore[arg-type]


def test_norms_and_flags_of_stability_are_checked() -> None:
    for value in nonsense(dict):
        assert_refused(lambda value=value: atlas.stability(CELL, starts=4, norm=value), "norm")
        assert_refused(lambda value=value: atlas.stability(CELL, starts=4, shocks=value), "shocks")


def test_the_window_of_a_branch_is_two_numbers() -> None:
    assert_refused(lambda: atlas.branch(CELL, **LINE, switch_branches=3), "switch_branches")  # type: ignore[arg-type]
    for value in [None, *nonsense(np.ndarray)]:
        asked = {**LINE, "window": value}
        assert_refused(lambda asked=asked: atlas.branch(CELL, **asked), "window")


def test_a_store_is_a_path(tmp_path: Path) -> None:
    readers = (atlas.open, atlas.status, atlas.verify, atlas.find_curves, atlas.label_attractors)
    for function in (*readers, atlas.measure_attractors, lambda store: atlas.pack(store, tmp_path / "a.zip")):
        for value in nonsense(str):
            assert_refused(lambda f=function, value=value: f(value), "store")
    for value in nonsense(str):
        assert_refused(lambda value=value: atlas.pack(tmp_path, value), "file")


@pytest.mark.parametrize("given", [(0, 4), (4, 0), (4,), (4, 4, 4), (4, 2.5), "x", 4, True])
def test_a_size_in_pixels_is_two_whole_numbers_from_1_on(given: object) -> None:
    with pytest.raises(InputError, match=r"pixels: found .*, must be two whole numbers, \(x, y\), 1 or more"):
        validate_pixels(given)


def test_a_run_refuses_arguments_of_a_wrong_kind(tmp_path: Path) -> None:
    spec = spec_of(2, 2)
    for value in nonsense():
        assert_refused(lambda value=value: atlas.run(value, tmp_path / "a.zarr"), "spec")
        assert_refused(lambda value=value: atlas.plan(value), "spec")
        assert_refused(lambda value=value: atlas.plan(spec, probe=value), "probe")
        assert_refused(lambda value=value: atlas.run(spec, tmp_path / "a.zarr", options=value), "options")
        assert_refused(lambda value=value: atlas.run(spec, tmp_path / "a.zarr", client=value), "client")
        assert_refused(lambda value=value: atlas.Spec.from_dataset(value), "atlas")
        for name in ("timing", "tls"):
            assert_refused(lambda value=value, name=name: atlas.RunOptions(**{name: value}), name)
    for value in nonsense(str):
        assert_refused(lambda value=value: atlas.Spec.from_toml(value), "spec")
    for tile in (3, "x", ("a", "b"), [None], object()):
        assert_refused(lambda tile=tile: atlas.RunOptions(tile=tile), "tile")
    for name, fitting in {"workers": int, "patience": (int, float), "wait": (int, float), "scheduler": str}.items():
        for value in [value for value in NONSENSE if not isinstance(value, fitting)]:
            assert_refused(lambda value=value, name=name: atlas.RunOptions(**{name: value}), name)
    for value in (-1, 0, 2.5, "x", [1]):
        assert_refused(lambda value=value: atlas.plan(spec, value, probe=False), "workers")
    assert not list(tmp_path.iterdir())


def test_work_on_a_store_refuses_options_that_are_none(plane: xr.Dataset) -> None:
    store = plane.encoding["source"]
    for function in (atlas.find_curves, atlas.label_attractors, atlas.measure_attractors):
        for value in nonsense():
            assert_refused(lambda f=function, value=value: f(store, options=value), "options")
    for value in nonsense():
        assert_refused(lambda value=value: atlas.extend(store, "new.zarr", value), "spec")
        assert_refused(lambda value=value: atlas.find_curves(store, value), "settings")


def test_verifying_refuses_arguments_of_a_wrong_kind(plane: xr.Dataset) -> None:
    store = plane.encoding["source"]
    for value in nonsense():
        assert_refused(lambda value=value: atlas.verify(store, repair=value), "repair")
    for value in [value for value in NONSENSE if not isinstance(value, int)]:
        assert_refused(lambda value=value: atlas.verify(store, sample=value), "sample")
        assert_refused(lambda value=value: atlas.verify(store, seed=value), "seed")
