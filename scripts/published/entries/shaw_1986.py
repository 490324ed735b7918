"""A forced mass with viscous damping and dry friction that never sticks.

During the half period in which it slides backwards friction is 1. With u = x - 1 - F cos(omega t + psi), the free part,
symmetry asks for (E + 1) (u, u') = (-2, 0) at the turning point, where E is the free flow over half a period. So u and
u' are known, and

    F sin psi = u' / omega,    X = 1 + u + F cos psi.

The mass does not stick at its turning points while the force minus that of the spring, f - X, stays below -s there.
"""

from math import cos, exp, hypot, nan, pi, sin, sqrt

from scipy.optimize import brentq

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell, events

ZETA, A, S = 0.05, 1.5, 1.1


def turning(omega: float) -> tuple[float, float]:
    """The amplitude X, and s plus the force on the resting mass at the turning point: positive if it sticks."""
    rate, half = sqrt(1.0 - ZETA**2), pi / omega
    decay, c, s = exp(-ZETA * half), cos(rate * half), sin(rate * half) / rate
    a11, a12, a21, a22 = 1.0 + decay * (c + ZETA * s), decay * s, -decay * s, 1.0 + decay * (c - ZETA * s)
    det = a11 * a22 - a12 * a21
    u, du = -2.0 * a22 / det, 2.0 * a21 / det
    F = A / hypot(1.0 - omega**2, 2.0 * ZETA * omega)
    sine, cosine = du / (omega * F), sqrt(1.0 - (du / (omega * F)) ** 2)
    X = 1.0 + u + F * cosine
    force = F * ((1.0 - omega**2) * cosine - 2.0 * ZETA * omega * sine)
    return X, force - X + S


def onsets() -> tuple[float, float]:
    """The lowest and the highest frequency of motion that never sticks."""
    low = brentq(lambda omega: turning(omega)[1], 0.7, 0.9, xtol=1e-14)
    return low, brentq(lambda omega: turning(omega)[1], 1.0, 1.3, xtol=1e-14)


def statements() -> list[Statement]:
    """The amplitude at omega = 0.9 and both ends of the motion that never sticks."""
    given = {"omega": 0.9, "A": A, "zeta": ZETA, "s": S}
    ours = events("friction-oscillator", given, "omega", (0.5, 1.5), "stick_onset")  # the branch goes on with sticking
    low, high = onsets()
    size = 0.5 * cell("friction-oscillator", given)["peak_to_peak"]
    below = cell("friction-oscillator", given | {"omega": 2.0 * pi / 8.667})
    return [
        Statement("amplitude at omega = 0.9", turning(0.9)[0], size),
        Statement("lowest omega without sticking", low, max((omega for omega in ours if omega < 0.9), default=nan)),
        Statement("highest omega without sticking", high, min((omega for omega in ours if omega > 0.9), default=nan)),
        Statement("sticks at the period 8.667, from which the demo of PWSDDE-cont continues with sticking", "yes",
                  "yes" if below["sticks"] else "no", basis="stated by the demo"),
    ]  # fmt: skip


ENTRY = PublishedEntry(
    name="shaw-1986",
    work="S. W. Shaw, J. Sound Vib. 108 (1986) 305",
    place="motion that slides all the time, and where it begins to stick; parameters of the demo of friction in"
    " PWSDDE-cont (Z. Iklodi and Z. Dombovari, Nonlinear Dyn. 2024, doi 10.1007/s11071-024-10188-8)",
    title="Dry friction with damping",
    machine=f"System `friction-oscillator`, zeta = {ZETA}, A = {A}, s = {S}.",
    statements=statements,
    commands=(
        "atlas branch --system friction-oscillator --set omega=0.9 --set A=1.5 --set zeta=0.05 --set s=1.1"
        " --along omega --from 0.5 --to 1.5",
    ),
)
