"""Branches on a plot: stable parts solid, unstable ones dashed, events as marks with their kinds."""

from bokeh.models import CDSView, ColumnDataSource, GroupFilter, HoverTool
from bokeh.plotting import figure

from atlas.explore.branches import Drawn

STABLE, UNSTABLE = "#004488", "#bb5566"


class BranchLines:
    """Branches on a plot of the gap coordinate over the parameter."""

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

    def show(self, drawn: Drawn | None) -> None:
        """Show these branches in place of others; None shows none."""
        drawn = drawn or Drawn((), ())
        self._lines.data = {
            "xs": [x for _, x, _ in drawn.stretches],
            "ys": [y for *_, y in drawn.stretches],
            "color": [STABLE if stable else UNSTABLE for stable, *_ in drawn.stretches],
            "dash": ["solid" if stable else "dashed" for stable, *_ in drawn.stretches],
        }
        kinds, x, gap = zip(*drawn.events, strict=True) if drawn.events else ((), (), ())
        self._events.data = {"x": list(x), "gap": list(gap), "kind": [kind.replace("_", " ") for kind in kinds]}
