"""Claims about pictures of any system: stops that are unequal or missing, loads, harmonics, one mass and many."""

import json
from itertools import combinations
from typing import Any

import numpy as np
import pytest
import xarray as xr

from atlas import render
from atlas.cell import trajectory as cell
from atlas.cell.trajectory import CellTrajectory, cell_orbit, describe
from atlas.errors import InputError
from atlas.query import machine
from atlas.render import grazing, text
from atlas.spec.system import stored_system
from tests.pictures import labels
from workers.model.system import System, find_system
from workers.results import CHAOTIC, PENDING, PERIODIC

pytestmark = pytest.mark.slow

SINGLE, DAMPER = find_system("single-mass"), find_system("impact-damper")
LOADED = System.from_mapping(
    {
        "name": "loaded",
        "coordinates": ["x"],
        "mass": [[1.0]],
        "stiffness": [[2.0]],
        "force": ["A"],
        "harmonics": [{"order": 2, "force": ["A2"], "phase": [0.3]}],
        "load": ["q"],
        "gap": [1.0],
        "upper": "b",
        "lower": "-b",
        "restitution": 0.8,
        "parameters": {"A": {"default": 1.0}, "A2": {"default": 0.0}, "q": {"default": 0.0}, "b": {"default": 1.0}},
    }
)
LOADED_MANY = LOADED.build_many({p.name: np.array([p.default]) for p in LOADED.parameters})[0].gap


def atlas_of(system: System, axes: dict[str, Any], **values: Any) -> xr.Dataset:
    """An atlas of a system as a store's: scalars among the values are fixed parameters, arrays (y, x, ...) results."""
    coords = {p.name: values.pop(p.name, p.default) for p in system.parameters} | axes
    dims = tuple(reversed(axes))
    extra = ("sample", "component")
    return xr.Dataset(
        {name: (dims + extra[: np.ndim(array) - len(dims)], np.asarray(array)) for name, array in values.items()},
        {name: ((name,) if name in axes else (), np.asarray(value, float)) for name, value in coords.items()},
        {"digest": "d1ge57", "spec": json.dumps({**system.to_resolved(), "axes": []}), "software": "numpy 2"},
    )


def periodic_plane(system: System, axes: dict[str, Any], **fixed: float) -> xr.Dataset:
    shape = tuple(len(values) for values in reversed(axes.values()))
    ones = np.ones(shape, np.int32)
    return atlas_of(
        system, axes, regime=np.full(shape, PERIODIC, np.int8), symmetric=np.zeros(shape, bool),
        period=ones, impacts_upper=2 * ones, impacts_lower=ones, **fixed,
    )  # fmt: skip


def ratio(system: System, **given: float) -> float:
    """The grazing ratio of one machine."""
    fixed = {p.name: given.get(p.name, p.default) for p in system.parameters}
    points = [(name, np.array([fixed.pop(name)])) for name in ("omega", "b")]
    return float(grazing.grazing_ratio(system, fixed, *points)[0, 0])


def response(omega: float, k: float = 1.0, zeta: float = 0.0) -> float:
    return float(1.0 / abs(k - omega**2 + 2j * zeta * omega))


# The grazing line


@pytest.mark.parametrize("a", [0.3, 0.5, 2.0])
def test_the_extremes_of_two_harmonics_are_those_of_the_closed_form(a: float) -> None:
    """Truth: cos phi + a cos 2 phi lies between -a - 1 / (8 a), where cos phi = -1 / (4 a), and 1 + a, for a > 1/4."""
    signal = LOADED_MANY._replace(waves=np.array([[[0.0, 1.0], [0.0, a], [0.0, 0.0], [0.0, 0.0]]]))
    assert [float(extreme[0]) for extreme in grazing.extremes(signal)] == pytest.approx(
        [1 + a, -a - 1 / (8 * a)], rel=1e-14
    )


def test_no_value_of_any_harmonics_lies_beyond_their_extremes() -> None:
    """Truth: 20,000 values of each signal, between which it cannot rise by more than 1e-6 of its size."""
    rng = np.random.default_rng(1)
    s, c = rng.normal(size=(2, 50, 4)) * 10.0 ** rng.integers(-8, 2, (50, 4))
    highest, lowest = grazing.extremes(LOADED_MANY._replace(waves=np.stack([s, c], axis=-1)))
    phi = np.linspace(0, 2 * np.pi, 20_000)[:, None]
    k = np.arange(1, 5)
    for i in range(50):
        values = np.sin(k * phi) @ s[i] + np.cos(k * phi) @ c[i]
        size = np.abs(values).max()
        assert values.max() - 1e-12 * size <= highest[i] <= values.max() + 1e-6 * size
        assert values.min() - 1e-6 * size <= lowest[i] <= values.min() + 1e-12 * size


@pytest.mark.parametrize(("s", "nearest"), [(0.0, 1.2), (0.5, 1.2), (1.0, 1.2), (2.0, 0.6)])
def test_of_unequal_stops_the_nearer_one_is_grazed(s: float, nearest: float) -> None:
    expected = np.log(0.4 * response(0.8, zeta=0.02) / nearest)
    assert ratio(SINGLE, omega=0.8, A=0.4, b=1.2, s=s) == pytest.approx(expected, abs=1e-12)


def test_distances_to_the_stops_are_those_from_the_rest_position() -> None:
    """Truth: a load q on a spring of stiffness 2 moves the rest position by q / 2."""
    expected = np.log(response(0.5, k=2.0) / (1.0 - 0.3))
    assert ratio(LOADED, omega=0.5, q=0.6) == ratio(LOADED, omega=0.5, q=-0.6) == pytest.approx(expected, abs=1e-12)
    assert ratio(LOADED, omega=0.5, q=2.5) == np.inf


def test_of_several_harmonics_the_largest_deflection_counts() -> None:
    phi = np.linspace(0, 2 * np.pi, 100_000)
    values = response(0.5, 2.0) * np.sin(phi) + 0.7 * response(1.0, 2.0) * np.sin(2 * phi + 0.3)
    assert ratio(LOADED, omega=0.5, A2=0.7) == pytest.approx(np.log(np.abs(values).max()), abs=1e-8)


@pytest.mark.parametrize("beta", [1.0, 29.0])
def test_a_soft_stop_is_grazed_where_the_response_reaches_it(beta: float) -> None:
    soft = find_system("soft-impact")
    fixed = {p.name: p.default for p in soft.parameters if p.name not in ("omega", "a")} | {"beta": beta}
    found = grazing.grazing_ratio(soft, fixed, ("omega", np.array([0.6, 0.9, 1.1])), ("a", np.array([0.2, 0.7])))
    omega = np.array([0.6, 0.9, 1.1])
    reach = np.array([[0.2], [0.7]]) * omega**2 / np.abs(1.0 - omega**2 + 2j * 0.01 * omega)
    assert found == pytest.approx(np.log(reach / 1.26), abs=1e-12)


def test_of_several_contacts_the_nearest_is_grazed() -> None:
    """Truth: the response of both masses from their matrices."""
    two, omega = find_system("two-stops"), 0.9
    fixed = {p.name: p.default for p in two.parameters if p.name not in ("omega", "b2")}
    K = np.array([[2.0, -1.0], [-1.0, 1.0]])
    first, second = np.abs(np.linalg.solve(K - omega**2 * np.eye(2) + 0.1j * omega * K, [0.5, 0.5]))
    b2 = np.array([0.2, 0.5, 2.0, 9.0])
    found = grazing.grazing_ratio(two, fixed, ("omega", np.array([omega])), ("b2", b2))[:, 0]
    assert found == pytest.approx(np.log(np.maximum(first / 0.5, second / b2)), abs=1e-12)


@pytest.mark.parametrize("name", ["soft-impact", "two-stops"])
def test_the_grazing_line_of_a_machine_with_modes_is_drawn(name: str) -> None:
    system = find_system(name)
    axes = {parameter: np.linspace(low, high, 5) for parameter, low, high in system.axes}
    drawn = render.figure(periodic_plane(system, axes), "period", overlay="grazing")
    assert labels(drawn)[-1] == "impact-free motion\ngrazes a stop"


def test_where_motion_without_impact_is_not_linear_the_way_on_is_named() -> None:
    mass = find_system("stick-slip")
    ds = periodic_plane(mass, {parameter: np.linspace(low, high, 4) for parameter, low, high in mass.axes})
    with pytest.raises(InputError, match=r"has friction, so .*; atlas find curves finds the grazes of its orbits"):
        render.figure(ds, "period", overlay="grazing")


def test_where_a_mode_has_no_stiffness_there_is_no_grazing_line() -> None:
    ball = find_system("bouncing-ball")
    ds = periodic_plane(ball, {"omega": [1, 2], "R": [0.2, 0.4]})
    with pytest.raises(InputError, match="a mode of bouncing-ball has no stiffness"):
        render.figure(ds, "impacts", overlay="grazing")


def test_a_grazing_line_of_unequal_stops_is_not_called_an_amplitude() -> None:
    ds = periodic_plane(SINGLE, {"omega": [0.5, 0.8, 1], "b": [0.5, 1, 2]})
    assert labels(render.figure(ds, "impacts", overlay="grazing"))[-1] == "impact-free motion\ngrazes a stop"


# Labels and shares


def test_an_upright_label_is_no_longer_than_its_axis() -> None:
    suspension = find_system("soft-suspension")
    ds = periodic_plane(suspension, {parameter: np.linspace(low, high, 4) for parameter, low, high in suspension.axes})
    ax = render.figure(ds, "period", width="5in", height="2.9in").axes[0]
    assert ax.yaxis.label.get_text() == "amplitude of the base, in units\nof the travel to a stop $a$"
    assert ax.yaxis.label.get_window_extent().height <= ax.bbox.height


def test_a_parameter_without_a_meaning_is_named_once() -> None:
    ds = periodic_plane(LOADED, {"A2": [0.0, 1.0], "omega": [0.5, 1.0]})
    ax = render.figure(ds, "period").axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$A_{2}$", r"forcing frequency $\omega$")


def test_shares_are_stacked_up_to_the_share_that_is_decided() -> None:
    share = np.array([[0.75, 0.25], [0.5, 0.375], [1.0, np.nan]])
    regime = np.array([[PERIODIC, CHAOTIC], [PERIODIC, CHAOTIC], [PERIODIC, PENDING]], np.int8)
    values = {"regime": regime, "share": share, "share_low": share - 0.1, "share_high": share + 0.1, "largest": -share}
    coords = {p.name: p.default for p in SINGLE.parameters} | {"omega": [1.0, 2.0, 3.0]}
    attrs = {"spec": json.dumps({"system": "single-mass"})}
    ds = xr.Dataset({name: (("omega", "attractor"), array) for name, array in values.items()}, coords, attrs)
    drawn = render.figure(ds, "coexistence")
    heights = (np.arange(80) + 0.5) / 80
    shown = [
        [layer.get_paths()[0].contains_points([(at, y) for y in heights]).mean() for layer in drawn.axes[1].collections]
        for at in (1.0, 2.0, 3.0)
    ]
    np.testing.assert_array_equal(shown, np.nan_to_num(share))
    assert drawn.axes[1].collections[1].get_paths()[0].contains_point((2.0, 0.51))
    assert drawn.axes[1].get_ylim() == (0.0, 1.0)
    assert labels(drawn)[-1] == "shares: 95 % interval\nwithin ± 0.10"


# The gap coordinate


def swept_section(system: System, **more: Any) -> xr.Dataset:
    size = len(system.states)
    section = np.broadcast_to(10.0 ** np.arange(size), (4, 3, size))
    return atlas_of(
        system, {"omega": [0.5, 0.6, 0.7, 0.8]}, regime=np.full(4, PERIODIC, np.int8), section=section, **more
    )


@pytest.mark.parametrize(
    ("name", "value", "label"),
    [
        ("impact-damper", 9.0, "gap coordinate\n$x_{2} - x_{1}$ at $t = kT$"),
        ("chain-3", 100.0, "displacement of mass 3\n$x_{3}$ at $t = kT$"),
        ("two-mass", 1.0, "displacement of mass 1\n$x_1$ at $t = kT$"),
        ("bouncing-ball", 1.0, "height above the table\n$y$ at $t = kT$"),
    ],
)
@pytest.mark.parametrize("against", [False, True])
def test_sweeps_draw_the_gap_coordinate_and_name_it(name: str, value: float, label: str, against: bool) -> None:
    ds = swept_section(find_system(name))
    ax = render.figure(ds, against=ds if against else None).axes[0]
    assert ax.get_ylabel() == label
    assert {float(y) for points in ax.lines for y in points.get_ydata()} == {value}


def test_a_gap_coordinate_that_depends_on_parameters_is_that_of_each_cell() -> None:
    table = {**DAMPER.table(), "gap": ["-ratio", 1.0]}
    table["parameters"] = {**table["parameters"], "ratio": {"default": 2.0}}
    geared = System.from_mapping({**table, "axes": {}})
    ds = swept_section(geared).drop_vars("ratio")
    ds = ds.rename(omega="ratio").assign_coords(ratio=[1.0, 2.0, 3.0, 4.0], omega=0.5)
    assert machine.gap_values(ds, "ratio", ds["section"]).tolist() == [[9.0] * 3, [8.0] * 3, [7.0] * 3, [6.0] * 3]
    assert text.gap_label(stored_system(ds.attrs)) == "gap coordinate\n$y$ at $t = kT$"


@pytest.mark.parametrize(
    ("row", "spelled"),
    [((-1.0, 1.0), "b - a"), ((1.0, 0.0), "a"), ((2.0, -0.5), r"2\,a - 0.5\,b"), ((-1.0, 0.0), "-a")],
)
def test_a_combination_is_spelled_as_it_would_be_by_hand(row: tuple[float, ...], spelled: str) -> None:
    assert text.combination(row, ("a", "b")) == spelled


# Portraits


CELLS = {
    "bouncing-ball": {"omega": 1.7, "R": 0.2},
    "single-mass": {"omega": 0.9, "A": 0.4, "b": 0.5},
    "impact-damper": {"omega": 1.0, "b": 3.0},
    "chain-8": {"omega": 0.4, "b": 0.3},
}


@pytest.fixture(scope="module")
def orbits() -> dict[str, CellTrajectory]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cell, "CONVERGENCE", (10,))
        return {name: cell_orbit(given, name) for name, given in CELLS.items()}


@pytest.mark.parametrize("name", CELLS)
def test_the_path_of_any_system_stays_in_its_gap_and_rebounds_on_its_stops(
    orbits: dict[str, CellTrajectory], name: str
) -> None:
    found = orbits[name]
    lower, upper = found.stops
    y, n = found.gap(found.states), found.gap_row.size
    rate = found.states[:, n:] @ found.gap_row
    assert lower - 1e-12 <= y.min() and y.max() <= upper + 1e-12
    jumps = np.flatnonzero(np.diff(found.times) == 0.0)
    assert len(jumps) == np.count_nonzero(found.impacts[:, 2]) > 0  # a row of speed 0 is where a rest begins
    assert rate[jumps + 1] == pytest.approx(-found.parameters["R"] * rate[jumps], rel=1e-9)
    assert np.minimum(np.abs(y[jumps] - lower), np.abs(y[jumps] - upper)).max() < 1e-12


@pytest.mark.parametrize(
    ("name", "rows", "stops"),
    [
        ("bouncing-ball", ["$y$"], [{0.0}]),
        ("single-mass", ["$x$"], [{0.5}]),
        ("impact-damper", ["$x_{2} - x_{1}$", "$x_{1}$"], [{-3.0, 3.0}, set()]),
        ("chain-8", ["$x_{1}$", "$x_{8}$"], [set(), {0.3}]),
    ],
)
def test_a_portrait_shows_what_the_stops_limit_with_its_stops(
    orbits: dict[str, CellTrajectory], name: str, rows: list[str], stops: list[set[float]]
) -> None:
    axes = render.figure(orbits[name]).axes[: len(rows)]
    assert [ax.get_ylabel() for ax in axes] == rows
    assert [{float(line.get_ydata()[0]) for line in ax.lines if line.get_linestyle() == "--"} for ax in axes] == stops


@pytest.mark.parametrize("width", ["85mm", "178mm"])
def test_sixteen_exponents_are_written_beside_each_other(orbits: dict[str, CellTrajectory], width: str) -> None:
    figure = render.figure(orbits["chain-8"], width=width)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[-1].texts]
    assert len(boxes) == 17
    assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1].padded(-1.5))]


def test_impacts_of_a_single_stop_are_not_told_apart(orbits: dict[str, CellTrajectory]) -> None:
    assert describe(orbits["chain-8"]) == "periodic, period 1, 2 impacts"
    assert "impacts 2 above and 2 below" in describe(orbits["impact-damper"])
