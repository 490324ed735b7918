"""The tables of measurements on the pages: each is a data file, which the script that measured it writes.

Usage: python -m scripts.measured

Every script that measures takes ``--keep``. It then writes its table to docs/measured/NAME.json, with its command and
the solver version, and sets it into the page that shows it, between the comments ``<!-- measured: NAME -->`` and
``<!-- end -->``. This command sets all kept tables into their pages anew; a test compares them.
"""

import argparse
import json
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from workers import SOLVER_VERSION

DOCS = Path(__file__).resolve().parents[1] / "docs"
FOLDER = DOCS / "measured"
PLACE = re.compile(r"(?<=<!-- measured: )([\w-]+)( -->\n).*?(?=<!-- end -->)", re.DOTALL)
"""The place of a table on a page: its name, and all up to its end."""


def line(cells: Iterable[object]) -> str:
    """One row of a Markdown table; whole numbers from 10,000 on have their thousands apart."""
    shown = [re.sub(r"^\d{5,}$", lambda number: f"{int(number[0]):,}", str(cell)) for cell in cells]
    return f"| {' | '.join(shown)} |"


def header(head: Sequence[str]) -> str:
    """The first two lines of a Markdown table."""
    return f"{line(head)}\n{'|---' * len(head)}|"


def parsed(parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of a script that measures, with ``--keep``, which rough numbers do not go with."""
    parser.add_argument("--keep", action="store_true", help="set the table into its page in docs/")
    options = parser.parse_args(arguments)
    if options.keep and getattr(options, "light", False):
        parser.error("--keep: found --light; rough numbers are not kept")
    return options


def print_table(name: str, head: Sequence[str], rows: Sequence[Sequence[str]], keep: bool) -> None:
    """Print a table, and keep it if asked."""
    print(header(head), *map(line, rows), sep="\n", flush=True)
    if keep:
        keep_table(name, head, rows)


def keep_table(name: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a table of this process to its data file, and set it into its page."""
    words = [word for word in sys.argv[1:] if word != "--keep"]
    command = shlex.join(["python", "-m", f"scripts.{Path(sys.argv[0]).stem}", *words])
    kept = {"command": command, "solver_version": SOLVER_VERSION, "head": list(head), "rows": [list(r) for r in rows]}
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    for page in pages():
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


def read_table(name: str) -> dict[str, Any]:
    """A kept table."""
    found: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return found


def as_text(kept: dict[str, Any]) -> str:
    """A kept table as its page shows it: the table, its command and the solver version."""
    source = f"*`{kept['command']}`, solver version {kept['solver_version']}*"
    return "\n".join([header(kept["head"]), *map(line, kept["rows"]), "", source])


def pages() -> list[Path]:
    """The pages that may show tables."""
    return sorted(DOCS.glob("*.md"))


def names_on(page: str) -> list[str]:
    """The names of the tables that the text of a page has places for."""
    return [match[1] for match in PLACE.finditer(page)]


def filled(page: str) -> str:
    """The text of a page with its kept tables in their places."""
    return PLACE.sub(lambda match: f"{match[1]}{match[2]}\n{as_text(read_table(match[1]))}\n\n", page)


def main() -> None:
    """Set all kept tables into their pages."""
    argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0]).parse_args()
    for page in pages():
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
