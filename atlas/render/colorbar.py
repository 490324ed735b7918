"""Drawing the colorbar of a map, with readable ticks."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

from atlas.render import raster
from atlas.render.layers import ScalarLayer
from atlas.render.scales import LINEAR, LOG, TWO_SIDED

NORMS: Mapping[str, Callable[[float, float], Normalize]] = {
    LINEAR: Normalize, LOG: LogNorm, TWO_SIDED: lambda low, high: TwoSlopeNorm(0.0, low, high),
}  # fmt: skip
"""Matplotlib's norm for each form of a colour scale."""
_LOG_TICKS = 8
"""Maximum number of ticks of a logarithmic colorbar."""


def draw_bar(fig: Figure, panels: Sequence[Axes], bar: ScalarLayer, below: bool = False) -> None:
    """Draw the colorbar of the plots ``panels`` to their right or ``below`` them.

    Its ends are pointed if values lie beyond the limits. The colorbar of exponents has a line at zero, where the linear
    scales of its two halves meet.
    """
    (low, high), form = bar.ends, bar.scale.form
    values = bar.values[np.isfinite(bar.values) & (bar.values != 0.0)]  # zero has no logarithm, or its own entry
    beyond = int(np.any(values < low)) + 2 * int(np.any(values > high))
    extend = ("neither", "min", "max", "both")[beyond]
    mappable = ScalarMappable(NORMS[form](low, high), ListedColormap(bar.scale.table / 255))
    look: Any = {"aspect": 28, "pad": 0.02, "extendfrac": 0.03, "location": "bottom" if below else "right"}
    host_axes: Any = panels[0] if len(panels) == 1 else list(panels)  # a single plot keeps its grid cell
    colorbar = fig.colorbar(mappable, ax=host_axes, extend=extend, **look)
    two = form == TWO_SIDED and -low != high
    colorbar.set_label(f"{bar.label}\n(two linear scales, joined at 0)" if two else bar.label)
    colorbar.outline.set_linewidth(0.6)
    if form == LOG:
        _log_ticks(colorbar, low, high)
    elif form == TWO_SIDED:
        colorbar.set_ticks(_ticks(low, high, 3 if below else 5))  # numbers side by side need more room
        (colorbar.ax.axvline if below else colorbar.ax.axhline)(0.0, color="black", linewidth=0.7)


def _ticks(low: float, high: float, limit: int) -> list[float]:
    """Return zero and round numbers from ``low`` to ``high``, with a step of its own on either side of zero."""
    nice = MaxNLocator(limit, steps=[1, 2, 2.5, 5, 10])
    both = np.concatenate([nice.tick_values(low, 0.0), nice.tick_values(0.0, high)])
    return [float(tick) for tick in np.unique(both[(both >= low) & (both <= high)].round(12))]


def _log_ticks(bar: Colorbar, low: float, high: float) -> None:
    """Set the ticks of a logarithmic colorbar: powers of ten over many decades, else 1, 2, 5 in plain numbers."""
    decades, axis = math.log10(high / low), bar.ax.yaxis
    if decades > 3.0 or high < 1e-3:
        bar.set_ticks(LogLocator(numticks=_LOG_TICKS))
        if decades > 3.0:
            axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
        return
    fitting = [steps for steps in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)) if decades * len(steps) <= _LOG_TICKS]
    raster.plain_ticks(axis, fitting[0] if fitting else (1.0,))
