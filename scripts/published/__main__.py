"""Compute the gallery of published results: docs/published.json, and the page and its tables from it.

Usage: python -m scripts.published [NAME ...] [--list] [--picture FILE]

Without names all entries are computed. With names the other entries stay as they are, unless another version of the
solver computed them. The exit status is 0 whatever the verdicts are: a difference is a result.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scripts.published.entries import ENTRIES
from scripts.published.entry import EXACT
from scripts.published.page import agreement, page_of, table
from tests.support import ROOT
from workers import SOLVER_VERSION

DOCS = ROOT / "docs"
RESULTS, PAGE, TABLES = DOCS / "published.json", DOCS / "published.md", DOCS / "published"
BY_NAME = {entry.name: entry for entry in ENTRIES}


def run(names: Sequence[str]) -> dict[str, Any]:
    """Entries by their names, computed; prints a line for each."""
    found = {}
    for name in names:
        began = time.perf_counter()
        found[name] = BY_NAME[name].run()
        print(f"{name}: {agreement(found[name])} agree ({time.perf_counter() - began:.1f} s)", flush=True)
        for statement in found[name]["statements"]:
            if not statement["agrees"]:
                print(
                    f"    {statement['text']}: reference {statement['reference']}, ours {statement['ours']}", flush=True
                )
    return found


def kept() -> dict[str, Any]:
    """The entries of docs/published.json by their names; none if the file is another solver's."""
    if not RESULTS.exists():
        return {}
    results = json.loads(RESULTS.read_text())
    return {entry["name"]: entry for entry in results["entries"]} if results["solver_version"] == SOLVER_VERSION else {}


def write(found: dict[str, Any]) -> None:
    """The results, with the entries in their order, the page, and a table for each entry."""
    ordered = [found[name] for name in BY_NAME if name in found]
    results = {"solver_version": SOLVER_VERSION, "exact": EXACT, "entries": ordered}
    RESULTS.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n")
    PAGE.write_text(page_of(results))
    TABLES.mkdir(exist_ok=True)
    for entry in ordered:
        (TABLES / f"{entry['name']}.csv").write_text(table(entry["statements"]))


def main() -> None:
    """Compute, list or draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="*", help="an entry; default: all")
    parser.add_argument("--list", action="store_true", help="print the names and titles, and compute nothing")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the picture of one entry, and nothing else")
    given = parser.parse_args()
    unknown = sorted(set(given.name) - set(BY_NAME))
    if unknown:
        parser.error(f"no such entry: {', '.join(unknown)}; possible: {', '.join(BY_NAME)}")
    if given.list:
        print(*(f"{entry.name}: {entry.title}" for entry in ENTRIES), sep="\n")
    elif given.picture is not None:
        drawing = BY_NAME[given.name[0]].picture if len(given.name) == 1 else None
        if drawing is None:
            able = [entry.name for entry in ENTRIES if entry.picture]
            parser.error(f"--picture goes with one of these entries: {', '.join(able)}")
        drawing(given.picture)
    else:
        write(kept() | run(given.name or list(BY_NAME)))


if __name__ == "__main__":
    main()
