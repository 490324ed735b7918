"""The elastic impact oscillator, x'' + x = cos(omega t) with x < sigma and x' -> -x', preserves area.

Its two exponents add up to zero for every motion. Orbits with one impact in n periods turn in their plane: their
multipliers are a pair on the unit circle.
"""

from atlas.spec.spec import Spec
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell
from workers import Settings

FIXED = Settings(method="fixed", exponents="spectrum", transient_periods=0, periods=4000)


def statements() -> list[Statement]:
    """Sums of the exponents of irregular motions."""
    system, found = Spec.from_toml("budd-dux-1994").system_def, []
    for omega, sigma, x in ((2.8, 0.0, -0.7), (2.8, 0.1, -1.0), (3.6, -0.1, -0.5)):
        given = {"omega": omega, "sigma": sigma, "r": 1.0, "x": x, "v": 0.3}
        first, last = cell(system, given, FIXED)["spectrum"]
        found += [
            Statement(f"omega = {omega}, sigma = {sigma}: sum of the exponents", 0.0, first + last, 1e-10),
        ]
    return found


ENTRY = PublishedEntry(
    name="lamba-1993",
    work="H. Lamba, arXiv chao-dyn/9310004 (1993)",
    link="https://arxiv.org/abs/chao-dyn/9310004",
    place="the map of the elastic impact oscillator preserves area",
    title="Elastic impact oscillator",
    machine="The machine of the spec with r = 1.",
    statements=statements,
    example="budd-dux-1994",
)
