"""The claim that classes differ in colour to every eye, without red or without green receptors too."""

import itertools

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from atlas.render import class_maps, kinds, looks, portrait_figure, scales, sweep
from atlas.render.kinds import STABLE
from atlas.store.schema import REGIME_COLORS
from workers.results import CHAOTIC, LOCKING, NO_IMPACT, PERIODIC, QUASIPERIODIC, REGIMES, REGULAR, UNDETERMINED

# Machado, Oliveira & Fernandes (2009), IEEE Trans. Vis. Comput. Graph. 15, 1291: severity 1, on linear RGB.
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
}
# The same for eyes without blue receptors, which the choice of all other palettes leaves out.
EVERY_SIGHT = SIGHT | {
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
_REGIMES = {r.name: REGIME_COLORS[r.code] for r in REGIMES if r.name not in ("pending", "periodic")}
_COLD = {name: color for name, color in _REGIMES.items() if name != "chaotic"}
# Others than these differ from chaos by their texture.
_PLAIN = {name: color for name, color in _COLD.items() if name in ("no_impact", "undetermined", "locking", "regular")}
_PERIODS = {f"period {first}": color for first, _, color in class_maps.PERIODS}
_CHAOS = {f"chaos {i}": tuple(scales.pick(scales.CHAOS, i / 4) / 255) for i in range(5)}

_UNLISTED = {f"unlisted {i}": color for i, color in enumerate(class_maps.UNLISTED)}

OF_A_COLOR = {
    "contact_lost", "lift_off", "stick_end", "grazing_sliding", "adding_sliding", "vertex", "exchange", "hopf",
    "border",
}  # fmt: skip
"""Kinds of events with the colour of another: losses of some kind, and those of what sticks or slides."""
PALETTES = {
    "period": _REGIMES | {f"period {first}": color for first, _, color in class_maps.PERIODS},
    "combined": _COLD | _PERIODS,
    "combined with chaos": _PLAIN | _PERIODS | _CHAOS,
    "impacts": _REGIMES | {color: color for pair in class_maps.HUES.values() for color in pair} | _UNLISTED,
    "spectrum": {f"exponent {i}": sweep.color_of(i) for i in range(4)},
    "points of a sweep": {
        str(code): looks.INK[code]
        for code in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, UNDETERMINED, LOCKING, REGULAR)
    },
    "events": {kind: look.color for kind, look in looks.EVENT_STYLES.items() if kind not in OF_A_COLOR},
    "hysteresis": dict(zip("ab", sweep.COLORS, strict=True)),
}


def lab(color: object, sight: object) -> NDArray[np.float64]:
    """CIE L*a*b* (D65) of a colour as it is seen."""
    rgb = np.array(to_rgb(color))  # type: ignore[arg-type]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(sight) @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ seen
    xyz = xyz / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize("palette", PALETTES)
def test_any_two_classes_of_a_picture_differ_in_colour(palette: str, sight: str) -> None:
    """About 2 is just noticeable side by side; 14 is seen at a distance."""
    seen = {name: lab(color, SIGHT[sight]) for name, color in PALETTES[palette].items()}
    closest = min((float(np.linalg.norm(seen[a] - seen[b])), a, b) for a, b in itertools.combinations(seen, 2))
    assert closest[0] > 14.0, closest


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_impacts_of_a_portrait_are_told_from_each_other_and_from_all_else_in_it(sight: str) -> None:
    (upper, lower), others = (
        (look[1] for look in portrait_figure.IMPACTS.values()),
        [portrait_figure.LINE, portrait_figure.STOP],
    )
    others += [sweep.color_of(i) for i in range(4)] + list(looks.INK.values())
    seen = {color: lab(color, EVERY_SIGHT[sight]) for color in (upper, lower, *others)}
    for own, rest in ((upper, others), (lower, [*others, upper])):
        closest = min((float(np.linalg.norm(seen[own] - seen[other])), own, other) for other in rest)
        assert closest[0] > 14.0, closest


def test_impacts_of_a_portrait_differ_in_their_marker_too() -> None:
    assert len({marker for marker, _, _ in portrait_figure.IMPACTS.values()}) == len(portrait_figure.IMPACTS)


def test_events_of_one_colour_differ_in_line_and_marker() -> None:
    for one, other in itertools.combinations(looks.EVENT_STYLES.values(), 2):
        assert one.marker != other.marker
        assert one.dashes != other.dashes


def ciede2000(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """The colour difference of CIE 142-2001 between two colours in L*a*b*."""
    mean = (np.hypot(*one[1:]) + np.hypot(*other[1:])) / 2
    stretch = 1.5 - 0.5 * np.sqrt(mean**7 / (mean**7 + 25.0**7))
    (L1, a1, b1), (L2, a2, b2) = one * [1, stretch, 1], other * [1, stretch, 1]
    C1, C2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180) % 360 - 180
    L, C, h = (L1 + L2) / 2, (C1 + C2) / 2, np.radians(h1 + turn / 2)
    dL, dC, dH = L2 - L1, C2 - C1, 2 * np.sqrt(C1 * C2) * np.sin(np.radians(turn) / 2)
    T = 1 - 0.17 * np.cos(h - np.radians(30)) + 0.24 * np.cos(2 * h)
    T += 0.32 * np.cos(3 * h + np.radians(6)) - 0.2 * np.cos(4 * h - np.radians(63))
    dL /= 1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2)
    dC, dH = dC / (1 + 0.045 * C), dH / (1 + 0.015 * C * T)
    angle = np.radians(60) * np.exp(-(((np.degrees(h) % 360 - 275) / 25) ** 2))
    mixed = -2 * np.sqrt(C**7 / (C**7 + 25.0**7)) * np.sin(angle)
    return float(np.sqrt(dL**2 + dC**2 + dH**2 + mixed * dC * dH))


@pytest.mark.parametrize(
    ("one", "other", "difference"),
    [
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.694), (23.0331, 14.973, -42.5619), 2.0373),
        ((90.9257, -0.5406, -0.9208), (88.6381, -0.8985, -0.7239), 1.5381),
    ],
)
def test_the_difference_of_colours_is_that_of_the_published_pairs(
    one: object, other: object, difference: float
) -> None:
    """Sharma, Wu & Dalal (2005), Color Res. Appl. 30, 21: table 1."""
    assert ciede2000(np.array(one, float), np.array(other, float)) == pytest.approx(difference, abs=1e-4)


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_the_scale_of_exponents_darkens_all_the_way_through_zero(sight: str) -> None:
    """So every exponent has a grey of its own, none below zero that of one above; none is white, as if without data."""
    lightness = [lab(scales.pick(scales.EXPONENT, v) / 255, EVERY_SIGHT[sight])[0] for v in np.linspace(0.0, 1.0, 65)]
    assert np.all(np.diff(lightness) < -0.4)
    assert 90.0 < lightness[0] < 95.0 and lightness[-1] < 12.0


SCALES = {
    "exponent": scales.EXPONENT,
    "combined": scales.CHAOS,
    "numbers": scales.color_table(kinds.NUMBERS.colors),
    **{name: scales.color_table(scale.colors) for name, scale in kinds.SCALES.items()},
}


@pytest.mark.parametrize("sight", EVERY_SIGHT)
@pytest.mark.parametrize("scale", SCALES)
def test_the_lightness_of_a_scale_rises_or_falls_all_the_way(scale: str, sight: str) -> None:
    steps = np.diff(
        [lab(scales.pick(SCALES[scale], v) / 255, EVERY_SIGHT[sight])[0] for v in np.linspace(0.0, 1.0, 33)]
    )
    assert np.all(steps > 0.0) or np.all(steps < 0.0)


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_a_cell_is_the_darker_the_more_attractors_it_has(sight: str) -> None:
    """So the counts can be read in greyscale too."""
    seen = [lab(class_maps.COUNTS[count], EVERY_SIGHT[sight]) for count in sorted(class_maps.COUNTS)]
    assert np.all(np.diff([L for L, _, _ in seen]) < -8.0)
    assert min(ciede2000(*pair) for pair in itertools.pairwise(seen)) > 10.0


GREY = np.tile([0.2126, 0.7152, 0.0722], (3, 1))
"""Luminance alone, as in a print without colour."""


@pytest.mark.parametrize(("sight", "least"), [("grey", 5.0), ("deuteranopia", 12.0), ("normal", 20.0)])
def test_neighbours_in_the_legend_of_periods_differ_in_grey_and_without_green_receptors(
    sight: str, least: float
) -> None:
    """About 2 is just noticeable side by side; the legend lists the periods in order, ever lighter."""
    seen = [lab(color, {**SIGHT, "grey": GREY}[sight]) for _, _, color in class_maps.PERIODS]
    assert min(ciede2000(*pair) for pair in itertools.pairwise(seen)) > least


def test_periods_rise_in_every_grey_to_which_programs_convert() -> None:
    """L* of the luminance, and the weighted mean of the bytes (Rec. 601), by which image programs convert."""
    assert np.all(np.diff([lab(color, GREY)[0] for _, _, color in class_maps.PERIODS]) > 6.0)
    assert np.all(np.diff([np.dot(to_rgb(color), (0.299, 0.587, 0.114)) for _, _, color in class_maps.PERIODS]) > 0.02)


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_the_smallest_exponents_of_either_sign_differ_at_a_glance(sight: str) -> None:
    below, above = (lab(scales.pick(scales.EXPONENT, share) / 255, EVERY_SIGHT[sight]) for share in (0.4999, 0.5001))
    assert ciede2000(below, above) > 40.0


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_a_labelled_branch_is_seen_on_white_and_differs_from_its_mirror_image(sight: str) -> None:
    table = {"regime": [PERIODIC, PERIODIC] * 8 + [NO_IMPACT], "mirror": [i ^ 1 for i in range(16)] + [16]}
    known = xr.Dataset({name: ("branch", values) for name, values in table.items()})
    seen = [lab(color, EVERY_SIGHT[sight]) for color in class_maps.branch_colors(known, ink=True)]
    assert max(L for L, _, _ in seen) < 80.0
    assert min(ciede2000(*seen[i : i + 2]) for i in range(0, 16, 2)) > 12.0


@pytest.mark.parametrize("sight", EVERY_SIGHT)
@pytest.mark.parametrize("kind", looks.EVENT_STYLES)
def test_a_curve_is_told_from_its_ground_by_its_colour_or_by_its_white_casing(kind: str, sight: str) -> None:
    """Of every ground: by its own colour where the ground is pale, elsewhere by the white beside it, which
    test_maps finds under every curve.
    """
    line, casing = (lab(color, EVERY_SIGHT[sight]) for color in (looks.EVENT_STYLES[kind].color, "white"))
    chaos = {f"chaos {v}": tuple(scales.pick(scales.EXPONENT, v) / 255) for v in (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)}
    for name, color in (_REGIMES | _PERIODS | chaos).items():
        ground = lab(color, EVERY_SIGHT[sight])
        assert max(ciede2000(line, ground), min(ciede2000(line, casing), ciede2000(casing, ground))) > 20.0, name


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_any_two_classes_of_periods_are_told_apart(sight: str) -> None:
    """Above 10 two colours are seen as different at a glance; with all receptors twice as much is asked for."""
    seen = [lab(color, EVERY_SIGHT[sight]) for _, _, color in class_maps.PERIODS]
    closest = min(ciede2000(one, other) for one, other in itertools.combinations(seen, 2))
    assert closest > (20.0 if sight == "normal" else 12.0)


def test_one_period_at_most_is_blue_or_nearly_black_to_the_eye() -> None:
    """Of the first eight periods: hues of blue lie between 240 and 300 degrees in L*a*b*, and black has L* near 0."""
    colors = [lab(color, SIGHT["normal"]) for first, _, color in class_maps.PERIODS if first <= 7]
    hues = [np.degrees(np.arctan2(b, a)) % 360 for L, a, b in colors if np.hypot(a, b) > 12]
    assert sum(240 < hue < 300 for hue in hues) == 1
    assert min(L for L, _, _ in colors) > 20


@pytest.mark.parametrize("sight", EVERY_SIGHT)
def test_no_exponent_is_as_pale_as_cells_without_data(sight: str) -> None:
    """A cell that is not solved yet is left white."""
    ends = [lab(color, EVERY_SIGHT[sight]) for color in (STABLE[0], "white")]
    assert np.linalg.norm(ends[0] - ends[1]) >= 8.0
