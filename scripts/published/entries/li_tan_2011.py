"""Figures 3 to 6 of the paper behind this package: two periodic motions, a chaotic one, and a sweep.

Figures 3 and 4 show motions with one and with two impacts a side, all exponents negative, some of them equal. Their
digits, and those of the bifurcations along Fig. 6, come from multiprecision arithmetic apart from the solver. The
exponents of Fig. 5 are those of long runs.
"""

import math
from collections.abc import Callable, Sequence

from atlas.cell.trajectory import cell_orbit
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import event
from workers import Settings

WORK = "Q.-H. Li and J.-Y. Tan, Chin. Phys. B 20 (2011) 040505"
LINK = "https://doi.org/10.1088/1674-1056/20/4/040505"
_COMMON = {"R": 0.8, "tau": math.pi}
CELLS = {
    "fig3": {**_COMMON, "mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "b": 0.1},
    "fig4": {**_COMMON, "mu_k": 4.0, "mu_m": 6.0, "zeta": 0.5, "f2": 2.0, "omega": 1.0, "b": 0.2},
    "fig5": {**_COMMON, "mu_k": 2.0, "mu_m": 2.0, "zeta": 0.5, "f2": 5.0, "omega": 3.0, "b": 0.2},
}
"""The parameters of the cells in Figs 3, 4 and 5: two periodic motions and a chaotic one."""

SETTINGS = Settings(tolerance=0.002, max_periods=400_000)
"""Settings for the exponents of Fig. 5 to the three digits that the paper gives."""

FIG_3 = (-0.235569640371152, -0.235569640371152, -0.524876727616246, -0.524876727616246)
FIG_4 = (-0.475914135412643, -2.614830482264854, -2.614830482264854, -7.598746373733903)
FIG_5 = (1.123, -1.577, -1.582, -4.38)
DIGITS = "multiprecision arithmetic"


def periodic(name: str, impacts: str, exponents: tuple[float, ...]) -> list[Statement]:
    """Period, impacts and exponents of Fig. 3 or 4."""
    solved = cell_orbit(CELLS[name]).cell
    ours = f"{solved['impacts_upper']} and {solved['impacts_lower']}"
    found = [
        Statement("period", 1, int(solved["period"]), basis="described"),
        Statement("impacts at the stops in a period", impacts, ours, basis="described"),
    ]
    for k, exact in enumerate(exponents):
        found.append(Statement(f"exponent {k + 1}", exact, float(solved["spectrum"][k]), 1e-7, DIGITS))
    return found


def chaotic() -> list[Statement]:
    """Exponents and impacts of Fig. 5."""
    solved = cell_orbit(CELLS["fig5"], settings=SETTINGS).cell
    found = [
        Statement(f"exponent {k + 1}", stated, float(solved["spectrum"][k]), 0.02 if k == 3 else 0.008,
                  "long runs, known to 0.002")
        for k, stated in enumerate(FIG_5)
    ]  # fmt: skip
    ours = float(solved["impacts_per_period"])
    return [*found, Statement("impacts in a period", 2.637, ours, 0.01, "long runs")]


def sweep() -> list[Statement]:
    """The bifurcations of the symmetric orbit along Fig. 6."""
    window = (2.0, 4.0)
    broken = event("two-mass", {"omega": 3.5, "b": 0.15}, "omega", window, "symmetry_breaking")
    doubled = event("two-mass", {"omega": 2.7, "b": 0.15}, "omega", (2.4, 2.95), "period_doubling")
    return [
        Statement("omega where the symmetric orbit breaks its symmetry", 3.00409423506357, broken, 1e-10, DIGITS),
        Statement("omega where the asymmetric orbit doubles its period", 2.4495892973, doubled, 2e-10,
                  "simulated motion, ten digits"),
    ]  # fmt: skip


def entry(number: int, title: str, statements: Callable[[], Sequence[Statement]], command: str) -> PublishedEntry:
    """The entry of a figure."""
    return PublishedEntry(
        name=f"li-tan-2011-fig{number}",
        work=WORK,
        link=LINK,
        place=f"Fig. {number}",
        title=title,
        machine="System `two-mass`; `python -m scripts.paper_figures` draws the figure.",
        statements=statements,
        example="fig6" if number == 6 else "",
        commands=(command,),
    )


ENTRIES = (
    entry(3, "Two masses, one impact a side", lambda: periodic("fig3", "1 and 1", FIG_3),
          "atlas point --set omega=4 --set b=0.1 --exponents spectrum"),
    entry(4, "Two masses, two impacts a side", lambda: periodic("fig4", "2 and 2", FIG_4),
          "atlas point --set omega=1 --set b=0.2 --set mu_k=4 --set mu_m=6 --set zeta=0.5 --set f2=2"
          " --exponents spectrum"),
    entry(5, "Two masses, chaos", chaotic,
          "atlas point --set omega=3 --set b=0.2 --set mu_k=2 --set mu_m=2 --set zeta=0.5 --set f2=5"
          " --exponents spectrum"),
    entry(6, "Two masses, a sweep", sweep,
          "atlas branch --set omega=3.5 --along omega --from 2 --to 4 --switch-branches"),
)  # fmt: skip
