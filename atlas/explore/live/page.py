"""The HTML of the explorer's live page, with all that its script must know of the subject."""

import html
import json
import math
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from atlas.explore.compose import dataset
from atlas.explore.cut import to_observe
from atlas.explore.front.script import program, shared_css
from atlas.explore.static.about import meanings, variable
from atlas.explore.subject import STEPS, Subject, slider_range
from atlas.explore.text import axis_label, meaning_of, symbol_of
from atlas.explore.view_state import (
    ViewState,
    base_query,
    followable,
    initial_view,
    kinds,
    overlays,
    style_query,
)
from atlas.formatting import mathtext_to_unicode
from atlas.render import SCALAR
from atlas.render.kinds import NUMBER
from workers.model.parameter import Parameter
from workers.results import REASON, REGIME

PROGRAM = ("state.mjs", "link.mjs", "diagram.mjs", "controls.mjs", "cell.mjs", "cut.mjs", "live.mjs")
"""JavaScript modules of the live page only, each after the modules that it imports."""
CELLS = 400
"""Default number of cells across a new atlas."""


def page_of(home: Subject, subject: Subject, view: ViewState, trouble: str = "") -> str:
    """Return the live page as HTML; arguments are those of ``described``."""
    parts = {name: files(__package__).joinpath(name).read_text("utf-8") for name in ("live.html", "live.css")}
    content = json.dumps(described(home, subject, view, trouble), allow_nan=False, ensure_ascii=False)
    return Template(parts["live.html"]).substitute(
        title=html.escape(subject.name),
        style=shared_css() + parts["live.css"],
        program=program(__package__, *PROGRAM),
        subject=content.replace("<", "\\u003c"),
    )


def described(home: Subject, subject: Subject, view: ViewState, trouble: str = "") -> dict[str, Any]:
    """Return what the page's script must know of the subject, as plain JSON: axes, parameters, maps and menus.

    home      subject of the address without a query
    subject   the subject that is explored
    view      the view state at first
    trouble   why the page does not show what its address asks for; empty if it does
    """
    points = [np.array(lattice.axis.values[:2]) for lattice in (subject.x, subject.y)]
    names = [REGIME.name, REASON.name, *subject.numbers]
    ds = dataset(subject, subject.plane, points[0], points[1], subject.without_results(names, (2, 2)))
    variables = {name: variable(ds, name) for name in names}
    maps = [(kind, kind) for kind in kinds(subject) if kind != SCALAR]
    system, initial = subject.system, initial_view(subject)
    coordinates = [mathtext_to_unicode(system.parameter(n).symbol or n) for n in system.definition.coordinates]
    return meanings() | {
        "name": subject.name,
        "trouble": trouble,
        "names": subject.axes,
        "axes": [_axis(subject, lattice.axis.name, lattice.log) for lattice in (subject.x, subject.y)],
        "whole": (initial.x, initial.y),
        "plane": dict(subject.plane.parameters),
        "parameters": [_parameter(subject, name, value) for name, value in view.plane.parameters],
        "options": [_option(p) for p in system.parameters],
        "layers": _layers(subject),
        "follow": [_option(system.parameter(name)) for name in followable(subject)],
        "shows": [*to_observe(subject)],
        "lanes": [name.removesuffix("(0)") for name in coordinates],
        "variables": variables,
        "maps": maps + [(f"{NUMBER}{name}", variables[name]["label"]) for name in subject.numbers],
        "overlays": overlays(subject),
        "cells": CELLS,
        "address": base_query(home, subject),
        "view": _view(view),
        "look": style_query(view),
    }


def _view(view: ViewState) -> dict[str, Any]:
    cell = view.cell and {"at": view.cell[1:], "parameters": dict(view.cell[0].parameters)}
    follow = view.follow and view.follow.text
    return {
        "x": view.x, "y": view.y, "parameters": dict(view.plane.parameters),
        "cell": cell, "cut": view.cut, "follow": follow,
    }  # fmt: skip


def _axis(subject: Subject, name: str, log: bool) -> dict[str, Any]:
    system = subject.system
    return {"name": name, "symbol": symbol_of(system, name), "label": axis_label(system, name), "log": log}


def _parameter(subject: Subject, name: str, value: float) -> dict[str, Any]:
    parameter, symbol = subject.system.parameter(name), symbol_of(subject.system, name)
    low, high = slider_range(parameter, value)
    step = float(f"{(high - low) / STEPS:.3g}")
    return {
        "name": name, "symbol": symbol, "label": f"{meaning_of(parameter)}, {symbol}", "low": low, "high": high,
        "step": step if math.isfinite(step) and step > 0 else 1.0, "initial": name in subject.system.states,
    }  # fmt: skip


def _option(parameter: Parameter) -> tuple[str, str]:
    return parameter.name, f"{mathtext_to_unicode(parameter.symbol or parameter.name)} {meaning_of(parameter)}"


def _layers(subject: Subject) -> dict[str, Any] | None:
    stack = subject.stack_axis
    if stack is None:
        return None
    label = f"layer of the stack, {symbol_of(subject.system, stack.name)}"
    return {"label": label, "values": list(map(repr, stack.values)), "value": repr(subject.layer_value)}
