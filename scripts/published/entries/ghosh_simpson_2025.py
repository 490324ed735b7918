"""The curve of folds of the orbits with one impact in two periods, which are hard to follow near a graze.

Every computed point must lie on the closed form of ``one_impact``.
"""

from scripts.published.entries.simpson_ghosh_2026 import EXAMPLE, ZETA, R
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import curves_of, largest_difference
from scripts.published.one_impact import OneImpact


def statements() -> list[Statement]:
    """All points of the packaged plane's curves of folds (n = 2) and of period doublings (n = 1)."""
    curves, found = curves_of(EXAMPLE), []
    for kind, n in (("fold", 2), ("period_doubling", 1)):
        rows = curves[(curves["kind"] == kind) & (curves["period"] == n) & (curves["impacts_upper"] == 1)]
        laws = [OneImpact(omega, ZETA, R, n) for omega in rows["omega"]]
        exact = [1.0 / (law.fold if kind == "fold" else law.doubling) for law in laws]
        words = f"{kind.replace('_', ' ')}s of orbits with one impact in {n} period{'s' * (n > 1)}"
        found += [
            Statement(f"{words}: a curve is found", "yes", "yes" if len(rows) > 20 else "no"),
            Statement(f"{words}: largest distance in A from the closed form",
                      0.0, largest_difference(rows["A"], exact) if len(rows) else float("nan")),
        ]  # fmt: skip
    return found


ENTRY = PublishedEntry(
    name="ghosh-simpson-2025",
    work="I. Ghosh and D. J. W. Simpson, arXiv 2510.16218 (2025)",
    link="https://arxiv.org/abs/2510.16218",
    place="curves of the orbit with one impact in two periods near a resonant graze (Fig. 4, with parameters of our"
    " own: theirs could not be confirmed)",
    title="Curves that begin at a resonant graze",
    machine="As in [Resonant grazes](#resonant-grazes).",
    statements=statements,
    example=EXAMPLE,
)
