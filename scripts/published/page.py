"""docs/published.md, made from the JSON that a run writes and from nothing else."""

import re
from collections.abc import Mapping
from textwrap import fill
from typing import Any

Record = Mapping[str, Any]
HELD = "\0"
"""In place of a blank at which no line ends."""

HEAD = (
    "Does impact-atlas reproduce what the field has published? This page compares {statements} numbers and findings of"
    " {works} works with its results (solver version {solver}). Differences are shown as differences, with their"
    " reasons. Where the axes of a source are known, its picture here has the same.",
    "The tables say how each reference is known. A *closed form* follows from the equations that the work solves. The"
    " module of the entry in `scripts/published/entries/` derives it anew, so that symbols may differ from the work's,"
    " and `tests/project/test_published.py` checks it by integrations and maps that share no code with the solver."
    " Differences of at most {exact:g} from a closed form count as agreement.",
    "`python -m scripts.published` computes all entries again and writes `docs/published.json` and this page; with"
    " names of entries it computes these alone. It runs in a checkout of the repository: entries are checks of the"
    " program, which a package need not carry. The commands and the examples below do with an installed package.",
)

TAIL = """\
## Not included

These results were considered and left out:

| work | reason |
|---|---|
{rows}
"""

LEFT_OUT = (
    ("M. Stender and N. Hoffmann, bSTAB, Nonlinear Dyn. (2021), doi 10.1007/s11071-021-06786-5: shares of attractors of"
     " a friction oscillator (0.3165 and 0.6835 of 4000 starts in the tests of pyBasin)",
     "its friction decays exponentially with the sliding speed; friction here is linear in it"),
    ("C. Weidemann et al., Nonlinear Dyn. (2025), doi 10.1007/s11071-025-10928-4: vibro-impact absorber",
     "no number of it could be confirmed; the exact motion with two impacts a period is in [Impact"
     " damper](#impact-damper)"),
    ("I. Ghosh and D. J. W. Simpson (2025), Fig. 4 with its own parameters", "its parameters could not be confirmed"),
    ("J. F. Mason and P. T. Piiroinen, SIAM J. Appl. Dyn. Syst. 8 (2009) 1694: two points of codimension two of a gear"
     " rattle", "parameters and points could not be confirmed"),
    ("S. L. T. de Souza, I. L. Caldas and R. L. Viana, Math. Probl. Eng. (2009) 290356: largest exponent of the impact"
     " pair over a plane", "it is a picture without digits; `impact-pair` is an example of the same machine"),
    ("Z. Iklodi and Z. Dombovari, Nonlinear Dyn. (2024), doi 10.1007/s11071-024-10188-8: branches with sticking",
     "the times in its demo are guesses for Newton's method; its parameters are used in [Dry friction with"
     " damping](#dry-friction-with-damping)"),
    ("C. Budd and F. Dux, Phil. Trans. R. Soc. A 347 (1994) 365: chatter",
     "its laws are asymptotic, and no number of it could be confirmed"),
    ("Q.-H. Li and J.-Y. Tan (2011), readings of the curves in the figures",
     "they are curves without digits; the references above were computed at the figures' parameters"),
)  # fmt: skip
"""Works and why they have no entry."""


def page_of(results: Record) -> str:
    """The page, as text."""
    entries = results["entries"]
    count = sum(len(entry["statements"]) for entry in entries)
    works = len({entry["work"] for entry in entries})
    facts = {"statements": count, "works": works, "solver": results["solver_version"], "exact": results["exact"]}
    head = "# Published results\n\n" + "".join(wrapped(text.format(**facts)) + "\n\n" for text in HEAD)
    tail = TAIL.format(rows="\n".join(f"| {work} | {reason} |" for work, reason in LEFT_OUT))
    return head + summary(entries) + "\n" + "\n".join(section(entry) for entry in entries) + "\n" + tail


def summary(entries: list[Record]) -> str:
    """The table of all entries, one a line."""
    rows = ["| work | entry | agree | verdict |", "|---|---|---|---|"]
    for entry in entries:
        agreeing = [each for each in entry["statements"] if each["agrees"]]
        anchor = re.sub(r"[^\w\- ]", "", entry["title"].lower()).replace(" ", "-")
        count = f"{len(agreeing)} of {len(entry['statements'])}"
        rows.append(f"| {entry['work']} | [{entry['title']}](#{anchor}) | {count} | {verdict(entry)} |")
    return "\n".join(rows) + "\n"


def verdict(entry: Record) -> str:
    """The verdict of an entry in a word or two."""
    differing = sum(not each["agrees"] for each in entry["statements"])
    return "agrees" if differing == 0 else f"**differs** in {differing}"


def section(entry: Record) -> str:
    """One entry: source, machine, commands, table, picture, reasons."""
    work = f"[{entry['work']}]({entry['link']})" if entry["link"] else entry["work"]
    words = [f"{work}: {entry['place']}.", entry["machine"]]
    if entry["example"]:
        words.append(f"`atlas example {entry['example']}` prints a spec of it.")
    words.append(f"`python -m scripts.published {entry['name']}` computes the table again.")
    parts = [f"## {entry['title']}", wrapped(" ".join(words))]
    if entry["commands"]:
        parts.append("```sh\n" + "\n".join(entry["commands"]) + "\n```")
    parts.append(table(entry["statements"]))
    if entry["caption"]:
        picture = f"published-{entry['name']}.png"
        drawn = f"Drawn by `python -m scripts.published {entry['name']} --picture {picture}`."
        parts += [f"![{entry['title']}]({picture})", wrapped(f"*{entry['caption']} {drawn}*")]
    reasons = dict.fromkeys(each["reason"] for each in entry["statements"] if not each["agrees"])
    parts += [wrapped(f"Why it differs: {reason or 'not known.'}") for reason in reasons]
    return "\n\n".join(parts) + "\n"


def table(statements: list[Record]) -> str:
    """The statements of an entry."""
    rows = ["| statement | basis | reference | ours | difference | verdict |", "|---|---|---|---|---|---|"]
    for each in statements:
        reference, ours = each["reference"], each["ours"]
        words = isinstance(reference, str | int) or isinstance(ours, str | int)
        apart = "" if words else f"{abs(ours - reference):.0e}"
        said = "agrees" if each["agrees"] else "**differs**"
        digits = 4 if each["tolerance"] > 1e-4 else 10
        cells = [each["text"], each["basis"], shown(reference, digits), shown(ours, digits), apart, said]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def shown(value: Any, digits: int) -> str:
    """A value as the table has it; a number smaller than the rounding of such results is 0."""
    if isinstance(value, float):
        return f"{value:.{digits}g}" if abs(value) > 1e-12 else "0"
    return str(value)


def wrapped(text: str) -> str:
    """Text in lines of the pages' width; a span of code stays on one line."""
    whole = re.sub(r"`[^`]+`", lambda span: span[0].replace(" ", HELD), text)
    return fill(whole, 120, break_long_words=False, break_on_hyphens=False).replace(HELD, " ")
