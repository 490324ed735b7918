"""Pinned cells: marked and numbered on the plane, listed with their notes, and written beside the spec of an atlas."""

from functools import partial
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, TextInput
from bokeh.plotting import figure

from atlas.explore.access import named
from atlas.explore.chosen import Chosen, Pin
from atlas.explore.state import Store
from atlas.explore.subject import Subject
from atlas.explore.words import where


class Pins:
    """The list of pins, and their marks."""

    def __init__(self, subject: Subject, store: Store, plot: figure) -> None:
        self._subject, self._store = subject, store
        self._listed: tuple[Pin, ...] | None = None
        self._marks = ColumnDataSource({"pin_x": [], "pin_y": [], "number": []})
        at: dict[str, Any] = {"x": "pin_x", "y": "pin_y", "source": self._marks}
        plot.scatter(marker="inverted_triangle", size=13, fill_color="#ffdd55", line_color="black", **at)
        look: dict[str, Any] = {"text_color": "black", "text_outline_color": "white", "text_font_style": "bold"}
        plot.text(text="number", x_offset=8, y_offset=-4, **at, **look)
        note = "a note on the cell clicked"
        self._note = TextInput(placeholder=note, html_attributes=named(note), sizing_mode="stretch_width")
        self._pin = Button(label="pin it", width=70)
        self._pin.on_click(self._add)
        self._new = row(self._note, self._pin, sizing_mode="stretch_width", visible=False)
        self._list = column(sizing_mode="stretch_width")
        self.panel = column(self._new, self._list, sizing_mode="stretch_width")

    def show(self, chosen: Chosen) -> None:
        """List the pins, and mark those of the plane in view."""
        names, plane = self._subject.axes, dict(chosen.plane.parameters)
        self._new.visible = chosen.cell is not None
        marks: dict[str, list[Any]] = {"pin_x": [], "pin_y": [], "number": []}
        for k, (values, _) in enumerate(chosen.pins):
            there = dict(values)
            if all(there[name] == value for name, value in plane.items()):
                for key, value in zip(marks, (*(there[name] for name in names), str(k + 1)), strict=True):
                    marks[key].append(value)
        if marks != self._marks.data:
            self._marks.data = marks
        if chosen.pins != self._listed:
            self._listed = chosen.pins
            self._list.children = [self._line(k, pin) for k, pin in enumerate(chosen.pins)]

    def _line(self, place: int, pin: Pin) -> Any:
        values, note = pin
        there = ", ".join(f"{name} = {value}" for name, value in where(self._subject, dict(values)).items())
        label = f"{place + 1}  {there}{': ' if note else ''}{note}"
        go = Button(label=label, sizing_mode="stretch_width", align="center")
        go.on_click(partial(self._go, pin))
        remove = Button(label="×", width=34)
        remove.on_click(partial(self._remove, pin))
        return row(go, remove, sizing_mode="stretch_width")

    def _add(self) -> None:
        cell = self._store.now.chosen.cell
        if cell is None:
            return
        values = self._subject.values(*cell)
        pin = tuple((p.name, values[p.name]) for p in self._subject.system.parameters), self._note.value
        self._store.choose(pins=(*(each for each in self._store.now.chosen.pins if each[0] != pin[0]), pin))
        self._note.value = ""

    def _go(self, pin: Pin) -> None:
        """Show the plane and the details of a pin."""
        cell = self._subject.point(dict(pin[0]))
        self._store.choose(plane=cell[0], cell=cell)

    def _remove(self, pin: Pin) -> None:
        self._store.choose(pins=tuple(each for each in self._store.now.chosen.pins if each != pin))


def pins_text(pins: tuple[Pin, ...]) -> str:
    """Pins as comments of a TOML file, each with its note and all its parameters in full; empty without any."""
    lines = []
    for k, (values, note) in enumerate(pins):
        lines += [f"# pin {k + 1}: {' '.join(note.split())}".rstrip(": "), *(f"#   {n} = {v!r}" for n, v in values)]
    return "\n" + "\n".join(lines) + "\n" if lines else ""
