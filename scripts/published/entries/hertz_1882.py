"""Hertz's impact of two balls: depth and duration of contact.

With the force k d^1.5 and the reduced mass m the energy gives m v^2 / 2 = (2/5) k d^2.5, so that from the speed v on

    greatest depth  d = (5 m v^2 / (4 k))^(2/5)
    time of contact 2 d / v * integral from 0 to 1 of ds / sqrt(1 - s^2.5) = 2.9432 d / v.

Here the same contact ends each flight of a forced mass. The effect of spring and force during the contact is their
share of its force; the segments of the law add their error bound.
"""

from math import gamma, pi, sqrt

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell
from workers import Settings, System

OMEGA, WITHIN = 1.2, 1e-4
SETTINGS = Settings(survival=0, max_periods=4000, observe="impact_speed:ball", exponents="none")
STIFF = "closed form of a contact that is stiff"
TIME = 2.0 * sqrt(pi) * gamma(0.4) / (2.5 * gamma(0.9))
"""Time of contact over d / v, 2.9432."""


def depth(k: float, v: float) -> float:
    """The greatest depth for a unit mass of speed v."""
    return float((1.25 * v**2 / k) ** 0.4)


def mass_with(k: float) -> System:
    """A unit mass on a spring and a damper, forced against a ball."""
    law = {"law": "k * d**1.5", "within": WITHIN, "range": "1.2 * (1.25 / k)**0.4"}
    return System.from_mapping(
        {"name": "mass-and-ball", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.4]], "stiffness": [[1.0]],
         "force": [1.0], "contacts": [{"name": "ball", "gap": [1.0], "upper": 0.3, **law}],
         "parameters": {"omega": OMEGA, "k": k}}
    )  # fmt: skip


def statements() -> list[Statement]:
    """Depth and time of contact of the one contact of an orbit, by its speed, for three stiffnesses."""
    found = []
    for k in (1e5, 1e7, 1e9):
        solved = cell(mass_with(k), {}, SETTINGS)
        v, deepest = solved["impact_speed_ball"][0], solved["ball_penetration"]
        touch = solved["ball_fraction"] * solved["period"] * 2.0 * pi / OMEGA
        d = depth(k, v)
        share = (1.0 + 0.3 + 0.4 * v) / (k * d**1.5) + WITHIN  # shares of force, spring and damper, and of the segments
        found += [
            Statement(f"k = {k:g}: contacts in the period of the orbit", 1, solved["impact_speed_ball_number"]),
            Statement(f"k = {k:g}: greatest depth over Hertz's", 1.0, deepest / d, share, STIFF),
            Statement(f"k = {k:g}: time of contact over Hertz's", 1.0, touch / (TIME * d / v), share, STIFF),
        ]
    return found


ENTRY = PublishedEntry(
    name="hertz-1882",
    work="H. Hertz, J. reine angew. Math. 92 (1882) 156",
    place="greatest approach and duration of the impact of elastic balls",
    title="Impact on a Hertzian contact",
    machine="A unit mass on a spring and a damper, forced by sin(omega t) against a contact k d^1.5 at x = 0.3, in"
    f" segments within {WITHIN:g}: `scripts/published/entries/hertz_1882.py`. Force and spring act during the contact"
    " too, less so in a stiffer one.",
    statements=statements,
)
