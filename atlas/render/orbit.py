"""The portrait of a cell: its motion in time, in its phase planes and at the section, and its exponents converging."""

import math
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from atlas.cell.orbit import SAMPLES, CellOrbit, describe, modulation
from atlas.render import machine, style
from atlas.render.fit import TITLE
from atlas.render.page import STANDARD, Page
from atlas.render.spectrum import color
from workers.results import QUASIPERIODIC, REGIME, SPECTRUM, UNDETERMINED

_SHOWN = 6
"""Forcing periods of the time histories, at least: more where an orbit is longer, up to twice as many."""
_IN_A_COLUMN = 7
"""Exponents that are written in one column beside their averages, at most."""
_LEAST_CHATTER = 4
"""Flights, each shorter than the one before, that make a chatter."""
_LINE, _UPPER, _LOWER, _STOP = "#3a6ea5", "#cc3311", "#e08a00", "#6f6f6f"


def figure(orbit: CellOrbit, page: Page = STANDARD) -> Figure:
    """The portrait as a figure: the panels of Figs 3 to 5 of Li & Tan (2011) on one page."""
    n = len(orbit.system.states) // 2
    masses = shown_displacements(orbit)
    with page.context():
        drawn = page.figure(_height(page, n, _chatter(orbit) is not None))
        drawn.set_layout_engine("constrained", hspace=0.06 if page.wide else 0.02, wspace=0.06 if page.wide else 0.02)
        if page.title:
            title = f"{style.parameter_title(orbit.system, orbit.parameters)}\n{describe(orbit)}"
            size = mpl.rcParams["font.size"]
            drawn.suptitle(title, fontsize=size, ha="left", x=0.012, linespacing=1.4).set_gid(TITLE)
        chatter = _chatter(orbit)
        if page.wide:
            grid = drawn.add_gridspec(len(masses) + 2, 6, height_ratios=[*(0.72 for _ in masses), 1.25, 1.25])
            histories = [grid[k, :4] if chatter else grid[k, :] for k in range(len(masses))]
            enlarged, rest = grid[: len(masses), 4:], len(masses)
        else:
            heights = [*(0.72 for _ in masses), *([0.72] * bool(chatter)), *([1.0] * (2 + (n > 1))), 0.55]
            grid = drawn.add_gridspec(len(heights), 2, height_ratios=heights)
            histories = [grid[k, :] for k in range(len(masses))]
            enlarged, rest = grid[len(masses), :], len(masses) + bool(chatter)
        above: Axes | None = None
        for k, (shown, place) in enumerate(zip(masses, histories, strict=True)):
            ax = above = drawn.add_subplot(place, sharex=above)
            last = k == len(masses) - 1
            _history(ax, orbit, shown)
            ax.tick_params(labelbottom=last)
            if last:
                ax.set_xlabel("time $t/T$ [forcing periods]")
        if chatter:
            _zoom(drawn.add_subplot(enlarged), orbit, chatter)
        (_planes_in_a_row if page.wide else _planes_in_pairs)(drawn, grid, rest, orbit)
        page.legend(drawn, _legend(orbit), handlelength=1.4)
    return drawn


def _height(page: Page, n: int, chatter: bool) -> float:
    """Height of a portrait of n masses in inches where none is asked for: a page, of narrow ones a column."""
    if page.wide:
        return (7.6 if n > 1 else 6.4) * page.width / 7.0
    return (2.6 if n > 1 else 2.0) * page.width + 1.2 * chatter


def _planes_in_a_row(drawn: Figure, grid: GridSpec, row: int, orbit: CellOrbit) -> None:
    """Phase planes side by side; below them the section beside the exponents."""
    masses = shown_displacements(orbit)
    width = 6 // (len(masses) + (len(masses) > 1))
    for k, shown in enumerate(masses):
        _phase_plane(drawn.add_subplot(grid[row, k * width : (k + 1) * width]), orbit, shown)
    if len(masses) > 1:
        _phase_plane(drawn.add_subplot(grid[row, 4:]), orbit, *masses)
    _section(drawn.add_subplot(grid[row + 1, :2]), orbit)
    columns = 1 + (len(_written(orbit)) > _IN_A_COLUMN)
    exponents = grid[row + 1, 2:].subgridspec(1, 2, width_ratios=[3.4, 1.15 * columns])
    _convergence(drawn.add_subplot(exponents[0]), orbit)
    _write_values(drawn.add_subplot(exponents[1]), orbit, columns)


def _planes_in_pairs(drawn: Figure, grid: GridSpec, row: int, orbit: CellOrbit) -> None:
    """The same on a narrow page: two in a row, the numbers under the exponents."""
    masses = shown_displacements(orbit)
    two = len(masses) > 1
    places = [grid[row, 0], grid[row, 1], *([grid[row + 1, 0], grid[row + 1, 1]] if two else [])]
    for shown, place in zip(masses, places, strict=False):
        _phase_plane(drawn.add_subplot(place), orbit, shown)
    if two:
        _phase_plane(drawn.add_subplot(places[2]), orbit, *masses)
    _section(drawn.add_subplot(places[-1]), orbit)
    row += 1 + two
    _convergence(drawn.add_subplot(grid[row, :]), orbit)
    _write_values(drawn.add_subplot(grid[row + 1, :]), orbit, 4 if len(_written(orbit)) > _IN_A_COLUMN else 2)


class Shown(NamedTuple):
    """A displacement that a portrait shows, row . x, its velocity row . x', and the stops on it; labels with units."""

    row: NDArray[np.float64]
    label: str
    rate: str
    stops: tuple[float, ...]

    def of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """The displacement (N,) in states (N, 2n)."""
        return np.asarray(states[:, : self.row.size] @ self.row)

    def rate_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """The velocity (N,) in states (N, 2n)."""
        return np.asarray(states[:, self.row.size :] @ self.row)


def shown_displacements(orbit: CellOrbit) -> list[Shown]:
    """The two displacements, or the only one, that a portrait shows.

    Where the stops are on one coordinate: that and the first other one, in the system's order. Where they are on a
    combination of several: that, and the first of those.
    """
    row = orbit.gap_row
    n = row.size
    stopped = [int(i) for i in np.flatnonzero(row)]
    gap = _shown(orbit, row)
    if len(stopped) == 1:
        others = [i for i in range(n) if i not in stopped][:1]
        found = [(stopped[0], gap), *((i, _shown(orbit, np.eye(n)[i])) for i in others)]
        return [each for _, each in sorted(found, key=lambda pair: pair[0])]
    return [gap, _shown(orbit, np.eye(n)[stopped[0]])]


def _shown(orbit: CellOrbit, row: NDArray[np.float64]) -> Shown:
    n = row.size
    labels = []
    for names, otherwise in ((orbit.system.states[:n], "y"), (orbit.system.states[n:], r"\dot{y}")):
        symbols = [machine.symbol_of(orbit.system, name) for name in names]
        (unit, *others) = {orbit.system.parameter(names[i]).unit for i in np.flatnonzero(row)}
        known = "" if others else f" [{style.unit_text(unit)}]"
        labels.append(f"${machine.combination(row.tolist(), symbols, otherwise)}${known}")
    stops = tuple(stop for stop in orbit.stops if np.isfinite(stop)) if np.array_equal(row, orbit.gap_row) else ()
    return Shown(row, labels[0], labels[1], stops)


def provenance(orbit: CellOrbit) -> style.Provenance:
    """The provenance of a portrait."""
    return style.Provenance(
        f"impact-atlas: {orbit.system.name}, one cell", orbit.digest, f"impact-atlas {style.own_version()}"
    )


def _history(ax: Axes, orbit: CellOrbit, shown: Shown) -> None:
    periods = _window(orbit)
    times, states = _repeated(orbit, periods)
    values = shown.of(states)
    ax.plot(times / orbit.period, values, color=_LINE, linewidth=0.9)
    for stop in shown.stops:
        ax.axhline(stop, color=_STOP, linewidth=0.8, linestyle=(0, (4, 2)))
    for side, ink in ((1.0, _UPPER), (-1.0, _LOWER)):
        at = _impact_times(orbit, side, periods)
        ax.plot(at / orbit.period, np.interp(at, times, values), "o", color=ink, markersize=2.6, markeredgewidth=0)
    ax.set_xlim(0.0, periods)
    ax.margins(y=0.12)
    ax.set_ylabel(shown.label)


def _window(orbit: CellOrbit) -> int:
    """Forcing periods of the time histories: an orbit's, or those in which a torus has been through its modulation."""
    if int(orbit.cell[REGIME.name]) == QUASIPERIODIC:
        return min(_span(orbit), max(_SHOWN, math.ceil(1.5 * modulation(orbit.gap(orbit.section)))))
    return min(max(_SHOWN, int(orbit.cell["period"])), 2 * _SHOWN)


def _chatter(orbit: CellOrbit) -> slice | None:
    """The first impacts on one stop in ever shorter intervals, from one on whose flights are still drawn; or None."""
    times, sides = orbit.impacts[:, 0], orbit.impacts[:, 1]
    flights = np.diff(times)
    shorter = (sides[2:] == sides[1:-1]) & (sides[1:-1] == sides[:-2]) & (flights[1:] < flights[:-1])
    ends = np.flatnonzero(np.diff(np.pad(shorter, 1).astype(np.int8)))
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        drawn = np.flatnonzero(flights[first : last + 1] > 5.0 * orbit.period / SAMPLES)
        if last - first >= _LEAST_CHATTER and drawn.size:
            return slice(int(first + max(0, drawn[-1] - 1)), int(last + 2))
    return None


def _zoom(ax: Axes, orbit: CellOrbit, chatter: slice) -> None:
    """The distance from the stop through a chatter: flights that become ever shorter and lower."""
    times = orbit.impacts[chatter, 0]
    side = orbit.impacts[chatter.start, 1]
    room = 0.25 * float(np.ptp(times))
    inside = (orbit.times >= times[0] - 0.3 * room) & (orbit.times <= times[-1] + room)
    away = np.abs(orbit.gap(orbit.states) - orbit.stops[int(side > 0)])
    between = (orbit.times >= times[0]) & (orbit.times <= times[-1])
    ax.plot(orbit.times[inside] / orbit.period, away[inside], color=_LINE, linewidth=0.9)
    ax.plot(times / orbit.period, 0.0 * times, "o", color=_UPPER if side > 0 else _LOWER, markersize=2.6, mew=0)
    ax.set_xlim((times[0] - 0.3 * room) / orbit.period, (times[-1] + room) / orbit.period)
    ax.set_ylim(-0.06 * away[between].max(), 1.25 * away[between].max())
    ax.xaxis.set_major_locator(MaxNLocator(3))
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.set_xlabel("time $t/T$")
    ax.set_ylabel("from the stop")
    ax.set_title("chatter, enlarged", loc="left")


def _phase_plane(ax: Axes, orbit: CellOrbit, shown: Shown, other: Shown | None = None) -> None:
    """A displacement against its velocity, or two displacements against each other."""
    across, up = shown.of(orbit.states), other.of(orbit.states) if other else shown.rate_of(orbit.states)
    closed = bool(orbit.cell["period"])
    ax.plot(across, up, color=_LINE, linewidth=0.9 if closed else 0.25, alpha=1.0 if closed else 0.75)
    for stop in shown.stops:
        ax.axvline(stop, color=_STOP, linewidth=0.8, linestyle=(0, (4, 2)))
    for stop in other.stops if other else ():
        ax.axhline(stop, color=_STOP, linewidth=0.8, linestyle=(0, (4, 2)))
    ax.set_xlabel(shown.label)
    ax.set_ylabel(other.label if other else shown.rate, labelpad=1.0)


def _section(ax: Axes, orbit: CellOrbit) -> None:
    """The gap coordinate and its velocity at the section."""
    gap = _shown(orbit, orbit.gap_row)
    x, y = gap.of(orbit.section), gap.rate_of(orbit.section)
    # Of thousands of states many may be one point, where a cell was undetermined and closes after all.
    extent = max(float(np.ptp(x)), float(np.ptp(y)), 1e-12)
    few = np.unique(np.round(np.stack([x, y]) / extent, 2), axis=1).shape[1] <= 64
    ink = style.INK[int(orbit.cell[REGIME.name])]
    ax.plot(x, y, "o" if few else ".", color=ink, markersize=4.0 if few else 0.9, markeredgewidth=0, rasterized=not few)
    if np.ptp(x) < 1e-9 and np.ptp(y) < 1e-9:
        # One point has no extent of its own: the orbit's gives the picture its scale.
        for axis, values in ((ax.set_xlim, gap.of(orbit.states)), (ax.set_ylim, gap.rate_of(orbit.states))):
            reach = 0.55 * float(np.ptp(values)) or 1.0
            middle = 0.5 * float(values.min() + values.max())
            axis(middle - reach, middle + reach)
    ax.set_xlabel(f"{gap.label} at $t = kT$")
    ax.set_ylabel(gap.rate, labelpad=1.0)
    ax.ticklabel_format(useOffset=False)


def _convergence(ax: Axes, orbit: CellOrbit) -> None:
    periods = np.arange(1, len(orbit.running) + 1)
    ax.axhline(0.0, color="black", linewidth=0.6)
    values = np.sort(orbit.running, axis=1)[:, ::-1]
    spectrum = _written(orbit)
    for i in sorted(range(values.shape[1]), key=lambda i: i % 2):
        # Equal ones come in pairs: one of them is dashed, and lies on the other.
        shown, dashes = np.where(np.isfinite(values[:, i]), values[:, i], np.nan), (0, (4, 3)) if i % 2 else "solid"
        ax.plot(periods, shown, color=color(i), linewidth=1.1, linestyle=dashes)
    for i, value in enumerate(spectrum):
        if np.isfinite(value):
            ax.axhline(value, color=color(i), linewidth=0.8, linestyle=(0, (2, 2)) if orbit.exact else (0, (1, 3)))
    ax.set_xscale("log")
    ax.set_xlim(1, periods[-1])
    low, high = _range(values, spectrum)
    ax.set_ylim(low, high)
    ax.set_xlabel("forcing periods averaged over")
    ax.set_ylabel(r"$\lambda_i$ [per forcing period]")


def _written(orbit: CellOrbit) -> NDArray[np.float64]:
    """The exponents that are written in numbers: the cell's, or, where its class is not known, those of the path that
    is drawn. What such a cell holds are averages over motions that it has left.
    """
    if int(orbit.cell[REGIME.name]) == UNDETERMINED:
        return np.sort(orbit.running[-1])[::-1]
    return np.asarray(orbit.cell[SPECTRUM.name])


def _write_values(ax: Axes, orbit: CellOrbit, columns: int) -> None:
    """The exponents in numbers, as many digits as are known, in a plot area of their own."""
    ax.set_axis_off()
    error = float(orbit.cell["error"])
    unknown = int(orbit.cell[REGIME.name]) == UNDETERMINED
    digits = (4 if len(_written(orbit)) > _IN_A_COLUMN else 6) if orbit.exact else 3
    many = f"averaged over\n{len(orbit.running)} periods:" if columns == 1 else f"averaged over {len(orbit.running)}:"
    lines = [("exact:" if orbit.exact else many if unknown else "averaged:", "black")]
    for i, value in enumerate(_written(orbit)):
        text = (
            r"-\infty"
            if np.isneginf(value)
            else "unknown"
            if np.isnan(value)
            else f"{round(value, digits) + 0.0:.{digits}f}"
        )
        lines.append((rf"$\lambda_{{{i + 1}}} = {text}$", color(i)))
    if not orbit.exact and not unknown and np.isfinite(error):
        lines.append((rf"($\lambda_1 \pm {style.number(float(f'{error:.1g}'))}$)", "black"))
    size = mpl.rcParams["legend.fontsize"]
    rows = -(-len(lines) // columns)
    used = [0.0] * columns
    for k, (text, ink) in enumerate(lines):
        column = k // rows
        step = 0.115 if columns == 1 else 1.0 / rows
        ax.text(
            column / columns,
            0.97 - step * used[column],
            text,
            transform=ax.transAxes,
            color=ink,
            fontsize=size,
            va="top",
        )
        used[column] += 1 + text.count("\n")


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
