"""The portrait of a cell: its motion in time, in its phase planes and at the section, and its exponents converging."""

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.cell.orbit import CellOrbit, describe
from atlas.render import style
from atlas.render.spectrum import color
from workers.results import REGIME, SPECTRUM

_HEIGHT = 7.6
_SHOWN = 6
"""Forcing periods of the time histories, at least: more where an orbit is longer, up to twice as many."""
_LINE, _UPPER, _LOWER, _STOP = "#3a6ea5", "#cc3311", "#e08a00", "#6f6f6f"


def figure(orbit: CellOrbit) -> Figure:
    """The portrait as a figure: the panels of Figs 3 to 5 of Li & Tan (2011) on one page."""
    n = len(orbit.system.states) // 2
    masses = range(min(n, 2))
    with rc_context(style.STYLE | {"axes.labelsize": 10.0, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5}):
        drawn = style.new_figure(_HEIGHT if n > 1 else _HEIGHT - 1.2)
        drawn.set_layout_engine("constrained", hspace=0.06, wspace=0.06)
        title = style.parameter_title(orbit.system, orbit.parameters)
        drawn.suptitle(f"{title}\n{describe(orbit)}", fontsize=10.0, ha="left", x=0.012, linespacing=1.4)
        grid = drawn.add_gridspec(len(masses) + 2, 6, height_ratios=[*(0.72 for _ in masses), 1.25, 1.25])
        above: Axes | None = None
        for i in masses:
            ax = above = drawn.add_subplot(grid[i, :], sharex=above)
            _history(ax, orbit, i)
            ax.tick_params(labelbottom=i == masses[-1])
        row = len(masses)
        width = 6 // (len(masses) + (n > 1))
        for i in masses:
            _phase_plane(drawn.add_subplot(grid[row, i * width : (i + 1) * width]), orbit, i, n + i)
        if n > 1:
            _phase_plane(drawn.add_subplot(grid[row, 4:]), orbit, 0, 1)
        _section(drawn.add_subplot(grid[row + 1, :2]), orbit, 0, n)
        exponents = grid[row + 1, 2:].subgridspec(1, 2, width_ratios=[3.4, 1.0])
        _convergence(drawn.add_subplot(exponents[0]), orbit)
        _write_values(drawn.add_subplot(exponents[1]), orbit)
        drawn.legend(handles=_legend(orbit), loc="outside lower center", ncols=4, handlelength=1.4)
    return drawn


def provenance(orbit: CellOrbit) -> style.Provenance:
    """The provenance of a portrait."""
    return style.Provenance(
        f"impact-atlas: {orbit.system.name}, one cell", orbit.digest, f"impact-atlas {style.own_version()}"
    )


def symbol(orbit: CellOrbit, i: int) -> str:
    """The symbol of a component of the state; the system knows it as the parameter that sets its initial value."""
    return orbit.system.parameter(orbit.system.states[i]).symbol.removesuffix("(0)")


def _label(orbit: CellOrbit, i: int) -> str:
    unit = style.unit_text(orbit.system.parameter(orbit.system.states[i]).unit)
    return f"${symbol(orbit, i)}$ [{unit}]"


def _stops_of(orbit: CellOrbit, i: int) -> tuple[float, ...]:
    """The stops as values of a displacement, where it is the one that they stop."""
    row = np.array(orbit.system.build(orbit.parameters).gap_row)
    return orbit.stops if row[i] == 1.0 and np.count_nonzero(row) == 1 else ()


def _history(ax: Axes, orbit: CellOrbit, i: int) -> None:
    shown = min(max(_SHOWN, int(orbit.cell["period"])), 2 * _SHOWN)
    times, states = _repeated(orbit, shown)
    ax.plot(times / orbit.period, states[:, i], color=_LINE, linewidth=0.9)
    for stop in _stops_of(orbit, i):
        ax.axhline(stop, color=_STOP, linewidth=0.8, linestyle=(0, (4, 2)))
    for side, ink in ((1.0, _UPPER), (-1.0, _LOWER)):
        at = _impact_times(orbit, side, shown)
        ax.plot(
            at / orbit.period, np.interp(at, times, states[:, i]), "o", color=ink, markersize=2.6, markeredgewidth=0
        )
    ax.set_xlim(0.0, shown)
    ax.margins(y=0.12)
    ax.set_ylabel(_label(orbit, i))
    if i == min(len(orbit.system.states) // 2, 2) - 1:
        ax.set_xlabel("time $t/T$ [forcing periods]")


def _phase_plane(ax: Axes, orbit: CellOrbit, i: int, k: int) -> None:
    states = orbit.states
    closed = bool(orbit.cell["period"])
    ax.plot(states[:, i], states[:, k], color=_LINE, linewidth=0.9 if closed else 0.25, alpha=1.0 if closed else 0.75)
    for stop in _stops_of(orbit, i):
        ax.axvline(stop, color=_STOP, linewidth=0.8, linestyle=(0, (4, 2)))
    if k < len(orbit.system.states) // 2:
        for stop in _stops_of(orbit, k):
            ax.axhline(stop, color=_STOP, linewidth=0.8, linestyle=(0, (4, 2)))
    ax.set_xlabel(_label(orbit, i))
    ax.set_ylabel(_label(orbit, k), labelpad=1.0)


def _section(ax: Axes, orbit: CellOrbit, i: int, k: int) -> None:
    x, y = orbit.section[:, i], orbit.section[:, k]
    few = x.size <= 64
    ink = style.INK[int(orbit.cell[REGIME.name])]
    ax.plot(x, y, "o" if few else ".", color=ink, markersize=4.0 if few else 0.9, markeredgewidth=0, rasterized=not few)
    if np.ptp(x) < 1e-9 and np.ptp(y) < 1e-9:
        # One point has no extent of its own: the orbit's gives the picture its scale.
        for axis, values in ((ax.set_xlim, orbit.states[:, i]), (ax.set_ylim, orbit.states[:, k])):
            reach = 0.55 * float(np.ptp(values)) or 1.0
            middle = 0.5 * float(values.min() + values.max())
            axis(middle - reach, middle + reach)
    ax.set_xlabel(f"{_label(orbit, i)} at $t = kT$")
    ax.set_ylabel(_label(orbit, k), labelpad=1.0)
    ax.ticklabel_format(useOffset=False)


def _convergence(ax: Axes, orbit: CellOrbit) -> None:
    periods = np.arange(1, len(orbit.running) + 1)
    spectrum = np.asarray(orbit.cell[SPECTRUM.name])
    ax.axhline(0.0, color="black", linewidth=0.6)
    values = np.sort(orbit.running, axis=1)[:, ::-1]
    for i in reversed(range(values.shape[1])):
        ax.plot(periods, np.where(np.isfinite(values[:, i]), values[:, i], np.nan), color=color(i), linewidth=1.1)
    for i, value in enumerate(spectrum):
        if np.isfinite(value):
            ax.axhline(value, color=color(i), linewidth=0.8, linestyle=(0, (2, 2)) if orbit.exact else (0, (1, 3)))
    ax.set_xscale("log")
    ax.set_xlim(1, periods[-1])
    low, high = _range(values, spectrum)
    ax.set_ylim(low, high)
    ax.set_xlabel("forcing periods averaged over")
    ax.set_ylabel(r"$\lambda_i$ [per forcing period]")


def _write_values(ax: Axes, orbit: CellOrbit) -> None:
    """The exponents in numbers, as many digits as are known, in a plot area of their own."""
    ax.set_axis_off()
    spectrum, error = np.asarray(orbit.cell[SPECTRUM.name]), float(orbit.cell["error"])
    digits = 6 if orbit.exact else 3
    lines = [("exact:" if orbit.exact else "averaged:", "black")]
    for i, value in enumerate(spectrum):
        text = r"-\infty" if np.isneginf(value) else "unknown" if np.isnan(value) else f"{value:.{digits}f}"
        lines.append((rf"$\lambda_{{{i + 1}}} = {text}$", color(i)))
    if not orbit.exact and np.isfinite(error):
        lines.append((rf"($\lambda_1 \pm {style.number(float(f'{error:.1g}'))}$)", "black"))
    for k, (text, ink) in enumerate(lines):
        ax.text(0.0, 0.97 - 0.115 * k, text, transform=ax.transAxes, color=ink, fontsize=9.0, va="top", clip_on=False)


def _range(values: NDArray[np.float64], spectrum: NDArray[np.float64]) -> tuple[float, float]:
    """Limits that show where averages end and most of their way: the first periods may lie far off."""
    later = values[min(9, len(values) - 1) :]
    shown = np.concatenate([later[np.isfinite(later)], spectrum[np.isfinite(spectrum)], [0.0]])
    low, high = float(shown.min()), float(shown.max())
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room


def _repeated(orbit: CellOrbit, shown: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The path over so many periods; a closed orbit that is shorter begins again."""
    span = _span(orbit)
    if span >= shown:
        return orbit.times, orbit.states
    turns = -(-shown // span)
    times = np.concatenate([orbit.times + turn * span * orbit.period for turn in range(turns)])
    return times, np.concatenate([orbit.states] * turns)


def _impact_times(orbit: CellOrbit, side: float, shown: int) -> NDArray[np.float64]:
    span = _span(orbit)
    times = orbit.impacts[orbit.impacts[:, 1] == side, 0]
    turns = max(1, -(-shown // span))
    times = np.concatenate([times + turn * span * orbit.period for turn in range(turns)])
    return times[times <= shown * orbit.period]


def _span(orbit: CellOrbit) -> int:
    """Forcing periods of the path."""
    return round(float(orbit.times[-1] / orbit.period))


def _legend(orbit: CellOrbit) -> list[Line2D]:
    entries = [Line2D([], [], color=_LINE, linewidth=1.2, label="motion")]
    entries.append(Line2D([], [], color=_STOP, linewidth=0.9, linestyle=(0, (4, 2)), label="stop"))
    for side, ink, name in ((1.0, _UPPER, "upper"), (-1.0, _LOWER, "lower")):
        if np.any(orbit.impacts[:, 1] == side):
            entries.append(
                Line2D([], [], linestyle="", marker="o", markersize=4, color=ink, label=f"impact on the {name} stop")
            )
    return entries
