"""How every picture looks and what every file carries: type, colours, the title line, metadata."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import to_rgb
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerPatch
from matplotlib.mathtext import MathTextParser
from matplotlib.patches import Patch, Rectangle
from matplotlib.typing import ColorType

from atlas.spec.system import stored_system
from workers.model.parameter import Parameter
from workers.model.system import System
from workers.results import APERIODIC, FAILED, INVALID, NO_IMPACT, PENDING, QUASIPERIODIC, REGIMES, UNDETERMINED

DPI = 300.0
"""Dots per inch of a file where none are asked for."""


def house(scale: float) -> dict[str, Any]:
    """Matplotlib's settings of a page whose type is so many times as large as the standard page's."""
    return {
        "font.family": "STIXGeneral",
        "mathtext.fontset": "stix",
        "font.size": 10.0 * scale,
        "axes.titlesize": 10.0 * scale,
        "axes.labelsize": 11.0 * scale,
        "axes.linewidth": 0.7,
        "xtick.labelsize": 9.5 * scale,
        "ytick.labelsize": 9.5 * scale,
        "xtick.direction": "out",
        "ytick.direction": "out",
        "xtick.major.width": 0.7,
        "ytick.major.width": 0.7,
        "legend.fontsize": 9.0 * scale,
        "legend.title_fontsize": 9.0 * scale,
        "legend.frameon": False,
        "legend.handlelength": 1.3,
        "legend.handleheight": 0.95,
        "hatch.linewidth": 0.5,
        "savefig.dpi": DPI,
        "savefig.bbox": None,  # the page has the size that was asked for
        "pdf.fonttype": 42,
        "svg.hashsalt": "impact-atlas",
    }


TEXTURE = "#8c8c8c"
"""The grey of textures."""

COLORS = {regime.code: regime.color for regime in REGIMES}
"""The colour of each regime code, as in the data's flag_colors."""

INK = {**COLORS, NO_IMPACT: "#8c8c8c", UNDETERMINED: "#7db800", APERIODIC: "#986020"}
"""The same for points and lines on white, where the pale colours of areas would not be seen."""

HATCH = {PENDING: "////", NO_IMPACT: "...", QUASIPERIODIC: "++", INVALID: "\\\\\\\\", FAILED: "xxxx"}
"""The texture of regimes that colour alone does not show: white is no value, impact-free cells have exponents, grey
and black may be the ends of a scale, and green is seen as a shade of chaos without red receptors."""

HATCH_INK = {PENDING: TEXTURE, QUASIPERIODIC: "#a9dcb1", INVALID: "#f0f0f0", FAILED: "#ffffff"}
"""The ink of those textures; what is not named is drawn in an ink that suits its cells."""

LOST_HATCH = "||"
"""The texture of exponents that are -inf: rest on a stop erases disturbances."""


def name_of(code: int) -> str:
    """A regime's name as a legend says it."""
    return next(regime.name for regime in REGIMES if regime.code == code).replace("_", " ")


def rgb(color: str, alpha: int = 255) -> tuple[int, int, int, int]:
    """A colour in bytes."""
    red, green, blue = (round(255 * channel) for channel in to_rgb(color))
    return red, green, blue, alpha


def swatch(color: ColorType, label: str, hatch: str | None = None, ink: str = TEXTURE) -> Patch:
    """A legend entry: a framed box of a colour, with a texture in its own ink if given."""
    edge = ink if hatch else "#404040"
    return Patch(facecolor=color, edgecolor=edge, linewidth=0.5, hatch=hatch and 2 * hatch, label=label)


class Gradient(Patch):
    """A legend entry: a box of a colour that darkens to a share of its brightness from left to right."""

    def __init__(self, color: ColorType, dark: float, label: str) -> None:
        super().__init__(facecolor=color, edgecolor="#404040", linewidth=0.5, label=label)
        self.dark = dark


class _GradientHandler(HandlerPatch):
    """Draws the box of a ``Gradient`` in stripes."""

    def create_artists(self, legend, orig_handle, xdescent, ydescent, width, height, fontsize, trans):  # type: ignore[no-untyped-def]
        shades, stripes = np.linspace(1.0, orig_handle.dark, 16), []
        for k, shade in enumerate(shades):
            color = shade * np.array(to_rgb(orig_handle.get_facecolor()))
            left = -xdescent + k * width / shades.size
            stripes.append(Rectangle((left, -ydescent), 1.02 * width / shades.size, height, color=color, linewidth=0))
        frame = Rectangle((-xdescent, -ydescent), width, height, fill=False, edgecolor="#404040", linewidth=0.5)
        for each in (*stripes, frame):
            each.set_transform(trans)
        return [*stripes, frame]


Legend.update_default_handler_map({Gradient: _GradientHandler()})


def ink_on(color: ColorType) -> str:
    """Dark or light, whichever is seen on a colour."""
    red, green, blue = to_rgb(color)
    return "#1a2433" if 0.3 * red + 0.59 * green + 0.11 * blue > 0.45 else "#f4f7fb"


def parameter_of(ds: xr.Dataset, name: str) -> Parameter | None:
    """What the atlas's system says of a parameter, or None where system or parameter is unknown."""
    system = system_of(ds)
    return next((p for p in system.parameters if p.name == name), None) if system else None


def system_of(ds: xr.Dataset) -> System | None:
    """The atlas's system, or None where it names none that is known."""
    return stored_system(ds.attrs)


def symbol(ds: xr.Dataset, name: str) -> str:
    """A parameter's symbol as mathtext, without the dollars; its name upright where there is none to be shown."""
    parameter = parameter_of(ds, name)
    known = ds[name].attrs.get("symbol") or (parameter.symbol if parameter else "")
    return shown_symbol(str(known), name)


@lru_cache(maxsize=1024)
def shown_symbol(symbol: str, name: str) -> str:
    r"""The symbol, or where it is empty or no mathtext, such as ``\frac{``, the name upright."""
    try:
        parsed = bool(symbol) and MathTextParser("path").parse(f"${symbol}$")
    except ValueError:
        parsed = False
    return symbol if parsed else rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"


def axis_label(ds: xr.Dataset, name: str) -> str:
    r"""Meaning, symbol and unit of an axis, as ``impact speed $v$ [m/s]``; a pure number has none."""
    parameter = parameter_of(ds, name)
    attrs = ds[name].attrs
    meaning = str(attrs.get("long_name") or (parameter.meaning if parameter else "")).split(":")[0]
    unit = str(attrs.get("units") or (parameter.unit if parameter else "1"))
    return f"{meaning} ${symbol(ds, name)}${unit_ending(unit)}".strip()


def unit_ending(unit: str) -> str:
    """How a label ends that has this CF unit: in brackets; nothing for the 1 of pure numbers."""
    return "" if unit == "1" else f" [{unit_text(unit)}]"


def unit_text(unit: str) -> str:
    """A CF unit as an axis shows it."""
    return "per forcing period" if unit == "1/period" else unit


def title_line(ds: xr.Dataset) -> str:
    """The fixed parameters that matter, as ``$R = 0.8$,  $\\zeta = 0.05$``: all but an initial state of zero.

    They stand in the system's own order.
    """
    system = system_of(ds)
    order = [p.name for p in system.parameters] if system else [str(name) for name in ds.coords]
    fixed = [name for name in order if name in ds.coords and ds[name].ndim == 0 and ds[name].dtype.kind in "iuf"]
    states = system.states if system else ()
    values = {name: float(ds[name]) for name in fixed}
    return parameter_line([(symbol(ds, name), value) for name, value in values.items() if value or name not in states])


def parameter_title(system: System, values: Mapping[str, float]) -> str:
    """The same for one cell of a system."""
    shown = [p for p in system.parameters if values[p.name] or p.name not in system.states]
    return parameter_line([(shown_symbol(p.symbol, p.name), values[p.name]) for p in shown])


def parameter_line(items: Sequence[tuple[str, float]]) -> str:
    """Symbols with their values; where the line is too long for its page it will be broken between them."""
    return ",  ".join(f"${sign} = {number(value)}$" for sign, value in items)


def number(value: float) -> str:
    """A number as mathtext: up to six digits, and simple multiples of pi as such."""
    for below in (1, 2, 3, 4, 6):
        above = value / math.pi * below
        if above and abs(above - round(above)) < 1e-12 and 0 < abs(round(above)) <= 12:
            times = round(above)
            factor = {1: "", -1: "-"}.get(times, str(times))
            return rf"{factor}\pi" + (f"/{below}" if below > 1 else "")
    mantissa, _, power = f"{value:.6g}".partition("e")
    return rf"{mantissa} \times 10^{{{int(power)}}}" if power else mantissa
