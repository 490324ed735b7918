"""docs/published.md and the tables in docs/published/, made only from the JSON of a run."""

import csv
import io
import re
from collections.abc import Mapping
from itertools import groupby
from textwrap import fill
from typing import Any

Record = Mapping[str, Any]
HELD = "\0"
"""In place of a blank without a line break."""

HEAD = (
    "Does impact-atlas reproduce what the field has published? It agrees with {agree} of {statements} numbers and"
    " findings of {works} works (solver version {solver}):",
)

BASIS = (
    "Each entry unfolds into its commands, table and picture. A *closed form* follows from the equations that the work"
    " solves. `scripts/published/entries/` derives it anew, in symbols of its own. `tests/project/test_published.py`"
    " checks it by integrations and maps that share no code with the solver. Differences of at most {exact:g} from a"
    " closed form count as agreement. In a checkout `python -m scripts.published` computes all entries again, or the"
    " named ones.",
    "Left out are works whose numbers or parameters could not be confirmed (C. Weidemann et al. 2025, doi"
    " 10.1007/s11071-025-10928-4; J. F. Mason and P. T. Piiroinen, SIAM J. Appl. Dyn. Syst. 8 (2009) 1694; C. Budd and"
    " F. Dux, Phil. Trans. R. Soc. A 347 (1994) 365), and pictures without digits (S. L. T. de Souza et al., Math."
    " Probl. Eng. (2009) 290356). The belt of bSTAB is compared [elsewhere](systems.md#machines-without-a-force).",
)


def page_of(results: Record) -> str:
    """The page, as text."""
    entries = results["entries"]
    found = [statement["agrees"] for entry in entries for statement in entry["statements"]]
    facts = {
        "agree": sum(found), "statements": len(found), "works": len({entry["work"] for entry in entries}),
        "solver": results["solver_version"], "exact": results["exact"],
    }  # fmt: skip
    head, basis = ("".join(wrapped(text.format(**facts)) + "\n\n" for text in part) for part in (HEAD, BASIS))
    parts = ["# Published results\n\n", head, summary(entries), "\n", basis]
    return "".join(parts) + "\n".join(section(entry) for entry in entries)


def summary(entries: list[Record]) -> str:
    """The table of all works, one per line, with their entries."""
    rows = ["| work | agree |", "|---|---|"]
    for work, group in groupby(entries, key=lambda entry: entry["work"]):
        found, link = [], ""
        for entry in group:
            anchor = re.sub(r"[^\w\- ]", "", entry["title"].lower()).replace(" ", "-")
            agrees = all(statement["agrees"] for statement in entry["statements"])
            count = agreement(entry) if agrees else f"**{agreement(entry)}**"
            found.append(f"[{entry['title']}](#{anchor}): {count}")
            link = entry["link"]
        rows.append(f"| {f'[{work}]({link})' if link else work} | {'; '.join(found)} |")
    return "\n".join(rows) + "\n"


def agreement(entry: Record) -> str:
    """Number of agreeing statements of an entry, of all."""
    return f"{sum(statement['agrees'] for statement in entry['statements'])} of {len(entry['statements'])}"


def section(entry: Record) -> str:
    """One entry: its name, result and machine; folded, its commands, table, picture and reasons."""
    name = entry["name"]
    words = [f"`{name}`: {entry['place']}.", entry["machine"]]
    if entry["example"]:
        words.append(f"Spec: `atlas example {entry['example']}`.")
    parts = [f"## {entry['title']}", wrapped(" ".join(words))]
    parts.append("<details>\n<summary>Details</summary>")
    if entry["commands"]:
        parts.append("```sh\n" + "\n".join(entry["commands"]) + "\n```")
    parts.append(f"[Table](published/{name}.csv)")
    if entry["caption"]:
        picture = f"published-{name}.png"
        parts += [f"![{entry['title']}]({picture})"]
        parts += [wrapped(f"*{entry['caption']}* `python -m scripts.published {name} --picture {picture}`")]
    reasons = dict.fromkeys(statement["reason"] for statement in entry["statements"] if not statement["agrees"])
    parts += [wrapped(f"Why it differs: {reason or 'not known.'}") for reason in reasons]
    return "\n\n".join([*parts, "</details>"]) + "\n"


def table(statements: list[Record]) -> str:
    """The statements of an entry, as CSV."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["statement", "basis", "reference", "impact-atlas", "difference", "agree"])
    for statement in statements:
        reference, ours = statement["reference"], statement["ours"]
        words = isinstance(reference, str | int) or isinstance(ours, str | int)
        apart = "" if words else f"{abs(ours - reference):.0e}"
        digits = 4 if statement["tolerance"] > 1e-4 else 10
        agrees = "yes" if statement["agrees"] else "no"
        cells = [statement["text"], statement["basis"], shown(reference, digits), shown(ours, digits), apart, agrees]
        rows.writerow(cells)
    return text.getvalue()


def shown(value: Any, digits: int) -> str:
    """A value in the form of the table; a number smaller than the rounding of such results is 0."""
    if isinstance(value, float):
        return f"{value:.{digits}g}" if abs(value) > 1e-12 else "0"
    return str(value)


def wrapped(text: str) -> str:
    """Text in lines of the pages' width; a span of code stays on one line."""
    whole = re.sub(r"`[^`]+`", lambda span: span[0].replace(" ", HELD), text)
    return fill(whole, 120, break_long_words=False, break_on_hyphens=False).replace(HELD, " ")
