"""Cells as a reader copies them: without the magic of their first line, a file under its name."""

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

FILE, SHELL = "%%writefile ", "%%sh"
"""How cells begin that write a file and that run commands."""


def shown(app: Sphinx, doctree: nodes.document) -> None:
    """Give each such cell its text without the magic, and a file its name as a caption."""
    for block in list(doctree.findall(nodes.literal_block)):
        magic, _, text = block.astext().partition("\n")
        if not magic.startswith((FILE, SHELL)):
            continue
        language = magic.rpartition(".")[2].strip() if magic.startswith(FILE) else "sh"
        plain = nodes.literal_block(text, text, language=language, classes=block["classes"])
        if magic.startswith(FILE):
            name = magic.removeprefix(FILE).strip()
            named = nodes.container("", literal_block=True, classes=["literal-block-wrapper"])
            named += [nodes.caption(name, name), plain]
            doctree.set_id(named)
            block.replace_self(named)
        else:
            block.replace_self(plain)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register it."""
    app.connect("doctree-read", shown)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
