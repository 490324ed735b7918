"""The colours of the explorer's map and key: what the browser makes of coded numbers, and what a dark page shows."""

from typing import Any

import numpy as np
import pytest

from atlas.render.kinds import TABLE
from atlas.render.numbered import LINEAR, LOG, MOST, SIGNED, TWO_SIDED, PixelScale
from atlas.render.screen import Screen, screen
from tests.pictures import atlas as atlas_of
from tests.pictures import curves, keeping
from workers.results import CHAOTIC, FAILED, NO_IMPACT, PENDING, PERIODIC

SHAPE, SIZE = (30, 40), (301, 197)


@pytest.fixture(scope="module", params=["linear", "log"])
def ds(request: pytest.FixtureRequest) -> Any:
    """Made-up cells of several regimes, on a linear or a logarithmic axis across."""
    rng = np.random.default_rng(5)
    regime = rng.choice([PERIODIC, CHAOTIC, NO_IMPACT, PENDING, FAILED], SHAPE, p=[0.4, 0.4, 0.1, 0.05, 0.05])
    omega = np.linspace(1.0, 3.0, SHAPE[1]) if request.param == "linear" else np.geomspace(1.0, 100.0, SHAPE[1])
    return atlas_of(
        {"omega": omega, "b": np.linspace(0.1, 0.5, SHAPE[0])},
        regime=regime.astype(np.int8),
        largest=np.where(regime == CHAOTIC, 1.0, -1.0) * rng.random(SHAPE),
        period=rng.integers(1, 9, SHAPE).astype(np.int32),
        peak_to_peak=10.0 ** rng.uniform(-2.0, 1.0, SHAPE),
    )


def drawn(ds: Any, kind: str, **options: Any) -> Screen:
    return screen(ds, kind, SIZE, 165, **options)


def colored(cells: np.ndarray, scale: PixelScale, low: float, high: float) -> np.ndarray:
    """What the browser makes of a coded picture, by the words of ``numbered``."""
    share, (least, most) = codes_of(cells) / MOST, scale.span
    value = least * (most / least) ** share if scale.form == LOG else least + (most - least) * share
    place = {
        LINEAR: lambda: (value - low) / (high - low),
        LOG: lambda: np.log(value / low) / np.log(high / low),
        TWO_SIDED: lambda: 0.5 + 0.5 * np.where(value < 0.0, -value / low, value / high),
        SIGNED: lambda: 0.5 + 0.5 * np.clip(value, low, high) / max(-low, high),
    }[scale.form]()
    count = len(scale.colors)
    found = scale.colors[np.clip(np.floor(place * count).astype(int), 0, count - 1)]
    return np.where(cells[..., 3:] == 0, found, cells)


def codes_of(cells: np.ndarray) -> np.ndarray:
    return cells[..., :3].astype(int) @ [1, 256, 65536]


@pytest.mark.parametrize(
    ("kind", "options", "form", "ends"),
    [
        ("exponent", {}, TWO_SIDED, (-0.3, 0.7)),
        ("combined", {}, LINEAR, (0.2, 0.5)),
        ("combined", {}, LINEAR, (-0.2, 0.5)),
        ("scalar", {"variable": "peak_to_peak"}, LINEAR, (0.5, 4.0)),
        ("scalar", {"variable": "peak_to_peak", "log": True}, LOG, (0.1, 1.0)),
        ("scalar", {"variable": "largest"}, SIGNED, (-0.25, 0.75)),
    ],
)
def test_codes_in_the_colours_of_other_ends_are_the_picture_of_these_ends(
    ds: Any, kind: str, options: dict[str, Any], form: str, ends: tuple[float, float]
) -> None:
    found = drawn(ds, kind, numbers=True, **options)
    assert found.scale is not None and found.scale.form == form
    coded = found.cells[..., 3] == 0
    assert 0.1 < coded.mean() < 0.95
    expected = drawn(ds, kind, vmin=ends[0], vmax=ends[1], **options).cells
    made = colored(found.cells, found.scale, *ends)
    off = np.abs(made.astype(int) - expected)[coded].max(axis=-1)
    assert np.mean(off) < 0.5 and np.mean(off > 8) < 1e-3  # of 255: neighbours on the scale


def test_each_pixel_holds_the_number_of_its_cell(ds: Any) -> None:
    found = drawn(ds, "scalar", variable="peak_to_peak", numbers=True)
    assert found.scale is not None
    low, high = found.scale.span
    values = (low + (high - low) * codes_of(found.cells) / MOST)[found.cells[..., 3] == 0]
    known = ds.peak_to_peak.values[np.isin(ds.regime.values, (NO_IMPACT, PERIODIC, CHAOTIC))]
    nearest = np.abs(values[:, None] - known[None, :]).argmin(axis=1)
    assert np.allclose(values, known[nearest], rtol=0, atol=(high - low) / MOST)
    assert len(set(nearest)) > 0.9 * known.size


def test_a_zero_with_a_name_of_its_own_keeps_its_colour_among_numbers(ds: Any) -> None:
    """In the codes of numbers it was the lower end of the scale, "never at rest" the colour of a short rest."""
    rest = np.where(np.arange(SHAPE[1]) % 2, 0.0, 0.5) * np.linspace(0.5, 1.0, SHAPE[0])[:, None]
    periodic = ds.regime.copy(data=np.full(SHAPE, PERIODIC, np.int8))
    known = ds.assign(regime=periodic, stuck_fraction=(ds.regime.dims, rest))
    plain, coded = (drawn(known, "sticking", numbers=numbers).cells for numbers in (False, True))
    color = [int(TABLE["sticking"].scale.zero[0][k : k + 2], 16) for k in (1, 3, 5)]  # type: ignore[index]
    zero = (plain[..., :3] == color).all(axis=-1)
    assert 0.4 < zero.mean() < 0.6
    assert np.array_equal(coded[..., 3] == 255, zero) and np.array_equal(coded[zero], plain[zero])


def test_lines_over_a_map_and_classes_keep_their_colours(ds: Any) -> None:
    plain, coded = (drawn(ds, "exponent", overlay=("boundaries",), numbers=code).cells for code in (False, True))
    kept = coded[..., 3] == 255
    assert np.array_equal(plain[kept], coded[kept])
    without = drawn(ds, "exponent", numbers=True).cells[..., 3] == 255
    assert kept.sum() > without.sum()
    classes = drawn(ds, "period", numbers=True)
    assert classes.scale is None and np.array_equal(classes.cells, drawn(ds, "period").cells)


@pytest.mark.parametrize("kind", ["exponent", "combined", "error"])
def test_on_a_dark_page_the_colours_of_a_key_stay_and_its_paper_and_type_are_inverted(ds: Any, kind: str) -> None:
    error = ds.largest.copy(data=np.abs(ds.largest.values) * 1e-3)
    found = screen(ds.assign(error=error), kind, (300, 600), 165)
    same = (found.key == found.dark_key).all(axis=-1)
    inverted = (255 - found.key[..., :3] == found.dark_key[..., :3]).all(axis=-1)
    assert np.all(same | inverted) and inverted.mean() > 0.5
    vivid = np.ptp(found.key[..., :3].astype(int), axis=-1) > 40
    assert vivid.sum() > 1000 and same[vivid].mean() > 0.99
    assert found.dark_key[0, 0].tolist() == [0, 0, 0, 255]


def test_a_kind_of_curve_that_is_switched_off_is_neither_drawn_nor_in_the_key(ds: Any) -> None:
    shown = ("fold", "graze", "codimension_two")
    with keeping(curves()):
        both, less = (drawn(ds, "period", overlay=("curves",), curves=kinds) for kinds in (None, shown))
    assert set(both.lines) > {"fold", "period_doubling", "codimension_two"}
    assert less.lines == shown
    assert np.any(both.cells != less.cells) and np.any(both.key != less.key)
