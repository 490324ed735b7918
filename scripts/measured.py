"""The tables of measurements on the pages: each is a file, which the script that measured it writes.

Usage: python -m scripts.measured [--check] [--docs FOLDER]

Every script that measures takes ``--keep``. It then writes its table to docs/measured/NAME.json, with its command and
the solver version. The page that shows it has the link ``[Table](measured/NAME.csv)``, which the site replaces by the
table; below stands the command. This program writes these files and lines anew from all kept tables. With ``--check``
it changes nothing, prints the faults of tables and pages, and exits with 1 if there are any.
"""

import argparse
import csv
import io
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
LINK = re.compile(r"(?<=\[Table\]\(measured/)([\w-]+)(\.csv\)\n\n)\*`.*?\*$", re.MULTILINE)
"""The name of a table that a page links to, and all up to the end of the line of its command."""


def shown(cells: Iterable[object]) -> list[str]:
    """The texts of a row; whole numbers from 10,000 on have their thousands apart."""
    return [re.sub(r"^\d{5,}$", lambda number: f"{int(number[0]):,}", str(cell)) for cell in cells]


def line(cells: Iterable[object]) -> str:
    """One row of a Markdown table."""
    return f"| {' | '.join(shown(cells))} |"


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
    """Write a table of this process to its data file, and for its page."""
    words = [word for word in sys.argv[1:] if word != "--keep"]
    path = Path(sys.argv[0])
    script = path.parent.name if path.stem == "__main__" else path.stem
    command = shlex.join(["python", "-m", f"scripts.{script}", *words])
    kept = {"command": command, "solver_version": SOLVER_VERSION, "head": list(head), "rows": [list(r) for r in rows]}
    (DOCS / "measured" / f"{name}.json").write_text(
        json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    fill_pages(DOCS)


def source(kept: dict[str, Any]) -> str:
    """The line below a kept table: its command and the solver version."""
    return f"*`{kept['command']}`, solver version {kept['solver_version']}*"


def as_csv(kept: dict[str, Any]) -> str:
    """A kept table as the file that its page links to."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([kept["head"], *map(shown, kept["rows"])])
    return text.getvalue()


def tables(docs: Path) -> dict[str, dict[str, Any]]:
    """The kept tables of a folder of pages, by their names."""
    return {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted((docs / "measured").glob("*.json"))
    }


def filled(page: str, kept: Mapping[str, dict[str, Any]]) -> str:
    """The text of a page with the line of its command below each kept table; other links stay as they are."""
    return LINK.sub(
        lambda match: f"{match[1]}{match[2]}{source(kept[match[1]])}" if match[1] in kept else match[0], page
    )


def fill_pages(docs: Path) -> None:
    """Write the files that pages link to, and the lines of their commands."""
    kept = tables(docs)
    for page in docs.glob("*.md"):
        text = filled(page.read_text(encoding="utf-8"), kept)
        page.write_text(text, encoding="utf-8")
        for name in (match[1] for match in LINK.finditer(text) if match[1] in kept):
            (docs / "measured" / f"{name}.csv").write_text(as_csv(kept[name]), encoding="utf-8")


def faults(docs: Path) -> list[str]:
    """What is wrong with the kept tables and the pages that show them, a line each."""
    kept, places, found = tables(docs), Counter[str](), []
    for page in sorted(docs.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        linked = [match[1] for match in LINK.finditer(text)]
        found += [f"{page.name}: no table {name}" for name in linked if name not in kept]
        files = {docs / "measured" / f"{name}.csv": as_csv(kept[name]) for name in linked if name in kept}
        differ = [file for file, table in files.items() if not file.exists() or file.read_text("utf-8") != table]
        if differ or text != filled(text, kept):
            found.append(f"{page.name}: tables differ from those measured; run python -m scripts.measured")
        places.update(linked)
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
    """Write all kept tables for their pages, or check them; 1 if something is wrong."""
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
