"""Docstrings as they are written here, for autodoc: their aligned lists of names and meanings become definitions."""

import re
from itertools import groupby
from typing import Any

from sphinx.application import Sphinx

_ROW = re.compile(r"(\S+(?: \([^)]*\))?) {2,}(\S.*)")


def with_definitions(lines: list[str]) -> list[str]:
    """The lines, with each paragraph of names, blanks and meanings as a definition list.

    >>> with_definitions(["Two numbers.", "", "a      the first", "longer  the second,", "        which is long"])
    ['Two numbers.', '', '``a``', '    the first', '``longer``', '    the second,', '    which is long']
    """
    found: list[str] = []
    for blank, group in groupby(lines, key=lambda line: not line.strip()):
        paragraph = [*group]
        rows = [_ROW.fullmatch(line) for line in paragraph]
        if blank or not (rows[0] and all(row or line[0] == " " for row, line in zip(rows, paragraph, strict=True))):
            found += paragraph
            continue
        for row, line in zip(rows, paragraph, strict=True):
            found += [f"``{row[1]}``", f"    {row[2]}"] if row else [f"    {line.strip()}"]
    return found


def process(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """What autodoc calls with the lines of each docstring."""
    lines[:] = with_definitions(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    """Have autodoc call it."""
    app.connect("autodoc-process-docstring", process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
