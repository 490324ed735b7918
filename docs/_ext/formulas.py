"""Formulas as drawings in the page itself: it takes no script, no font and no LaTeX, here or where it is read.

ziamath draws them with the outlines of a font of its own. A browser that draws MathML itself takes what font for
formulas the reader's machine has, and without one draws matrices wrong; MathJax would add megabytes of scripts.
"""

import html
import re
from typing import Any

import ziamath
from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.writers.html5 import HTML5Translator

SIZE = 16.0
"""Pixels of the type they are drawn for; lengths are written as multiples of it, so that they grow with the text."""
SCALE = 1.08
"""The font's letters are smaller than those of the text."""


def drawn(node: nodes.Element, inline: bool) -> str:
    """The SVG of a formula, with its source for those who cannot see it; the build ends where LaTeX is misspelt."""
    source = " ".join(node.astext().split())
    unknown = re.findall(r"<mi>(\\\w+)</mi>", convert(source))
    if unknown:
        raise ExtensionError(f"{node.source}: {source}: unknown {', '.join(unknown)}")
    formula = ziamath.Latex(source, size=SIZE * SCALE, color="currentColor", inline=inline)
    picture = re.sub(
        r'^<svg ([^>]*?)width="([\d.]+)" height="([\d.]+)"',
        lambda found: f'<svg {found[1]}width="{em(found[2])}" height="{em(found[3])}"',
        formula.svg(),
    )
    label = f'role="img" aria-label="{html.escape(source)}" style="vertical-align: {em(formula.getyofst())}"'
    return picture.replace("<svg ", f"<svg {label} ", 1)


def em(pixels: float | str) -> str:
    """A length in the size of the text."""
    return f"{float(pixels) / SIZE:.3f}em"


def in_text(writer: HTML5Translator, node: nodes.math) -> None:
    """A formula in a line."""
    writer.body.append(f'<span class="formula">{drawn(node, inline=True)}</span>')
    raise nodes.SkipNode


def displayed(writer: HTML5Translator, node: nodes.math_block) -> None:
    """A formula on a line of its own."""
    writer.body.append(f'<div class="formula">{drawn(node, inline=False)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Make it the renderer ``drawn``."""
    ziamath.config.svg2 = False  # outlines in place, so that no two formulas of a page share an id
    ziamath.config.precision = 2
    app.add_html_math_renderer("drawn", (in_text, None), (displayed, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
