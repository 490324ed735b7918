"""The controls of a page: what is shown, its scale, a slider for each parameter, files, a new atlas."""

import math
from dataclasses import dataclass, field
from typing import Any

from bokeh.models import (
    Button,
    CheckboxGroup,
    Div,
    NumericInput,
    Select,
    Slider,
    Spinner,
    Toggle,
)

from atlas.explore.chosen import Chosen, kinds, overlays, variables
from atlas.explore.style import TEXT
from atlas.explore.subject import Subject
from atlas.explore.words import symbol_of
from atlas.render import SCALAR
from workers.model.parameter import Parameter

STEPS = 200
"""Steps of a slider from end to end."""
CELLS = 400
"""Cells across a new atlas, unless asked otherwise."""


@dataclass
class Controls:
    """The widgets of a page; values are those that are chosen."""

    subject: Subject
    chosen: Chosen
    sliders: dict[str, Slider] = field(default_factory=dict)

    def __post_init__(self) -> None:
        chosen, scalar = self.chosen, self.chosen.kind == SCALAR
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self.kind = Select(title="map", options=kinds(self.subject), value=chosen.kind, **wide)
        self.variable = Select(
            title="variable",
            options=variables(self.subject),
            value=chosen.variable,
            visible=scalar,
            **wide,
        )
        self.log = CheckboxGroup(labels=["logarithmic"], active=[0] if chosen.log else [], visible=scalar, **wide)
        lines = overlays(self.subject)
        self.overlays = CheckboxGroup(labels=lines, active=[lines.index(name) for name in chosen.overlays], **wide)
        self.vmin = NumericInput(title="scale from", value=chosen.vmin, mode="float", placeholder="auto", **wide)
        self.vmax = NumericInput(title="to", value=chosen.vmax, mode="float", placeholder="auto", **wide)
        self.rescale = Button(label="fit the scale to the view", **wide)
        self.keep = Toggle(label="keep this plane too", visible=False, **wide)
        self.files = {suffix: Button(label=suffix.upper(), **wide) for suffix in ("png", "svg", "pdf")}
        self.cells = Spinner(title="cells across", low=2, high=100_000, step=50, value=CELLS, **wide)
        self.make = Button(label="make this an atlas", **wide)
        values = dict(chosen.plane.parameters)
        self.sliders = {name: _slider(self.subject, name, value) for name, value in values.items()}

    def sliders_of(self, states: bool) -> list[Slider]:
        """The sliders of initial states, or of all other parameters."""
        names = self.subject.system.states
        return [slider for name, slider in self.sliders.items() if (name in names) == states]

    def heading(self, text: str) -> Div:
        """A heading above some of them."""
        return Div(text=f"<h4>{text}</h4>", stylesheets=[TEXT], margin=(0, 5, 0, 5))

    def read(self) -> dict[str, Any]:
        """What the controls say, as fields of a choice."""
        return {
            "kind": self.kind.value,
            "variable": self.variable.value,
            "log": bool(self.log.active),
            "overlays": tuple(self.overlays.labels[i] for i in sorted(self.overlays.active)),
            "vmin": self.vmin.value,
            "vmax": self.vmax.value,
        }


def _slider(subject: Subject, name: str, value: float) -> Slider:
    parameter = subject.system.parameter(name)
    low, high = slider_range(parameter, value)
    step = (high - low) / STEPS
    decimals = max(0, 2 - math.floor(math.log10(step * STEPS)))
    return Slider(
        title=f"{parameter.meaning.split(':')[0]}, {symbol_of(subject.system, name)}",
        start=low,
        end=high,
        value=value,
        step=step,
        format="0[.]" + "0" * (decimals + 1),
        sizing_mode="stretch_width",
        bar_color="#6aa7d6",
        name=name,
    )


def slider_range(parameter: Parameter, value: float) -> tuple[float, float]:
    """Where a slider begins and ends: the valid range where it is finite, else some way around default and value.

    An end that the range leaves out is not reached.
    """
    reach = max(abs(value), abs(parameter.default), 0.5)
    low = parameter.low if math.isfinite(parameter.low) else min(value, parameter.default) - reach
    high = parameter.high if math.isfinite(parameter.high) else max(value, parameter.default) + reach
    inset = (high - low) / STEPS
    low += inset if parameter.low_open and low == parameter.low else 0.0
    high -= inset if parameter.high_open and high == parameter.high else 0.0
    return min(low, value), max(high, value)
