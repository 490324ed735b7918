"""The soft-impact oscillator grazes its stop where the amplitude of the motion without contact equals the clearance.

a omega^2 / sqrt((1 - omega^2)^2 + (2 zeta omega)^2) = e is a quadratic equation in omega^2. If a < e it has two
solutions, one below the resonance and one above. The lower one is found on the branch of the motion without contact,
the upper one on that of a motion with contact, which begins there too.
"""

from math import sqrt

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell, event

ZETA, BETA, E = 0.01, 29.0, 1.26
AMPLITUDES = (0.4, 0.7)


def grazes(a: float) -> tuple[float, float]:
    """The frequencies at which the stop is grazed, for a < e."""
    square, half = E**2 - a**2, E**2 * (1.0 - 2.0 * ZETA**2)
    root = sqrt(half**2 - square * E**2)
    return sqrt((half - root) / square), sqrt((half + root) / square)


def statements() -> list[Statement]:
    """Both grazes for two amplitudes of the base, and cells on either side of the lower one."""
    found = []
    for a in AMPLITUDES:
        lower, upper = grazes(a)
        given = {"a": a, "zeta": ZETA, "beta": BETA, "e": E}
        for where, start, window, kind, exact in (
            ("below", 0.9 * lower, (0.5 * lower, 1.01 * lower), "graze", lower),
            ("above", 1.1 * upper, (0.99 * upper, 2.0 * upper), "contact_lost", upper),
        ):
            ours = event("soft-impact", given | {"omega": start}, "omega", window, kind)
            found.append(Statement(f"a = {a}: omega at the graze {where} the resonance", exact, ours))
        sides = [cell("soft-impact", given | {"omega": share * lower})["impacts_upper"] for share in (0.999, 1.001)]
        found.append(Statement(f"a = {a}: contact 0.1 % below and above the lower graze", "no, yes",
                               ", ".join("yes" if side else "no" for side in sides)))  # fmt: skip
    return found


ENTRY = PublishedEntry(
    name="ing-2008",
    work="J. Ing, E. Pavlovskaia, M. Wiercigroch and S. Banerjee, Phil. Trans. R. Soc. A 366 (2008) 679",
    place="frequencies at which the motion without contact grazes the stop, at the parameters of the rig",
    title="Soft-impact oscillator",
    machine=f"System `soft-impact`, zeta = {ZETA}, beta = {BETA:g}, e = {E}.",
    statements=statements,
    commands=("atlas branch --system soft-impact --set omega=0.7 --set a=0.7 --along omega --from 0.5 --to 1",),
)
