"""Plots of an explorer page: the plane with its axes and its image of cells, and diagrams of branches of orbits."""

from typing import Any

from bokeh.models import (
    BoxSelectTool,
    CDSView,
    ColumnDataSource,
    CustomJSTickFormatter,
    GroupFilter,
    HoverTool,
    Range1d,
    WheelZoomTool,
)
from bokeh.plotting import figure

from atlas.explore.accessibility import accessible_name
from atlas.explore.branches import BranchDiagram
from atlas.explore.front.script import TICKS
from atlas.explore.style import PLOT, RIGHT_MARGIN
from atlas.explore.subject import Subject
from atlas.explore.text import ticks
from atlas.explore.view_state import ViewState

STABLE, UNSTABLE = "#004488", "#bb5566"
KEYS = "arrows move it, plus and minus zoom, Enter chooses the cell in the middle"


def make_plot(subject: Subject, view: ViewState, mark: ColumnDataSource) -> tuple[figure, Any]:
    """Return the plot of a plane, and the Bokeh data source of its image, which the browser fills.

    subject   the subject that is explored
    view      the view state of the page, with the limits of the axes
    mark      Bokeh data source of the mark (x, y) on the clicked cell
    """
    kind_x, kind_y = ("log" if lattice.log else "linear" for lattice in (subject.x, subject.y))
    plot = figure(
        x_range=Range1d(*view.x),
        y_range=Range1d(*view.y),
        x_axis_type=kind_x,
        y_axis_type=kind_y,
        tools="pan,box_zoom,undo,redo,reset",
        toolbar_location="above",
        sizing_mode="stretch_both",
        min_border_left=76,  # room for any tick label, so that the plane keeps its size
        min_border_right=RIGHT_MARGIN,
        min_border_bottom=52,
        lod_threshold=None,
        stylesheets=[PLOT],
    )
    wheel = WheelZoomTool()
    plot.add_tools(wheel, BoxSelectTool(description="choose a window for an atlas"))
    plot.toolbar.active_scroll = wheel
    plot.toolbar.logo = None
    style_plain(plot)
    image = ColumnDataSource({name: [] for name in ("image", "x", "y", "dw", "dh", "cells")})
    plot.image_rgba(image="image", x="x", y="y", dw="dw", dh="dh", source=image, level="image", origin="top_left")
    for color, width in (("white", 4.0), ("black", 1.6)):
        ring: dict[str, Any] = {"fill_alpha": 0.0, "line_color": color, "line_width": width}
        plot.scatter(x="x", y="y", source=mark, marker="circle", size=15, **ring)
    label_axes(plot, subject, view)
    plot.html_attributes = accessible_name(
        f"map of {plot.xaxis[0].axis_label} across and {plot.yaxis[0].axis_label} up: {KEYS}"
    )
    return plot, image


def style_plain(plot: figure) -> None:
    """Remove the grid of a plot, set its axes in the page's font, and give them the page's tick format."""
    plot.grid.visible = False
    for axis in (plot.xaxis[0], plot.yaxis[0]):
        axis.update(axis_label_text_font_style="normal", axis_label_text_font_size="13px", minor_tick_line_color=None)
        axis.formatter = CustomJSTickFormatter(args={"base": 0.0, "unit": 1.0, "decimals": 3}, code=TICKS)


def label_axes(plot: figure, subject: Subject, view: ViewState) -> None:
    """Set the labels and tick formats of the axes for the visible windows of a view."""
    for axis, lattice, window in (
        (plot.xaxis[0], subject.x, view.x),
        (plot.yaxis[0], subject.y, view.y),
    ):
        marks = ticks(subject, lattice.axis.name, *window)
        axis.axis_label = marks.label
        formatter: Any = axis.formatter
        formatter.args = {"base": marks.base, "unit": marks.unit, "decimals": marks.decimals}


class BranchLines:
    """Draws branches of periodic orbits, and their events, in a plot of the gap coordinate over a parameter."""

    def __init__(self, plot: figure) -> None:
        self._lines = ColumnDataSource({"xs": [], "ys": [], "color": [], "dash": []})
        self._events = ColumnDataSource({"x": [], "gap": [], "kind": []})
        for dash in ("solid", "dashed"):
            plot.multi_line(
                xs="xs", ys="ys", source=self._lines, line_color="color", line_width=1.6, line_dash=dash,
                view=CDSView(filter=GroupFilter(column_name="dash", group=dash)),
            )  # fmt: skip
        marks = plot.scatter(x="x", y="gap", source=self._events, size=7, marker="diamond", color="#000000")
        plot.add_tools(HoverTool(renderers=[marks], tooltips=[("", "@kind"), ("at", "@x{0.00000000}")]))

    def show(self, drawn: BranchDiagram | None) -> None:
        """Draw the given branches instead of the earlier ones; None draws no branches."""
        drawn = drawn or BranchDiagram((), ())
        self._lines.data = {
            "xs": [x for _, x, _ in drawn.stretches],
            "ys": [y for *_, y in drawn.stretches],
            "color": [STABLE if stable else UNSTABLE for stable, *_ in drawn.stretches],
            "dash": ["solid" if stable else "dashed" for stable, *_ in drawn.stretches],
        }
        kinds, x, gap = zip(*drawn.events, strict=True) if drawn.events else ((), (), ())
        self._events.data = {"x": list(x), "gap": list(gap), "kind": [kind.replace("_", " ") for kind in kinds]}
