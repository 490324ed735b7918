"""The page for keyboards, fingers and screen readers: where the focus is, how large things are, their names, the keys.

Arrows move the view, + and - zoom it, Enter on the plane chooses the cell in its middle, Esc ends a followed orbit, the
cut or an enlarged picture; two fingers zoom.
"""

from collections.abc import Callable
from typing import Any

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure
from bokeh.themes import Theme

from atlas.explore.front.script import call, page_script
from atlas.explore.style import FOCUS

HEAD = """
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">
<script>{{ page_script }}</script>{% endblock %}
"""
"""Without the first a phone lays the page out as wide as a desk's."""


def accessible_name(text: str) -> dict[str, Any]:
    """The attributes of a model whose parts are called this."""
    return {"role": "group", "aria-label": text}


def make_accessible(document: Document) -> None:
    """Show where the focus is in all widgets, and name what has no label of its own."""
    document.template = HEAD
    document.template_variables["page_script"] = page_script()
    document.theme = Theme(json={"attrs": {"Widget": {"stylesheets": [FOCUS]}, "Toolbar": {"stylesheets": [FOCUS]}}})
    document.js_on_event(DocumentReady, call("nameAll"))


def install_key_handler(
    document: Document,
    plot: figure,
    show_window: Callable[[tuple[float, float], tuple[float, float]], None],
    escape: Callable[[], None],
    choose: Callable[[float, float], None],
) -> ColumnDataSource:
    """Have the keys of a page heard; the source returned has to be sent along with the page."""
    heard = ColumnDataSource({"x": [], "y": []})

    def hear(attribute: str, old: object, new: dict[str, list[float]]) -> None:
        if "escape" in new:
            escape()
        elif "cell" in new:
            choose(*new["cell"][:2])
        else:
            (left, right), (low, high) = new["x"], new["y"]
            show_window((float(left), float(right)), (float(low), float(high)))

    heard.on_change("data", hear)
    document.js_on_event(DocumentReady, call("hearKeys", heard=heard, plot=plot))
    return heard
