"""The legend of the curves over a map, whose entries switch them: each kind of curve that is in view or left out."""

from bokeh.models import CheckboxGroup

from atlas.explore.access import named
from atlas.explore.chosen import CHART, CURVES
from atlas.explore.state import State, Store
from atlas.explore.style import FOCUS
from atlas.render.kinds import CURVES as KINDS
from atlas.render.style import LOOKS

POINTS = "points of codimension two", "#ffffff"
SWATCH = """
label > span::before { content: ""; display: inline-block; width: 18px; margin-right: 6px; vertical-align: middle;
  border-top: 3px solid; outline: 1px solid #ccc; }
@media (prefers-color-scheme: dark) { label > span::before { filter: invert(1); } }
"""


class CurveList:
    """The entries, beside ``widget``'s boxes."""

    def __init__(self, store: Store) -> None:
        self._store, self._kinds = store, list[str]()
        self.widget = CheckboxGroup(
            visible=False, html_attributes=named("kinds of curves"), sizing_mode="stretch_width", margin=(0, 5, 5, 20)
        )
        self.widget.on_change("active", lambda _, old, new: self._switched(new))

    def show(self, state: State) -> None:
        """Have an entry for each kind of curve that a picture had, or would have: none goes while somebody zooms."""
        hidden = state.chosen.hidden
        kinds = [kind for kind in KINDS if kind in state.lines or kind in hidden or kind in self._kinds]
        if kinds != self._kinds:
            looks = [(LOOKS[kind].label, LOOKS[kind].color) if kind in LOOKS else POINTS for kind in kinds]
            colors = [f"label:nth-child({k + 1}) > span::before {{ color: {c}; }}" for k, (_, c) in enumerate(looks)]
            self._kinds = kinds
            self.widget.update(labels=[label for label, _ in looks], stylesheets=[FOCUS, SWATCH, *colors])
        self.widget.active = [k for k, kind in enumerate(kinds) if kind not in hidden]
        self.widget.visible = bool(kinds) and (CURVES in state.chosen.overlays or state.chosen.kind == CHART)

    def _switched(self, active: list[int]) -> None:
        hidden = tuple(kind for k, kind in enumerate(self._kinds) if k not in active)
        if hidden != self._store.now.chosen.hidden:
            self._store.choose(hidden=hidden)
