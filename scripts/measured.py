"""The tables of measurements on the pages: each is a data file, which the script that measured it writes.

Usage: python -m scripts.measured [--check] [--docs FOLDER]

Every script that measures takes ``--keep``. It then writes its table to docs/measured/NAME.json, with its command and
the solver version, and sets it into the page that shows it, between the comments ``<!-- measured: NAME -->`` and
``<!-- end -->``. This command sets all kept tables into their pages anew. With ``--check`` it changes nothing,
prints the faults of tables and pages, and exits with 1 if there are any.
"""

import argparse
import json
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.support import ROOT
from workers import SOLVER_VERSION

DOCS = ROOT / "docs"
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
    path = Path(sys.argv[0])
    script = path.parent.name if path.stem == "__main__" else path.stem
    command = shlex.join(["python", "-m", f"scripts.{script}", *words])
    kept = {"command": command, "solver_version": SOLVER_VERSION, "head": list(head), "rows": [list(r) for r in rows]}
    (DOCS / "measured" / f"{name}.json").write_text(
        json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    fill_pages(DOCS)


def as_text(kept: dict[str, Any]) -> str:
    """A kept table as its page shows it: the table, its command and the solver version."""
    source = f"*`{kept['command']}`, solver version {kept['solver_version']}*"
    return "\n".join([header(kept["head"]), *map(line, kept["rows"]), "", source])


def tables(docs: Path) -> dict[str, dict[str, Any]]:
    """The kept tables of a folder of pages, by their names."""
    return {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted((docs / "measured").glob("*.json"))
    }


def filled(page: str, kept: Mapping[str, dict[str, Any]]) -> str:
    """The text of a page with the kept tables in their places; a place without a table stays as it is."""
    return PLACE.sub(
        lambda match: f"{match[1]}{match[2]}\n{as_text(kept[match[1]])}\n\n" if match[1] in kept else match[0], page
    )


def fill_pages(docs: Path) -> None:
    """Set all kept tables into their pages."""
    for page in docs.glob("*.md"):
        page.write_text(filled(page.read_text(encoding="utf-8"), tables(docs)), encoding="utf-8")


def faults(docs: Path) -> list[str]:
    """What is wrong with the kept tables and the pages that show them, a line each."""
    kept, places, found = tables(docs), Counter[str](), []
    for page in sorted(docs.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        here = [match[1] for match in PLACE.finditer(text)]
        found += [f"{page.name}: no table {name}" for name in here if name not in kept]
        if text != filled(text, kept):
            found.append(f"{page.name}: tables differ from those measured; run python -m scripts.measured")
        places.update(here)
    for name, table in kept.items():
        words = shlex.split(table["command"])
        path = ROOT / words[2].replace(".", "/")
        script = next((file for file in (path.with_suffix(".py"), path / "__main__.py") if file.exists()), None)
        if script is None or f'"{name}"' not in script.read_text(encoding="utf-8"):
            found.append(f"{name}: {words[2]} does not write it")
        if {len(row) for row in table["rows"]} != {len(table["head"])}:
            found.append(f"{name}: rows and head differ in length")
        if places[name] != 1:
            found.append(f"{name}: shown {places[name]} times, must be shown once")
    return found


def main() -> int:
    """Set all kept tables into their pages, or check them; 1 if something is wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--check", action="store_true", help="change nothing, print faults")
    parser.add_argument("--docs", type=Path, default=DOCS, metavar="FOLDER", help="the pages; default: docs/")
    given = parser.parse_args()
    if not given.check:
        fill_pages(given.docs)
        return 0
    found = faults(given.docs)
    print(*found, sep="\n", end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
