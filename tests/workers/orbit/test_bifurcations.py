"""Just next to the bifurcations of the sweep of Fig. 6, omega 2..4: classified rightly, or left undetermined.

The bifurcations were located by ``locate``: the orbit is followed by Newton's method, stable or not, and omega is
bisected until its leading multiplier is -1, or stepped towards the end of its branch where the multiplier is +1
(fold) or where a further impact appears at once (grazing). Each test finds its constant again. A multiplier is one
of the orbit's map: of the half-period map G for the symmetric orbit, of so many forcing periods otherwise.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from workers.kernel.cell_loops import scale_of
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import FLIGHT, motion_at
from workers.model.oscillator import Oscillator
from workers.model.system import find_system
from workers.orbit.map import FixedPoint
from workers.orbit.newton import newton
from workers.results import CHAOTIC, PERIODIC, UNDETERMINED
from workers.tile import solve_tile

pytestmark = pytest.mark.slow

TWO_MASS = find_system("two-mass")


@dataclass(frozen=True)
class Bifurcation:
    """Where one orbit gives way to another.

    kind            "symmetry breaking" (multiplier of G is -1), "period doubling" (-1; "subcritical" where no stable
                    orbit of twice the period succeeds it), "fold" (+1) or "grazing"
    omega           where
    seed            omega at which a cell from rest settles on the orbit
    steps, half     the orbit's map: so many steps of G (half) or of the stroboscopic map
    stable_side     +1 or -1: the side of omega on which the orbit is stable
    stable, beyond  (period, symmetric) on that side and on the other; None: not this orbit, nothing periodic near it
    """

    kind: str
    omega: float
    seed: float
    steps: int
    half: bool
    stable_side: int
    stable: tuple[int, bool]
    beyond: tuple[int, bool] | None

    def __str__(self) -> str:
        return f"{self.kind}, period {self.stable[0]}, omega={self.omega:.8f}"


KNOWN = [
    Bifurcation("symmetry breaking", 3.0040942351, 3.01, 1, True, +1, (1, True), (1, False)),
    Bifurcation("period doubling", 2.4495892973, 2.47, 1, False, +1, (1, False), (2, False)),
    Bifurcation("period doubling", 2.2352569808, 2.24, 2, False, +1, (2, False), (4, False)),
    Bifurcation("period doubling", 2.2178961545, 2.222, 4, False, +1, (4, False), (8, False)),
    Bifurcation("subcritical period doubling", 2.1032479935, 2.1, 2, False, -1, (2, False), None),
    Bifurcation("period doubling", 2.0646871370, 2.067, 2, False, +1, (2, False), (4, False)),
    Bifurcation("period doubling", 2.0565331377, 2.058, 4, False, +1, (4, False), (8, False)),
    Bifurcation("period doubling", 2.0285149868, 2.03, 2, False, +1, (2, False), (4, False)),
    Bifurcation("fold", 2.2823005239, 2.28, 2, False, -1, (2, False), None),
    Bifurcation("fold", 2.0352965860, 2.034, 2, False, -1, (2, False), None),
    Bifurcation("grazing", 2.3770110394, 2.38, 2, False, +1, (2, False), None),
]


def oscillator(omega: float) -> Oscillator:
    """The system of Fig. 6 (the defaults) at this forcing frequency."""
    return TWO_MASS.build({p.name: p.default for p in TWO_MASS.parameters} | {"omega": omega})


def orbit_near(bifurcation: Bifurcation, omega: float, h: np.ndarray) -> FixedPoint | None:
    """The orbit at omega, stable or not, by Newton's method from a block state; None where there is none."""
    osc = oscillator(omega)
    scale = scale_of(osc.gap.blocks, h)
    found, _ = newton(osc, h, FLIGHT, bifurcation.steps, bifurcation.half, scale, 20)
    return found if math.isfinite(found.residual) else None


def multiplier(orbit: FixedPoint) -> complex:
    """The largest multiplier of an orbit's map."""
    values = np.linalg.eigvals(orbit.jacobian)
    return complex(values[np.argmax(np.abs(values))])


@cache
def followed(bifurcation: Bifurcation) -> tuple[float, FixedPoint]:
    """The orbit, followed from its seed to 1e-4 before the end of its branch or just past the bifurcation."""
    found = solve_tile("two-mass", {"omega": bifurcation.seed})
    assert (int(found["regime"]), int(found["period"])) == (PERIODIC, bifurcation.stable[0])
    h = motion_from(oscillator(bifurcation.seed), found["state"]).h
    omega, step = bifurcation.seed, -bifurcation.stable_side * 2e-4
    orbit = orbit_near(bifurcation, omega, h)
    assert orbit is not None
    while abs(step) > 1e-5:
        further = orbit_near(bifurcation, omega + step, orbit.h)
        if further is None:
            step /= 2
            continue
        if doubling(bifurcation) and multiplier(further).real < -1.0:
            break
        omega, orbit = omega + step, further
    return omega, orbit


def doubling(bifurcation: Bifurcation) -> bool:
    """Whether the multiplier is -1 and the orbit continues, unstable."""
    return bifurcation.kind not in ("fold", "grazing")


@cache
def locate(bifurcation: Bifurcation) -> float:
    """omega of the bifurcation, to 1e-10.

    Multiplier -1: bisection between an orbit with |mu| < 1 and one beyond. Fold: the orbit is followed by steps of
    0.9 of the distance at which (1 - mu)^2, which is linear there, comes to zero. Grazing: bisection on whether
    Newton's method still finds the orbit.
    """
    stable, orbit = followed(bifurcation)
    away = -bifurcation.stable_side
    if bifurcation.kind == "fold":
        before, omega = stable, stable + away * 1e-6
        value = (1.0 - multiplier(orbit).real) ** 2
        for _ in range(60):
            further = orbit_near(bifurcation, omega, orbit.h)
            if further is None:
                omega = 0.5 * (omega + before)
                continue
            now = (1.0 - multiplier(further).real) ** 2
            left = now * abs(omega - before) / (value - now)
            before, value, orbit = omega, now, further
            omega += away * 0.9 * left
            if left < 1e-10:
                break
        return omega
    unstable = stable + away * 4e-4
    while abs(unstable - stable) > 1e-10:
        middle = 0.5 * (stable + unstable)
        further = orbit_near(bifurcation, middle, orbit.h)
        if further is None or (doubling(bifurcation) and multiplier(further).real < -1.0):
            unstable = middle
        else:
            stable, orbit = middle, further
    return 0.5 * (stable + unstable)


def near(bifurcation: Bifurcation, distance: float) -> dict[str, float]:
    """Parameters of a cell at this distance from the bifurcation that starts a thousandth from the orbit."""
    _, orbit = followed(bifurcation)
    omega = bifurcation.omega + distance
    near = orbit_near(bifurcation, omega, orbit.h)
    osc = oscillator(omega)
    state = blocks_to_physical(osc, motion_at((near or orbit).h))
    return {"omega": omega} | dict(zip(("x1", "x2", "v1", "v2"), (state * 1.001).tolist(), strict=True))


@pytest.mark.parametrize("bifurcation", KNOWN, ids=str)
def test_the_bifurcation_is_where_the_multiplier_crosses(bifurcation: Bifurcation) -> None:
    assert locate(bifurcation) == pytest.approx(bifurcation.omega, abs=1e-8)
    _, orbit = followed(bifurcation)
    values = []
    for distance in (1e-7, -1e-7):
        near = orbit_near(bifurcation, bifurcation.omega + distance * bifurcation.stable_side, orbit.h)
        values.append(math.nan if near is None else multiplier(near).real)
    if doubling(bifurcation):
        assert -1.0 < values[0] < -1.0 + 1e-4
        assert -1.0 - 1e-4 < values[1] < -1.0
    elif bifurcation.kind == "fold":
        assert 0.99 < values[0] < 1.0
        assert math.isnan(values[1]) or values[1] > 1.0
    else:
        assert abs(values[0]) < 0.9
        assert math.isnan(values[1])


@pytest.mark.parametrize("distance", [1e-3, -1e-3], ids=["+1e-3", "-1e-3"])
@pytest.mark.parametrize("bifurcation", KNOWN, ids=str)
def test_a_thousandth_from_a_bifurcation_the_class_is_right(bifurcation: Bifurcation, distance: float) -> None:
    found = solve_tile("two-mass", near(bifurcation, distance))
    right = bifurcation.stable if distance * bifurcation.stable_side > 0 else bifurcation.beyond
    shown = (int(found["period"]), bool(found["symmetric"]))
    if right is None:
        assert found["regime"] == CHAOTIC or shown != bifurcation.stable
    else:
        assert (int(found["regime"]), *shown) == (PERIODIC, *right)


@pytest.mark.parametrize("distance", [1e-5, -1e-5], ids=["+1e-5", "-1e-5"])
@pytest.mark.parametrize("bifurcation", KNOWN, ids=str)
def test_a_hundred_thousandth_from_a_bifurcation_the_class_is_never_wrong(
    bifurcation: Bifurcation, distance: float
) -> None:
    found = solve_tile("two-mass", near(bifurcation, distance))
    right = bifurcation.stable if distance * bifurcation.stable_side > 0 else bifurcation.beyond
    shown = (int(found["period"]), bool(found["symmetric"]))
    if right is None:
        assert found["regime"] in (CHAOTIC, UNDETERMINED) or shown != bifurcation.stable
    else:
        assert found["regime"] == UNDETERMINED or (int(found["regime"]), *shown) == (PERIODIC, *right)
