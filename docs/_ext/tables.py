"""Tables of CSV files in place of ``[Table](FILE.csv)``: a link on a line of its own, for readers of the source."""

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PLACE = re.compile(r"^\[Table\]\(([\w/-]+\.csv)\)$", re.MULTILINE)


def fill(app: "Sphinx", name: str, source: list[str]) -> None:
    """What Sphinx calls with the text of each page before it is parsed."""
    source[0] = PLACE.sub(r"```{csv-table}\n:file: \1\n:header-rows: 1\n```", source[0])


def setup(app: "Sphinx") -> dict[str, Any]:
    """Have Sphinx call it."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
