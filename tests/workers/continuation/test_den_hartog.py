"""A mass on a spring with dry friction and nothing else, against the closed form of Den Hartog.

Den Hartog J. P., Trans. ASME 53 (1931) 107: the mass never stops where the force is large. Its amplitude is then
sqrt((A V)^2 - U^2), in units of kinetic friction over the stiffness, with V = 1 / (1 - omega^2) and
U = sin(pi / omega) / (omega (1 + cos(pi / omega))), and it stops where that falls below 1 / omega^2.
"""

import math

import pytest

from workers import Settings, solve_tile
from workers.continuation import branch, orbit_from_state
from workers.continuation.families import family_of
from workers.model.system import find_system
from workers.results import PERIODIC

SETTINGS = Settings(survival=0, max_periods=3000)
DRY = {"s": 1.0, "zeta": 0.0}
FREQUENCIES = [0.6, 0.8, 1.3, 1.8]


def of_friction(omega: float) -> float:
    return math.sin(math.pi / omega) / (omega * (1.0 + math.cos(math.pi / omega)))


def of_force(omega: float) -> float:
    return 1.0 / (1.0 - omega**2)


def least_force(omega: float) -> float:
    """The force below which the mass stops at its turning points."""
    return math.hypot(of_friction(omega), omega**-2) / abs(of_force(omega))


@pytest.mark.parametrize("omega", FREQUENCIES)
@pytest.mark.parametrize("share", [1.001, 1.5, 4.0])
def test_the_amplitude_of_motion_that_never_stops_is_den_hartogs(omega: float, share: float) -> None:
    A = share * least_force(omega)
    cell = solve_tile("friction-oscillator", DRY | {"omega": omega, "A": A}, SETTINGS)
    assert cell["regime"] == PERIODIC and not cell["sticks"]
    exact = math.sqrt((A * of_force(omega)) ** 2 - of_friction(omega) ** 2)
    assert 0.5 * cell["peak_to_peak"] == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("omega", FREQUENCIES)
def test_the_mass_stops_below_his_line(omega: float) -> None:
    below = solve_tile("friction-oscillator", DRY | {"omega": omega, "A": 0.999 * least_force(omega)}, SETTINGS)
    assert below["regime"] == PERIODIC and below["stuck_fraction"] > 0.0


@pytest.mark.parametrize("omega", FREQUENCIES)
def test_the_branch_begins_to_stick_on_his_line(omega: float) -> None:
    """Nothing jumps there: the branch goes on as one whose mass stops."""
    system, A = find_system("friction-oscillator"), 1.5 * least_force(omega)
    values = DRY | {"omega": omega, "A": A}
    state = solve_tile("friction-oscillator", values, SETTINGS)["state"]
    orbit = orbit_from_state(system, values, state, 1, True)
    found = branch(family_of(system, DRY | {"omega": omega}, ("A",)), orbit, A, (0.6 * A, 2.0 * A))
    onset = max(event.point.values[0] for event in found.events if event.kind == "stick_onset")
    assert onset == pytest.approx(least_force(omega), rel=1e-11)
    assert found.ends == ("edge", "edge")
