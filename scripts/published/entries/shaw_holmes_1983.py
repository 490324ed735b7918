"""A damped mass with one rigid stop, the limit of a stiff spring, and its orbits with one impact in n periods.

Fold and period doubling come from ``one_impact``, in which the clearance is 1.
"""

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell, event
from scripts.published.one_impact import OneImpact

ZETA, R = 0.05, 0.8
CASES = (
    (1.8, 3.0, "fold", (1.0, 9.0)),
    (2.2, 6.0, "period_doubling", (1.0, 9.0)),
    (2.3, 8.0, "period_doubling", (1.0, 20.0)),
)
"""Frequency, amplitude of a stable orbit with one impact in a period, its event, range of amplitudes."""


def statements() -> list[Statement]:
    """The speed of an orbit, and the amplitude of the force at its fold or doubling, at three frequencies."""
    rows = []
    for omega, A, kind, window in CASES:
        law, given = OneImpact(omega, ZETA, R), {"omega": omega, "zeta": ZETA, "R": R, "A": A, "v": -3.0}
        solved, position = cell("single-mass", given), law.fold if kind == "fold" else law.doubling
        rows += [
            Statement(f"omega = {omega}: periods, impacts", "1, 1", f"{solved['period']}, {solved['impacts_upper']}"),
            Statement(f"omega = {omega}: speed of the impact at A = {A:g}", law.speeds(1.0, A)[0],
                      solved["max_impact_speed"]),
            Statement(f"omega = {omega}: A at the {kind.replace('_', ' ')}", 1.0 / position,
                      event("single-mass", given, "A", window, kind)),
        ]  # fmt: skip
    return rows


ENTRY = PublishedEntry(
    name="shaw-holmes-1983",
    work="S. W. Shaw and P. J. Holmes, J. Sound Vib. 90 (1983) 129",
    place="the impact limit: orbits with one impact and their period doubling",
    title="Mass with one rigid stop",
    machine=f"System `single-mass`, zeta = {ZETA}, R = {R}, b = 1.",
    statements=statements,
    commands=(
        "atlas branch --system single-mass --set omega=2.2 --set A=6 --set zeta=0.05 --set R=0.8 --set v=-3 --along A"
        " --from 1 --to 9",
    ),
)
