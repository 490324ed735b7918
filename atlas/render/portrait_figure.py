"""The portrait of a cell as a figure: time histories, phase planes, Poincare section, convergence of exponents."""

from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from atlas.cell import portrait_data as selection
from atlas.cell.trajectory import CellTrajectory, describe
from atlas.render import looks, style, text
from atlas.render.layout import STANDARD, FigureLayout
from atlas.render.looks import Entry, LineLook, MarkLook
from atlas.render.plotted_values import shown_label
from atlas.render.sweep import color_of
from workers.model.observables import Observable, observables_of
from workers.results import PER_PERIOD, PER_TIME, REGIME, UNDETERMINED

Array = NDArray[np.float64]

LINE, STOP = "#3a6ea5", "#6f6f6f"
"""Colours of the motion and of the stops."""
IMPACTS = {1.0: ("^", "#aa00ff", "upper"), -1.0: ("v", "#591b4a", "lower")}
"""Marker, colour and name of impacts at the upper and at the lower stop; the colours are used for nothing else."""
_STOP = LineLook("stop", STOP, (4, 2), 0.8)
_IN_A_COLUMN = 7
"""Maximum number of exponents written in one column beside their averages."""


class PortraitCoordinate(NamedTuple):
    """A displacement that a portrait shows: a combination of the coordinates x of the machine.

    row    coefficients of the displacement row . x, whose velocity is row . x'
    label  label of the displacement, with its unit
    rate   label of the velocity, with its unit
    stops  positions of its stops
    """

    row: Array
    label: str
    rate: str
    stops: tuple[float, ...]

    def project(self, states: Array) -> tuple[Array, Array]:
        """Return the displacement and the velocity, (N,) each, of states (N, 2n)."""
        return states[:, : self.row.size] @ self.row, states[:, self.row.size :] @ self.row


def figure(orbit: CellTrajectory, layout: FigureLayout = STANDARD) -> Figure:
    """Return the portrait of an orbit as a figure with the panels of Figs 3 to 5 of Li & Tan (2011).

    If the cell has observables, the return map of the first one replaces the Poincare section.
    """
    masses = [_shown(orbit, row) for row in selection.displacements(orbit)]
    planes: list[tuple[PortraitCoordinate, PortraitCoordinate | None]] = [(mass, None) for mass in masses]
    if len(masses) > 1:
        planes.append((masses[0], masses[1]))  # the plane of both displacements
    chatter = selection.chatter(orbit)
    many = len(selection.written(orbit)) > _IN_A_COLUMN
    with layout.context():
        if layout.has_side_legend:
            height, pad, columns = (7.6 if orbit.gap_row.size > 1 else 6.4) * layout.width / 7.0, 0.06, 1 + many
        else:
            height, pad, columns = (2.6 if orbit.gap_row.size > 1 else 2.0) * layout.width, 0.02, 2 + 2 * many
            height += 1.2 * (chatter is not None)
        drawn = layout.figure(height)
        drawn.set_layout_engine("constrained", hspace=pad, wspace=pad)
        title = f"{text.system_line(orbit.system, orbit.parameters)}\n{describe(orbit)}"
        layout.add_title(drawn, title, linespacing=1.4)
        rows, heights = _mosaic(layout.has_side_legend, len(masses), len(planes), chatter is not None, many)
        plots: dict[str, Axes] = drawn.subplot_mosaic(rows, height_ratios=heights)  # type: ignore[arg-type]
        for k, mass in enumerate(masses):
            ax = plots[f"history {k}"]
            ax.sharex(plots["history 0"])
            _history(ax, orbit, mass)
            ax.tick_params(labelbottom=k == len(masses) - 1)
        unforced = orbit.system.definition.unforced
        ax.set_xlabel("time $t$" if unforced else "time $t/T$ [forcing periods]")
        if chatter:
            _zoom(plots["zoom"], orbit, chatter)
        for k, (mass, other) in enumerate(planes):
            _phase_plane(plots[f"plane {k}"], orbit, mass, other)
        observables = observables_of(orbit.settings.observe, orbit.system.definition)
        if observables:
            _return_map(plots["section"], orbit, observables[0])
        else:
            _section(plots["section"], orbit)
        _convergence(plots["exponents"], orbit)
        _write_values(plots["values"], orbit, columns)
        layout.legend(drawn, _legend(orbit), handlelength=1.4)
    return drawn


def _mosaic(wide: bool, masses: int, planes: int, chatter: bool, many: bool) -> tuple[list[list[str]], list[float]]:
    """Return the names of a portrait's plots in a grid, by rows, and the relative heights of the rows.

    wide     True for a grid of 6 columns, with phase planes side by side, False for 2 columns
    masses   number of time histories
    planes   number of phase planes
    chatter  True if there is an enlarged chatter
    many     True if many exponents are written as numbers

    In a wide figure the Poincare section is beside the exponents.
    """
    histories = [f"history {k}" for k in range(masses)]
    pairs = [f"plane {k}" for k in range(planes)]
    if wide:
        rows = [[name] * (4 if chatter else 6) + ["zoom"] * (2 * chatter) for name in histories]
        rows.append([name for name in pairs for _ in range(6 // planes)])
        rows.append(["section"] * 2 + ["exponents"] * (3 - many) + ["values"] * (1 + many))
        return rows, [0.72] * masses + [1.25] * (len(rows) - masses)
    pairs.append("section")
    rows = [[name] * 2 for name in [*histories, *["zoom"] * chatter]]
    rows += [(pairs[k : k + 2] * 2)[:2] for k in range(0, len(pairs), 2)] + [["exponents"] * 2, ["values"] * 2]
    return rows, [0.72] * (masses + chatter) + [1.0] * (len(rows) - masses - chatter - 1) + [0.55]


def _shown(orbit: CellTrajectory, row: Array) -> PortraitCoordinate:
    system, labels = orbit.system, []
    for names, otherwise in ((system.states[: row.size], "y"), (system.states[row.size :], r"\dot{y}")):
        symbols = [text.state_symbol(system, name) for name in names]
        unit = text.unit_ending(*(system.parameter(names[i]).unit for i in np.flatnonzero(row)))
        labels.append(f"${text.combination(row.tolist(), symbols, otherwise)}${unit}")
    stops = tuple(stop for stop in orbit.stops if np.isfinite(stop)) if np.array_equal(row, orbit.gap_row) else ()
    return PortraitCoordinate(row, labels[0], labels[1], stops)


def _history(ax: Axes, orbit: CellTrajectory, coordinate: PortraitCoordinate) -> None:
    count = selection.periods(orbit)
    times, states = selection.path(orbit, count)
    values, _ = coordinate.project(states)
    ax.plot(times / orbit.unit, values, color=LINE, linewidth=0.9)
    for stop in coordinate.stops:
        ax.axhline(stop, **style.line(_STOP))
    for side in IMPACTS:
        at = selection.impact_times(orbit, side, count)
        _mark_impacts(ax, side, at / orbit.unit, np.interp(at, times, values))
    ax.set_xlim(0.0, count * orbit.period / orbit.unit)
    ax.margins(y=0.12)
    ax.set_ylabel(coordinate.label)


def _zoom(ax: Axes, orbit: CellTrajectory, chatter: slice) -> None:
    """Draw the distance from the stop during a chatter: impacts with ever shorter and lower flights between.

    ``chatter`` is the slice of the orbit's impacts.
    """
    impacts, side = orbit.impacts[chatter, 0] / orbit.unit, float(orbit.impacts[chatter.start, 1])
    times, away, ends, highest = selection.enlarged(orbit, chatter)
    ax.plot(times, away, color=LINE, linewidth=0.9)
    _mark_impacts(ax, side, impacts, 0.0 * impacts)
    ax.xaxis.set_major_locator(MaxNLocator(3))
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.set(xlim=ends, ylim=(-0.06 * highest, 1.25 * highest), ylabel="from the stop")
    ax.set_xlabel("time $t$" if orbit.system.definition.unforced else "time $t/T$")
    ax.set_title("chatter, enlarged", loc="left")


def _mark_impacts(ax: Axes, side: float, at: Array, values: Array) -> None:
    marker, ink, _ = IMPACTS[side]
    ax.plot(at, values, marker, color=ink, markersize=3.6, markeredgewidth=0, zorder=3)


def _phase_plane(
    ax: Axes, orbit: CellTrajectory, coordinate: PortraitCoordinate, other: PortraitCoordinate | None = None
) -> None:
    """Draw a displacement against its velocity, or two displacements against each other."""
    across, rate = coordinate.project(orbit.states)
    up = other.project(orbit.states)[0] if other else rate
    closed = bool(orbit.cell["period"])
    ax.plot(across, up, color=LINE, linewidth=0.9 if closed else 0.25, alpha=1.0 if closed else 0.75)
    for stop in coordinate.stops:
        ax.axvline(stop, **style.line(_STOP))
    for stop in other.stops if other else ():
        ax.axhline(stop, **style.line(_STOP))
    ax.set_xlabel(coordinate.label)
    ax.set_ylabel(other.label if other else coordinate.rate, labelpad=1.0)


def _section(ax: Axes, orbit: CellTrajectory) -> None:
    """Draw the Poincare section: the gap coordinate and its velocity at t = k T, or at an event of a limit cycle."""
    projection = _shown(orbit, orbit.gap_row)
    x, y = projection.project(orbit.section)
    few, ink = selection.is_few(x, y), looks.INK[int(orbit.cell[REGIME.name])]
    ax.plot(x, y, "o" if few else ".", color=ink, markersize=4.0 if few else 0.9, markeredgewidth=0, rasterized=not few)
    if np.ptp(x) < 1e-9 and np.ptp(y) < 1e-9:
        # A single point has no extent: the orbit gives the scale.
        for name, values in zip(("xlim", "ylim"), projection.project(orbit.states), strict=True):
            reach = 0.55 * float(np.ptp(values)) or 1.0
            middle = 0.5 * float(values.min() + values.max())
            ax.set(**{name: (middle - reach, middle + reach)})
    ax.set_xlabel(f"{projection.label} at {'its event' if orbit.cycle is not None else '$t = kT$'}")
    ax.set_ylabel(projection.rate, labelpad=1.0)
    ax.ticklabel_format(useOffset=False)


def _return_map(ax: Axes, orbit: CellTrajectory, observable: Observable) -> None:
    """Draw each value of an observable against the next one; this plot replaces the Poincare section."""
    values = orbit.cell[observable.variable]
    values = values[np.isfinite(values)]
    if int(orbit.cell["period"]) and int(orbit.cell[observable.number]) == len(values):  # the whole turn is known
        values = np.append(values, values[:1])
    few, ink = selection.is_few(values[:-1], values[1:]), looks.INK[int(orbit.cell[REGIME.name])]
    ax.plot(values[:-1], values[1:], "o" if few else ".", color=ink, markersize=4.0 if few else 1.5, markeredgewidth=0)
    ax.set_xlabel(shown_label(observable, orbit.system).replace("\n", " "))
    ax.set_ylabel("the next one", labelpad=1.0)
    ax.ticklabel_format(useOffset=False)


def _convergence(ax: Axes, orbit: CellTrajectory) -> None:
    periods = np.arange(1, len(orbit.running) + 1)
    ax.axhline(0.0, color="black", linewidth=0.6)
    values = np.sort(orbit.running, axis=1)[:, ::-1]
    written = selection.written(orbit)
    for i in sorted(range(values.shape[1]), key=lambda i: i % 2):
        # Equal exponents come in pairs: the second one is dashed.
        finite, dashes = np.where(np.isfinite(values[:, i]), values[:, i], np.nan), (0, (4, 3)) if i % 2 else "solid"
        ax.plot(periods, finite, color=color_of(i), linewidth=1.1, linestyle=dashes)
    for i, value in enumerate(written):
        if np.isfinite(value):
            dashes = (0, (2, 2)) if orbit.has_exact_exponents else (0, (1, 3))
            ax.axhline(value, color=color_of(i), linewidth=0.8, linestyle=dashes)
    ax.set(xscale="log", xlim=(1, periods[-1]), ylim=selection.exponent_ends(values, written))
    of, per = ("", PER_TIME) if orbit.system.definition.unforced else ("forcing ", PER_PERIOD)
    ax.set(xlabel=f"{of}periods averaged over", ylabel=rf"$\lambda_i$ [{per}]")


def _write_values(ax: Axes, orbit: CellTrajectory, columns: int) -> None:
    """Write the exponents as numbers, with all known digits, into an empty plot area, in ``columns`` columns."""
    ax.set_axis_off()
    error, written = float(orbit.cell["error"]), selection.written(orbit)
    unknown = int(orbit.cell[REGIME.name]) == UNDETERMINED
    digits = (4 if len(written) > _IN_A_COLUMN else 6) if orbit.has_exact_exponents else 3
    over = f"{' ' if columns > 1 else chr(10)}over {len(orbit.running)}{' periods' * (columns == 1)}" if unknown else ""
    lines = [("dotted: exact" if orbit.has_exact_exponents else f"dotted: averaged{over}", "black")]
    for i, value in enumerate(written):
        value_text = "unknown" if np.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"
        value_text = r"-\infty" if np.isneginf(value) else value_text
        lines.append((rf"$\lambda_{{{i + 1}}} = {value_text}$", color_of(i)))
    if not orbit.has_exact_exponents and not unknown and np.isfinite(error):
        lines.append((rf"($\lambda_1 \pm {text.number(float(f'{error:.1g}'))}$)", "black"))
    rows = -(-len(lines) // columns)
    step = 0.115 if columns == 1 else 1.0 / rows
    look: Any = {"transform": ax.transAxes, "fontsize": mpl.rcParams["legend.fontsize"], "va": "top"}
    used = [0] * columns
    for k, (line, ink) in enumerate(lines):
        column = k // rows
        ax.text(column / columns, 0.97 - step * used[column], line, color=ink, **look)
        used[column] += 1 + line.count("\n")


def _legend(orbit: CellTrajectory) -> list[Entry]:
    marks = [
        MarkLook(f"impact on the {name} stop", marker, 4.5, ink, ink, 0.0)
        for side, (marker, ink, name) in IMPACTS.items()
        if np.any(orbit.impacts[:, 1] == side)
    ]
    return [LineLook("motion", LINE, width=1.2), _STOP, *marks]
