"""The page for keyboards, fingers and screen readers: where the focus is, how large things are, and their names."""

from typing import Any

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import CustomJS
from bokeh.themes import Theme

from atlas.explore.style import FOCUS

NAME = """
const find = (node) => [...node.querySelectorAll("*")].flatMap(
    (each) => [each, ...(each.shadowRoot ? find(each.shadowRoot) : [])])
const above = (each) => each.parentNode instanceof ShadowRoot ? each.parentNode.host : each.parentElement
const used = "input, select, [role=slider], .bk-events, .bk-spin-btn"
const name = () => {
    for (const each of find(document).filter((each) => each.matches(used))) {
        if (each.ariaLabel || [...(each.labels ?? [])].some((label) => label.textContent.trim())) continue
        let from = each
        while (from && !from.ariaLabel) from = above(from)
        const step = {"bk-spin-btn-up": "more", "bk-spin-btn-down": "fewer"}[each.classList[1]]
        each.ariaLabel = step ?? from?.ariaLabel ?? (each.matches(".bk-events") ? "diagram" : "")
        if (each.matches(".bk-events")) each.role = "application"
    }
}
name()
setTimeout(name, 1000)
"""
"""What can be used takes its name from the nearest model around it that has one."""


PHONE = """
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">{% endblock %}
"""
"""Without it a phone lays the page out as wide as a desk's."""


def named(text: str) -> dict[str, Any]:
    """The attributes of a model whose parts are called this."""
    return {"role": "group", "aria-label": text}


def make_accessible(document: Document) -> None:
    """Show where the focus is in all widgets, and name what has no label of its own."""
    document.template = PHONE
    document.theme = Theme(json={"attrs": {"Widget": {"stylesheets": [FOCUS]}, "Toolbar": {"stylesheets": [FOCUS]}}})
    document.js_on_event(DocumentReady, CustomJS(code=NAME))
