"""Claims about branches of equilibria of machines without a force, and their Hopf points. Truth: closed forms."""

import math
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.errors import InputError
from tests.unforced import machine
from workers import Settings, System
from workers.continuation import family_of
from workers.continuation.equilibria import EquilibriumBranch, equilibria, equilibrium_of

SMOOTH = 0.5 * math.log(10.0)
"""B5: the speed of a belt with friction .5 + .5 e^(-2 v) and damping .1 at which sliding becomes stable."""


def followed(
    system: System, along: str, window: tuple[float, float], state: list[float], **given: float
) -> EquilibriumBranch:
    values = {parameter.name: parameter.default for parameter in system.parameters} | given
    orbit = equilibrium_of(system, values, np.array(state))
    return equilibria(family_of(system, values, (along,)), orbit, values[along], window)


def chords_of(h: float) -> dict[str, Any]:
    """The friction of B5 with chords of its law at multiples of h up to 4, and constant from there on."""
    v = np.append(h * np.arange(round(4.0 / h) + 1), 5.0)
    law = [[float(at), 0.5 + 0.5 * math.exp(-2.0 * min(float(at), 4.0))] for at in v]
    return {"name": "belt", "row": [1.0], "belt": "u", "law": law}


def chords(h: float) -> System:
    """The belt of B5 with this friction."""
    return machine(damping=[[0.1]], friction=[chords_of(h)], parameters={"u": 1.3})


def hopf_of(found: EquilibriumBranch) -> tuple[float, float]:
    """The value and the frequency of the only event, which is a Hopf point."""
    (event,) = found.run.events
    assert event.kind == "hopf"
    return float(event.point.values[0]), 2.0 * math.pi / float(event.point.orbit.length)


def test_a_hopf_point_is_where_damping_vanishes_at_the_natural_frequency() -> None:
    stop = {"name": "stop", "gap": [1.0], "upper": 1.0, "restitution": 0.5}
    system = machine(damping=[["c"]], contacts=[stop], parameters={"c": 0.2})
    found = followed(system, "c", (-0.3, 0.4), [0.0, 0.0])
    value, frequency = hopf_of(found)
    assert value == pytest.approx(0.0, abs=1e-11)
    assert frequency == pytest.approx(1.0, abs=1e-12)
    assert found.run.ends == ("edge", "edge")
    counts = {float(point.values[0]) < 0.0: point.unstable for point in found.run.points if abs(point.values[0]) > 1e-9}
    assert counts == {True: 2, False: 0}


def test_flutter_begins_at_the_hopf_point_of_its_closed_form() -> None:
    """A6: P = 41/28 + c^2/2 at the frequency sqrt(2/7)."""
    for c in (0.1, 0.3):
        system = System.from_mapping({
            "name": "flutter", "coordinates": ["x1", "x2"], "mass": [[3.0, 1.0], [1.0, 1.0]],
            "damping": [[2.0 * c, -c], [-c, c]], "stiffness": [["2 - P", "P - 1"], [-1.0, 1.0]],
            "contacts": [{"name": "rub", "gap": [0.0, 1.0], "upper": 0.5, "lower": -0.5, "stiffness": 10.0}],
            "parameters": {"P": 1.3},
        })  # fmt: skip
        value, frequency = hopf_of(followed(system, "P", (1.2, 1.9), [0.0] * 4))
        assert value == pytest.approx(41.0 / 28.0 + 0.5 * c**2, abs=1e-10)
        assert frequency == pytest.approx(math.sqrt(2.0 / 7.0), abs=1e-10)


@pytest.mark.parametrize("h", [0.5, 0.25, 0.125, 0.1])
def test_a_hopf_point_of_a_law_in_segments_is_at_the_vertex_where_its_slope_passes_the_damping(h: float) -> None:
    """C3: at 1 for h = .5; it tends to .5 ln 10 to first order. Below it the exponents are of the steeper segment."""
    slopes = 0.5 * np.diff(np.exp(-2.0 * h * np.arange(round(4.0 / h) + 1))) / h
    j = int(np.sum(slopes < -0.1))
    value, frequency = hopf_of(followed(chords(h), "u", (0.6, 1.9), [0.6, 0.0]))
    assert value == pytest.approx(h * j, abs=1e-12)
    assert abs(value - SMOOTH) < h
    steep = 0.1 + slopes[j - 1]
    assert frequency == pytest.approx(math.sqrt(1.0 - 0.25 * steep**2), abs=1e-12)
    if h == 0.5:
        assert (value, frequency) == pytest.approx((1.0, 0.997801589269799), abs=1e-12)


def test_sliding_is_at_the_friction_of_its_speed_and_ends_where_the_belt_turns_round() -> None:
    friction = {"name": "belt", "row": [1.0], "kinetic": 0.4, "static": 1.0, "belt": "u", "slope": 0.1}
    found = followed(machine(friction=[friction], damping=[[0.1]], parameters={"u": 0.5}), "u", (-0.5, 1.0), [0.4, 0.0])
    u = np.array([point.values[0] for point in found.run.points])
    assert found.run.ends == ("border", "edge")
    assert u[0] == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(found.states[:, 0], 0.4 + 0.1 * u, rtol=1e-14)
    assert not found.states[:, 1].any()


def test_a_rigid_stop_holds_an_equilibrium_while_a_load_presses_it_and_lets_it_go() -> None:
    stop = {"name": "stop", "gap": [1.0], "lower": 0.0, "restitution": 0.5}
    system = machine(damping=[[0.1]], contacts=[stop], load=["p"], parameters={"p": -0.5})
    found = followed(system, "p", (-0.73, 0.81), [0.0, 0.0])
    p = np.array([point.values[0] for point in found.run.points])
    assert (found.run.ends, found.run.events) == (("edge", "edge"), [])
    np.testing.assert_allclose(found.states[:, 0], np.maximum(p, 0.0), atol=1e-15)
    held = [point.multipliers.tolist() == [0.0, 0.0] for point in found.run.points]
    assert held == (p < 0.0).tolist()


def test_a_mass_on_a_falling_characteristic_buckles_at_a_fold() -> None:
    """A spring with the slope -.8 between -.5 and .5: 0 loses stability where k passes .8."""
    spring = {"name": "beam", "row": [1.0], "law": [[-2.0, -2.0], [-0.5, 0.4], [0.5, -0.4], [2.0, 2.0]]}
    system = machine(damping=[[0.1]], stiffness=[["k"]], springs=[spring], parameters={"k": 2.0})
    found = followed(system, "k", (0.5, 2.5), [0.0, 0.0])
    (event,) = found.run.events
    assert (event.kind, event.point.unstable) == ("fold", 0)
    assert event.point.values[0] == pytest.approx(0.8, abs=1e-12)


def test_tables_have_the_frequency_of_a_hopf_point_and_the_period_of_the_cycle_that_begins() -> None:
    quick = Settings(survival=0, max_periods=2000)
    found = atlas.branch({"u": 1.4}, along="u", window=(0.8, 1.6), system=chords(0.5), settings=quick)
    (event,) = found.events.to_dict("records")
    assert (event["kind"], event["u"], event["unstable"]) == ("hopf", pytest.approx(1.0, abs=1e-12), 0)
    assert event["frequency"] == pytest.approx(0.997801589269799, abs=1e-12)
    assert event["cycle_period"] == pytest.approx(2.0 * math.pi / event["frequency"], rel=1e-15)
    assert found.points["unstable"].max() == 2


def test_what_friction_holds_is_no_branch() -> None:
    friction = {"name": "ground", "row": [1.0], "kinetic": 0.4}
    block = machine(damping=[[0.1]], friction=[friction], parameters={"k": 0.5})
    with pytest.raises(InputError, match="this cell: found one of a continuum of equilibria at which friction sticks"):
        atlas.branch({"x": 0.1}, along="k", window=(0.2, 0.8), system=block)
