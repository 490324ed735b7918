"""The page for keyboards, fingers and screen readers: where the focus is, how large things are, and their names."""

from typing import Any

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.themes import Theme

from atlas.explore.front.script import call, page_script
from atlas.explore.style import FOCUS

HEAD = """
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">
<script>{{ page_script }}</script>{% endblock %}
"""
"""Without the first a phone lays the page out as wide as a desk's."""


def named(text: str) -> dict[str, Any]:
    """The attributes of a model whose parts are called this."""
    return {"role": "group", "aria-label": text}


def make_accessible(document: Document) -> None:
    """Show where the focus is in all widgets, and name what has no label of its own."""
    document.template = HEAD
    document.template_variables["page_script"] = page_script()
    document.theme = Theme(json={"attrs": {"Widget": {"stylesheets": [FOCUS]}, "Toolbar": {"stylesheets": [FOCUS]}}})
    document.js_on_event(DocumentReady, call("nameAll"))
