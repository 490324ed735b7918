"""Claims about a period in place of omega, defaults of constants, and initial values of other parameters.

The machine with omega and numbers has the same cells; the period doubling is a number of piecewise.json.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main as cli
from atlas.errors import InputError
from atlas.spec.equation import equation_of
from atlas.spec.json_schema import spec_schema
from atlas.spec.spec import Spec
from tests.paths import DATA
from tests.refusals import refuse
from workers import Settings, System, solve_tile
from workers.results import INVALID, OUT_OF_RANGE

QUICK = Settings(tolerance=0.1, max_periods=500, survival=0)
T = {"default": "2 * pi", "low": 0.0, "low_open": True}
WITH_PERIOD = {"period": "T", "parameters": {"T": T, "b": {"default": 0.9}, "x": "b - 1e-3", "v": "0.1 * omega"}}
WITH_OMEGA = {"parameters": {"b": {"default": 0.9}}}


def definition(**given: Any) -> dict[str, Any]:
    """A mass before a stop, forced by sin(omega t) + omega cos(3/2 omega t)."""
    table = {
        "name": "timed", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]],
        "harmonics": [{"order": 1, "force": [1.0]}, {"order": "3/2", "cosine": ["omega"]}],
        "gap": [1.0], "upper": "b", "restitution": 0.8,
    }  # fmt: skip
    return table | given


def machine(**given: Any) -> System:
    return System.from_mapping(definition(**given))


TIMED, COUNTED = machine(**WITH_PERIOD), machine(**WITH_OMEGA)
PERIODS = np.linspace(4.0, 9.0, 5)[None, :]
CLEARANCES = np.array([[0.5], [0.8]])


def test_cells_over_the_period_are_those_over_omega_to_the_bit() -> None:
    omega = 2.0 * math.pi / PERIODS
    timed = solve_tile(TIMED, {"T": PERIODS, "b": CLEARANCES}, QUICK)
    counted = solve_tile(COUNTED, {"omega": omega, "b": CLEARANCES, "x": CLEARANCES - 1e-3, "v": 0.1 * omega}, QUICK)
    for name in timed:
        assert timed[name].tobytes() == counted[name].tobytes(), name


def test_a_period_that_is_not_above_0_is_out_of_range() -> None:
    system = machine(period="T - 1", parameters={"T": {"default": 3.0}, "b": {"default": 0.9}})
    solved = solve_tile(system, {"T": np.array([-1.0, 1.0, 3.0])}, QUICK)
    assert solved["regime"].tolist()[:2] == [INVALID, INVALID] != solved["regime"].tolist()[1:]
    assert solved["reason"].tolist()[:2] == [OUT_OF_RANGE, OUT_OF_RANGE]


def test_a_branch_along_the_period_turns_where_the_one_along_omega_does() -> None:
    """Period doubling of the soft oscillator S: w = .915739816787582 (piecewise.json)."""
    contact = {"name": "stop", "gap": [1.0], "upper": 1.0, "stiffness": 29.0}
    (record,) = (one for one in json.loads((DATA / "piecewise.json").read_text()) if one["name"] == "row 2")
    system = System.from_mapping({
        "name": "soft", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.02]], "stiffness": [[1.0]],
        "force": ["0.8 * omega**2 / 1.26"], "phase": ["pi / 2"], "contacts": [contact], "period": "60 / n",
        "parameters": {"n": {"default": 60 * 0.95 / (2 * math.pi), "low": 0.0, "low_open": True},
                       "x": record["state"][0], "v": record["state"][1]},
    })  # fmt: skip
    found = atlas.branch(system=system, along="n", window=(60 * 0.9 / (2 * math.pi), 60 * 0.96 / (2 * math.pi)))
    events = found.events
    (turn,) = events[events["kind"] == "period_doubling"]["n"]
    assert turn == pytest.approx(60 * 0.915739816787582 / (2 * math.pi), rel=1e-11)


def test_the_equation_shows_the_period_and_the_list_the_formula(tmp_path: Path) -> None:
    assert "omega = 2 pi / T\nforcing period 4 pi / omega" in equation_of(TIMED)
    assert "omega = 2 pi / (60 / n)" in equation_of(machine(period="60 / n", parameters={"n": 9.0, "b": 0.9}))
    assert TIMED.unused_parameters == () and [p.name for p in TIMED.parameters] == ["T", "b", "tau", "x", "v"]
    assert (TIMED.parameter("x").default, TIMED.parameter("v").default) == (0.9 - 1e-3, 0.1)


def test_a_system_with_period_and_formulas_is_read_again_from_its_table() -> None:
    assert System.from_mapping(json.loads(json.dumps(TIMED.table()))) == TIMED


def test_another_formula_is_another_spec_and_other_words_are_the_same() -> None:
    axes, parameters = {"T": [5.0, 6.0]}, WITH_PERIOD["parameters"]
    other = machine(**WITH_PERIOD | {"parameters": parameters | {"x": "b - 2e-3"}})
    same = machine(**WITH_PERIOD | {"parameters": parameters | {"x": {"default": "b-1e-3", "meaning": "start"}}})
    assert Spec(other, axes).digest != Spec(TIMED, axes).digest == Spec(same, axes).digest


def test_an_initial_value_that_is_given_replaces_its_formula() -> None:
    spec = Spec(TIMED, {"T": [5.0, 6.0]}, {"x": 0.25})
    assert spec.parameters["x"] == 0.25 and "v" not in spec.parameters
    assert Spec.from_resolved(spec.to_resolved()).to_resolved() == spec.to_resolved()


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    path = tmp_path_factory.mktemp("timed") / "timed.zarr"
    axes = {"T": PERIODS[0].tolist(), "b": CLEARANCES[:, 0].tolist()}
    atlas.run(Spec(TIMED, axes, solve=QUICK), path, client)
    return path


def test_an_atlas_over_the_period_is_verified_queried_and_drawn(store: Path, tmp_path: Path) -> None:
    ds = atlas.open(store)
    assert ds.regime.dims == ("b", "T") and "omega" not in ds.coords and "x" not in ds.coords
    cell = ds.atlas.at(T=PERIODS[0, 1], b=0.8)
    alone = atlas.point(T=PERIODS[0, 1], b=0.8, system=TIMED, settings=QUICK)
    assert float(cell["largest"]) == alone["largest"]
    for words in (
        ["verify", store, "--sample", "4"],
        ["plot", store, "-o", tmp_path / "map.png", "--kind", "combined", "--overlay", "grazing"],
        ["portrait", store, "--at", f"T={PERIODS[0, 1]}", "--at", "b=0.8", "-o", tmp_path / "cell.png"],
    ):
        result = CliRunner().invoke(cli, [str(word) for word in words])
        assert result.exit_code == 0, result.output


def test_exponents_per_unit_time_divide_by_the_period_of_each_cell(store: Path) -> None:
    """The force of orders 1 and 3/2 repeats after 2 T."""
    ds = atlas.open(store).load()
    made = ds.atlas.per_unit_time().largest
    np.testing.assert_allclose(made.values, ds.largest.values / (2.0 * PERIODS), rtol=1e-14)


def test_constants_may_be_expressions_of_numbers() -> None:
    parameters = {"b": {"default": "sqrt(2) / 2", "low": "-pi", "high": "2 * pi"}, "tau": "pi / 2"}
    system = machine(parameters=parameters, axes={"omega": [1.0, "pi"]})
    b = system.parameter("b")
    assert (b.default, b.low, b.high) == (math.sqrt(2.0) / 2.0, -math.pi, 2.0 * math.pi)
    assert system.parameter("tau").default == math.pi / 2.0 and system.axes == (("omega", 1.0, math.pi),)


def test_the_schema_admits_a_period_and_expressions_as_defaults() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate({"system": TIMED.table(), "axes": {"T": [5.0, 6.0]}}, spec_schema())


WRONG = [
    ({"period": "T", "parameters": {"T": 1.0, "omega": 1.0, "b": 1.0}}, "system.parameters.omega: found beside system"),
    ({"period": "S", "parameters": {"T": 1.0, "b": 1.0}}, "system.period: unknown name 'S'; an entry knows neither"),
    ({"period": "omega", "parameters": {"b": 1.0}}, "system.period: unknown name 'omega'"),
    ({"period": "-b", "parameters": {"b": 1.0}}, "system.period: found -1 at the defaults, must be above 0 and finite"),
    ({"period": "1 / b", "parameters": {"b": 0.0}}, "system.period: found inf at the defaults, must be above 0 and"),
    ({"period": [1.0], "parameters": {"b": 1.0}}, "system.period: found [1.0], must be a number or an expression"),
    ({"period": "b", "harmonics": [], "parameters": {"b": 1.0}}, "system.period: found in a machine without a force"),
    ({"parameters": {"b": "k"}}, "system.parameters.b.default: unknown name 'k'; an entry knows neither time nor"),
    ({"parameters": {"b": "1 / 0"}}, "system.parameters.b.default: found inf, must be a finite number"),
    ({"parameters": {"b": 1.0, "x": "b - v"}}, "system.parameters.x.default: unknown name 'v'"),
    ({"parameters": {"b": 1.0, "x": "b -"}}, "system.parameters.x.default: found nothing after '-'"),
    ({"parameters": {"b": 1.0, "x": "log(b - 1)"}}, "system.parameters.x.default: found -inf at the defaults, must be"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), WRONG, ids=[message for _, message in WRONG])
def test_a_period_or_formula_that_is_wrong_gets_one_line(changes: dict[str, Any], message: str) -> None:
    refuse(definition(**changes), message)


def test_omega_of_a_machine_with_a_period_is_refused_with_its_period() -> None:
    with pytest.raises(InputError, match="'omega': in system 'timed' it is 2 pi / period, with the period T"):
        atlas.point(omega=1.0, system=TIMED)
