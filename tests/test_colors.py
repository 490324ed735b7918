"""The claim that classes differ in colour to every eye, without red or without green receptors too."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from atlas.render import combined, events, hysteresis, impacts, period, spectrum, style, symmetry
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC, REGIMES, UNDETERMINED

# Machado, Oliveira & Fernandes (2009), IEEE Trans. Vis. Comput. Graph. 15, 1291: severity 1, on linear RGB.
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
}
_REGIMES = {r.name: r.color for r in REGIMES if r.name not in ("pending", "periodic")}
_COLD = {name: color for name, color in _REGIMES.items() if name != "chaotic"}
# Others than these differ from chaos by their texture.
_PLAIN = {name: color for name, color in _COLD.items() if name in ("no_impact", "undetermined")}
_PERIODS = {f"period {first}": color for first, _, color in period.CLASSES}
_CHAOS = {f"chaos {i}": tuple(combined.COLORMAP(i / 4)[:3]) for i in range(5)}

_UNLISTED = {f"unlisted {i}": color for i, color in enumerate(impacts.UNLISTED)}

PALETTES = {
    "period": _REGIMES | {f"period {first}": color for first, _, color in period.CLASSES},
    "combined": _COLD | _PERIODS,
    "combined with chaos": _PLAIN | _PERIODS | _CHAOS,
    "impacts": _REGIMES | {color: color for pair in impacts.HUES.values() for color in pair} | _UNLISTED,
    "symmetry": _REGIMES | {color: color for color in symmetry.NAMES},
    "spectrum": {f"exponent {i}": spectrum.color(i) for i in range(4)},
    "points of a sweep": {
        str(code): style.INK[code] for code in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, UNDETERMINED)
    },
    "events": {kind: look.color for kind, look in events.LOOKS.items() if kind != "impact_lost"},  # a graze too
    "hysteresis": dict(zip("ab", hysteresis.COLORS, strict=True)),
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
