"""The controls of an explorer page: menus of map, style and axes, a slider for each parameter, and files to save."""

import html
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from bokeh.events import ButtonClick
from bokeh.layouts import row
from bokeh.models import Button, Div, NumericInput, Select, Slider, Spinner

from atlas.errors import InputError
from atlas.explore.accessibility import accessible_name
from atlas.explore.front.script import call, html_part
from atlas.explore.page_state import PageModel, PageState
from atlas.explore.style import FOCUS, LOOK, TEXT
from atlas.explore.subject import STEPS, Subject, slider_range
from atlas.explore.text import symbol_of
from atlas.formatting import mathtext_to_unicode

CELLS = 400
"""Default number of cells across a new atlas."""
TYPED = 76
"""Width, in pixels, of the number beside a slider."""


class Controls:
    """The widgets that show the state of a page and change it; ``go`` opens the page of other axes or another layer."""

    def __init__(self, subject: Subject, store: PageModel, go: Callable[..., None]) -> None:
        self.subject, self._store = subject, store
        view = store.now.view
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        tell = call("tell")
        self.files = {suffix: Button(label=suffix.upper(), **wide) for suffix in ("png", "svg", "pdf")}
        self.cells = Spinner(title="cells across", low=2, high=100_000, step=50, value=CELLS, **wide)
        self.make = Button(label="make this an atlas", **wide)
        self.axes = self._axes(go)
        values = dict(view.plane.parameters)
        self.sliders = {name: _slider(subject, name, value) for name, value in values.items()}
        self.typed = {
            name: NumericInput(value=value, mode="float", width=TYPED, align="center", format="0[.]00000", name=name)
            for name, value in values.items()
        }
        for button in self.files.values():
            button.js_on_event(ButtonClick, tell)  # before the click reaches the server
        self._wire()
        self.show(store.now)

    def columns(self, cuts: list[Button]) -> list[Any]:
        """Return the widgets of the controls from the top; ``cuts`` are the buttons that start a cut."""
        states = self._sliders(states=True)
        return [
            Div(text=html_part("look"), stylesheets=[TEXT, FOCUS, LOOK], sizing_mode="stretch_width"),
            heading("a cut, or draw one over the plane"), row(*cuts, sizing_mode="stretch_width"),
            heading("axes"), *self.axes,
            heading("parameters"), *self._sliders(states=False),
            heading("save the picture"), row(*self.files.values(), sizing_mode="stretch_width"),
            heading("a new atlas of the view, or of a box"), self.cells, self.make,
            *([heading("initial state"), *states] if states else []),
        ]  # fmt: skip

    def show(self, state: PageState) -> None:
        """Show the parameters of a page's state in the sliders and number fields."""
        view = state.view
        for name, value in view.plane.parameters:
            slider = self.sliders[name]
            if not slider.start <= value <= slider.end:
                slider.update(start=min(slider.start, value), end=max(slider.end, value))
            slider.value = self.typed[name].value = value

    def _wire(self) -> None:
        """Connect each slider and number field with the parameter that it changes."""
        for name in self.sliders:
            self.sliders[name].on_change("value", partial(self._set_parameter, name, False))
            self.typed[name].on_change("value", partial(self._set_parameter, name, True))

    def _set_parameter(self, name: str, rests: bool, attribute: str, old: Any, new: Any) -> None:
        """Change a fixed parameter to a new value from its slider or number field; the other arguments are Bokeh's.

        name    name of the parameter
        rests   False if the value is from a slider, which may still move
        new     the new value; None for an empty number field
        """
        plane = self._store.now.view.plane
        if new is None or float(new) == dict(plane.parameters)[name]:
            return
        try:
            self._store.choose(rests, plane=self.subject.plane_with(plane, name, float(new)))
        except InputError as error:
            self._store.set(trouble=str(error))
            self.typed[name].value = dict(plane.parameters)[name]

    def _axes(self, go: Callable[..., None]) -> list[Any]:
        """Return the menus that choose the axes, and the menu of the layers if the atlas is a stack of planes."""
        subject, third, menus = self.subject, self.subject.stack_axis, []
        system = subject.system
        options = [(p.name, f"{symbol_of(system, p.name)} {p.meaning.split(':')[0]}") for p in system.parameters]
        for k, title in enumerate(("across", "up")):
            select = Select(title=title, options=options, value=subject.axes[k], sizing_mode="stretch_width")
            select.on_change("value", lambda _, old, new, k=k: go(axes=_with(subject.axes, k, new)))
            menus.append(select)
        if third is not None:
            layers = [(repr(value), f"{value:g}") for value in third.values]
            select = Select(title=f"layer of the stack, {symbol_of(subject.system, third.name)}", options=layers,
                            value=repr(subject.layer_value), sizing_mode="stretch_width")  # fmt: skip
            select.on_change("value", lambda _, old, new: go(layer=float(new)))
            menus.append(select)
        return menus

    def _sliders(self, states: bool) -> list[Any]:
        """Return the sliders of the initial states if ``states``, else those of all other parameters."""
        names = [name for name in self.sliders if (name in self.subject.system.states) == states]
        widgets: list[Any] = []
        for name in names:
            parameter = self.subject.system.parameter(name)
            label = f"{parameter.meaning.split(':')[0]}, {mathtext_to_unicode(parameter.symbol or name)}"
            line = row(
                self.sliders[name],
                self.typed[name],
                sizing_mode="stretch_width",
                html_attributes=accessible_name(label),
            )
            widgets += [Div(text=html.escape(label), margin=(4, 5, -6, 5)), line]
        return widgets


def _with(axes: tuple[str, str], index: int, name: str) -> tuple[str, str]:
    """Return the names of the axes with ``name`` at ``index``; the axes are swapped if the other axis has that name."""
    other = axes[index] if axes[1 - index] == name else axes[1 - index]
    return (name, other) if index == 0 else (other, name)


def heading(text: str) -> Div:
    """Return ``text`` as the heading of a group of controls."""
    return Div(text=f"<h4>{text}</h4>", stylesheets=[TEXT], margin=(0, 5, 0, 5))


def _slider(subject: Subject, name: str, value: float) -> Slider:
    low, high = slider_range(subject.system.parameter(name), value)
    step = (high - low) / STEPS
    decimals = max(0, 2 - math.floor(math.log10(step * STEPS)))
    return Slider(
        title="",
        start=low,
        end=high,
        value=value,
        step=step,
        show_value=False,
        format="0[.]" + "0" * (decimals + 1),
        sizing_mode="stretch_width",
        bar_color="#6aa7d6",
        align="center",
        name=name,
    )
