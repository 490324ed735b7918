"""The panel that shows a motion: phase portraits of attractors, and an animation of the machine along its orbit."""

from collections.abc import Mapping
from typing import Any

from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Toggle
from bokeh.plotting import figure

from atlas.explore.front.script import call
from atlas.explore.motion import MotionPlotData
from atlas.explore.plot import style_plain
from atlas.explore.subject import Subject
from atlas.formatting import mathtext_to_unicode
from atlas.render.class_maps import PALETTE


class MotionPanel:
    """The phase portraits of a cell's attractors in one plot, and the machine, whose animation a button starts."""

    def __init__(self, subject: Subject) -> None:
        self._paths = ColumnDataSource({"xs": [], "ys": [], "color": []})
        self._path = ColumnDataSource({"y": [], "v": []})
        self._here = ColumnDataSource({"now_y": [], "now_v": []})
        self._machine = ColumnDataSource({"at": [], "lane": []})
        self._stops = ColumnDataSource({"stop": [], "low": [], "high": []})
        self._pace = ColumnDataSource({"per_period": [1.0]})
        look: dict[str, Any] = {"sizing_mode": "stretch_width", "toolbar_location": None, "tools": ""}
        self._phase = figure(height=230, x_axis_label="gap coordinate", y_axis_label="velocity", **look)
        self._phase.multi_line(xs="xs", ys="ys", source=self._paths, line_color="color", line_width=1.4)
        self._phase.scatter(x="now_y", y="now_v", source=self._here, size=9, fill_color="black", line_color="white")
        names = [
            mathtext_to_unicode(subject.system.parameter(name).symbol or name)
            for name in subject.system.definition.coordinates
        ]
        lanes = [name.removesuffix("(0)") for name in names]
        self._scene = figure(height=56 + 26 * len(lanes), y_range=(len(lanes) - 0.4, -0.6), **look)
        self._scene.segment(
            x0="stop", x1="stop", y0="low", y1="high", source=self._stops, line_width=5, color="#5a6675"
        )
        self._scene.scatter(x="at", y="lane", source=self._machine, marker="square", size=17, color="#4477aa")
        for plot in (self._phase, self._scene):
            style_plain(plot)
            plot.min_border_left = 58
        self._scene.yaxis[0].ticker = list(range(len(lanes)))
        self._scene.yaxis[0].major_label_overrides = dict(enumerate(lanes))
        self._play = Toggle(label="move the machine", sizing_mode="stretch_width")
        args = {"path": self._path, "here": self._here, "machine": self._machine, "pace": self._pace}
        self._play.js_on_change("active", call("play", **args))
        self.panel = column(self._phase, self._scene, self._play, sizing_mode="stretch_width", visible=False)

    def clear(self) -> None:
        """Hide the panel and stop the animation."""
        self.panel.visible = self._play.active = False
        self.portray({})

    def portray(self, motions: Mapping[int, MotionPlotData]) -> None:
        """Draw the phase portraits of attractors, given by index, each in the colour of its index."""
        colors = [PALETTE[index % len(PALETTE)] for index in motions]
        paths = motions.values()
        self._paths.data = {"xs": [m.y for m in paths], "ys": [m.v for m in paths], "color": colors}

    def show(self, motion: MotionPlotData) -> None:
        """Draw the cell's own motion and the machine at its start; the button then animates the machine."""
        if len(self._paths.data["xs"]) < 2:  # otherwise the portraits of all attractors are already shown
            self.portray({0: motion})
        y, v, *masses = motion.moving
        self._path.data = {"y": y, "v": v} | {f"q{k:02}": q for k, q in enumerate(masses)}
        self._here.data = {"now_y": [y[0]], "now_v": [v[0]]}
        self._machine.data = {"at": [q[0] for q in masses], "lane": list(range(len(masses)))}
        count, lane = len(motion.stops), motion.lane or 0
        self._stops.data = {"stop": motion.stops, "low": [lane - 0.4] * count, "high": [lane + 0.4] * count}
        self._pace.data = {"per_period": [motion.per_period]}
        self.panel.visible = True
