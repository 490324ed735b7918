"""Formulas as MathML, which browsers draw themselves: no script and no font goes with the site.

The conversion is that of docutils; a command of LaTeX that it does not know is an error of the build.
"""

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.writers.html5 import HTML5Translator


def converted(node: nodes.Element, as_block: bool) -> str:
    """The MathML of a formula; the build ends where it has none."""
    source = " ".join(node.astext().split())
    try:
        return tex2mathml(source, as_block=as_block)
    except MathError as error:
        raise ExtensionError(f"{node.source or ''}: {source}: {error}") from None


def inline(writer: HTML5Translator, node: nodes.math) -> None:
    """A formula in the text."""
    writer.body.append(f'<span class="math">{converted(node, as_block=False)}</span>')
    raise nodes.SkipNode


def displayed(writer: HTML5Translator, node: nodes.math_block) -> None:
    """A formula on a line of its own, with its number where it has a label."""
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    anchor = f' id="{node["ids"][0]}"' if node["ids"] else ""
    writer.body.append(f'<div class="math"{anchor}>{converted(node, as_block=True)}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Make it the renderer ``mathml``."""
    app.add_html_math_renderer("mathml", (inline, None), (displayed, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
