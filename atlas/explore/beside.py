"""The second plane beside the first: what it shows of whom, and the controls that choose it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from bokeh.layouts import column
from bokeh.models import Button, NumericInput, Select

from atlas.errors import InputError
from atlas.explore.chosen import ATLAS, DIFFERENCE, PLANE, Beside, Chosen, kinds, overlays
from atlas.explore.controls import heading
from atlas.explore.explorer import Explorer
from atlas.explore.state import State, Store
from atlas.explore.subject import Plane, Subject
from atlas.explore.words import name_of, symbol_of
from atlas.render import SCALAR, has_scale
from workers.model.parameter import Parameter

SAME = ""
"""What is drawn where the second plane shows the same picture as the first."""


def second(home: Explorer, explorer: Explorer, state: State) -> tuple[Explorer, Chosen]:
    """The explorer and the choice of the second plane that a state has beside the first.

    InputError for a plane or a picture that there is not.
    """
    chosen, beside = state.chosen, state.chosen.beside
    assert beside is not None
    there, plane = _plane(home, explorer, chosen, beside)
    shown = replace(
        chosen, plane=plane, beside=None, overlays=tuple(n for n in chosen.overlays if n in overlays(there.subject))
    )
    if beside.drawn == DIFFERENCE:
        return there, replace(shown, less=chosen.plane, overlays=(), vmin=None, vmax=None)
    kind, _, variable = beside.drawn.partition(":")
    if beside.drawn != SAME:
        shown = replace(shown, kind=kind, variable=variable or shown.variable, log=False, vmin=None, vmax=None)
    elif has_scale(chosen.kind):
        shown = replace(shown, vmin=state.ends[0], vmax=state.ends[1])  # one scale for both
    if shown.kind not in kinds(there.subject) or (variable and variable not in there.subject.numbers):
        raise InputError(f"second.drawn: {there.subject.name} has no {variable or shown.kind!r}")
    return there, shown


def _plane(home: Explorer, explorer: Explorer, chosen: Chosen, beside: Beside) -> tuple[Explorer, Plane]:
    """Whose plane the second one is, and which."""
    subject, values = explorer.subject, dict(chosen.plane.parameters)
    if beside.of == PLANE:
        return explorer, chosen.plane
    if beside.of == ATLAS:
        if home.other is None:
            raise InputError("second.of: there is no second atlas; name it by --with")
        own, third = home.other.subject, home.other.subject.third
        layer = values.get(third.name) if third is not None else None
        found = home.other.turned(subject.axes, layer if third is not None and layer in third.values else None)
        # What was an axis of both lies where it lies in the first; other parameters are the atlas's own.
        there = found.subject.plane.parameters
        return found, Plane(tuple((n, values.get(n, value) if n in own.axes else value) for n, value in there))
    if beside.value is None:
        raise InputError(f"second.of: found {beside.of!r}, must be {PLANE}, {ATLAS} or PARAMETER,VALUE")
    plane = subject.moved(chosen.plane, beside.of, beside.value)
    third = subject.third
    if third is not None and beside.of == third.name and beside.value in third.values:
        return home.turned(subject.axes, beside.value), plane
    return explorer, plane


def nearby(parameter: Parameter, value: float) -> float:
    """A value a tenth below this one, or above it, that the parameter admits; this one where it admits neither."""
    tried = (float(f"{share * value:.4g}") for share in (0.9, 1.1)) if value else (0.1, -0.1)
    return next((each for each in tried if parameter.admits(each)), value)


class BesidePanel:
    """The controls of the second plane."""

    def __init__(self, home: Explorer, subject: Subject, store: Store) -> None:
        self._subject, self._store = subject, store
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        states, third = subject.system.states, "" if subject.third is None else subject.third.name
        names = sorted(dict(subject.plane.parameters), key=lambda name: (name != third, name in states))
        other = [] if home.other is None else [(ATLAS, f"the atlas {home.other.subject.name}")]
        of = [*other, *((name, f"another {symbol_of(subject.system, name)}") for name in names), (PLANE, "this plane")]
        drawn = {
            "compared": [(SAME, "the same map"), (DIFFERENCE, "the difference")],
            "maps": [(kind, kind) for kind in kinds(subject) if kind != SCALAR],
            "variables": [(f"{SCALAR}:{name}", name_of(name)) for name in subject.numbers],
        }
        self._open = Button(label="compare", **wide)
        self._of = Select(title="the second plane shows", options=of, **wide)
        self._value = NumericInput(title="with the value", mode="float", format="0[.]00000", **wide)
        self._drawn = Select(title="drawn as", options=drawn, **wide)
        close = Button(label="close the second plane", **wide)
        self._chosen = column(self._of, self._value, self._drawn, close, **wide)
        self.panel = column(heading("a second plane"), self._open, self._chosen, **wide)
        self._open.on_click(lambda: self._choose(of=of[0][0]))
        close.on_click(lambda: store.choose(beside=None))
        for widget, name in ((self._of, "of"), (self._value, "value"), (self._drawn, "drawn")):
            widget.on_change("value", self._heard(name))
        self.show(store.now.chosen)

    def show(self, chosen: Chosen) -> None:
        """Have the widgets show what is chosen."""
        beside = chosen.beside
        self._open.visible, self._chosen.visible = beside is None, beside is not None
        if beside is not None:
            self._value.visible = beside.value is not None
            self._of.value, self._value.value, self._drawn.value = beside.of, beside.value, beside.drawn

    def _heard(self, name: str) -> Callable[[str, Any, Any], None]:
        def hear(attribute: str, old: Any, new: Any) -> None:
            beside = self._store.now.chosen.beside
            if beside is not None and new is not None and new != getattr(beside, name):
                self._choose(**{name: new})

        return hear

    def _choose(self, **fields: Any) -> None:
        """Choose another second plane; of another parameter at first another layer of the stack, or a value nearby."""
        chosen = self._store.now.chosen
        beside = replace(chosen.beside or Beside(PLANE), **fields)
        if "of" in fields:
            third, value = self._subject.third, dict(chosen.plane.parameters).get(beside.of)
            if third is not None and third.name == beside.of:
                value = next((each for each in third.values if each != value), value)
            elif value is not None:
                value = nearby(self._subject.system.parameter(beside.of), value)
            beside = replace(beside, value=value)
        try:
            if beside.value is not None:
                self._subject.moved(chosen.plane, beside.of, beside.value)
        except InputError as error:
            self._store.set(trouble=str(error))
            self.show(chosen)
            return
        self._store.choose(beside=beside)
