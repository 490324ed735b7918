"""Stores of machines that report something of their own: written, mapped, verified, asked, and with all attractors."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import atlas
from atlas import render
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.spec.spec import Spec
from atlas.spec.system import impacts_of
from tests.workers.cell.test_measures import ONE_MASS, SOFT
from workers import System, solve_tile
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import find_system
from workers.results import CHAOTIC, PERIODIC
from workers.settings import Settings

SOLVE = {"exponents": "none", "max_periods": 2000, "survival": 0}
PLANE = {
    "system": ONE_MASS,
    "axes": {"omega": {"start": 1.0, "stop": 2.0, "num": 4}, "stop": {"start": 0.3, "stop": 3.0, "num": 3}},
    "solve": SOLVE,
    "store": {"tile": [3, 4]},
}


@pytest.fixture(scope="module")
def store(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """A plane of a rigid machine with measures."""
    return solved_once(Spec.from_mapping(PLANE))


def test_a_store_holds_measures_with_their_words(store: Path) -> None:
    ds = atlas.open(store)
    assert ds["damper_power"].attrs["long_name"] == "mean power of velocity damper"
    assert ds["place_rms"].shape == (3, 4)
    known = ds["regime"].values <= CHAOTIC
    assert known.any() and np.isfinite(ds["place_rms"].values[known]).all()


def test_a_store_keeps_what_defines_its_measures(store: Path) -> None:
    spec = Spec.from_dataset(atlas.open(store))
    assert spec.system_def == System.from_mapping(ONE_MASS)
    assert spec.digest == Spec.from_mapping(PLANE).digest


def test_measures_enter_a_digest_and_none_leave_it_as_it_was() -> None:
    bare = {key: value for key, value in ONE_MASS.items() if key != "measures"}
    digests = [Spec.from_mapping(PLANE | {"system": system}).digest for system in (ONE_MASS, bare)]
    assert digests[0] != digests[1]
    assert digests[1] == Spec.from_mapping(PLANE | {"system": bare | {"measures": {}}}).digest


def test_a_measure_is_mapped_by_its_name(store: Path) -> None:
    figure = render.figure(atlas.open(store), variable="place_rms")
    assert figure.axes[1].get_ylabel() == "root mean square of displacement place"


def test_a_store_with_measures_is_sound_and_its_cells_are_solved_again_to_the_bit(store: Path) -> None:
    report = verify(store, sample=4)
    assert not report.faults and (report.cells_solved, report.comparison) == (4, "bits")


def test_a_point_tells_its_measures() -> None:
    told = CliRunner().invoke(main, ["point", "--system", "energy-sink", "--set", "omega=1.3", "--json"])
    assert told.exit_code == 0, told.output
    found = json.loads(told.stdout)
    A, w, m, c = (
        0.03,
        1.3,
        0.02,
        2 * 0.02 * 0.02,
    )  # without impact: two masses, of which a damper alone joins the second
    matrix = np.array([[1.0 - w * w + 1j * w * (0.01 + c), -1j * w * c], [-1j * w * c, -m * w * w + 1j * w * c]])
    x = np.linalg.solve(matrix, [A, 0.0])
    assert found["regime"] == "no_impact"
    assert found["main_rms"] == pytest.approx(abs(x[0]) * np.sqrt(0.5), rel=1e-12)
    assert found["main_peak"] == pytest.approx(abs(x[0]), rel=1e-12)
    assert found["sink_power"] == pytest.approx(c * w * w * abs(x[0] - x[1]) ** 2 / 2.0, rel=1e-12)


TWO_WALLS = SOFT | {
    "contacts": [
        {"name": "wall", "gap": [1.0], "upper": 1.0, "stiffness": 10.0},
        {"name": "floor", "gap": [1.0], "lower": -0.4, "restitution": 0.5},
    ]
}


def test_an_orbit_of_several_contacts_is_named_by_the_counts_of_each() -> None:
    system = System.from_mapping(TWO_WALLS)
    cell = {name: values.tolist() for name, values in solve_tile(system, {}, Settings(**SOLVE)).items()}
    assert (cell["regime"], cell["wall_upper"], cell["floor_lower"]) == (PERIODIC, 1, 2)
    assert (cell["impacts_upper"], cell["impacts_lower"]) == (1, 2)
    assert impacts_of(system, cell) == "1-0/0-2"
    assert impacts_of(system, cell | {"floor_lower": -1}) == "sticks"
    assert impacts_of(find_system("two-mass"), {"impacts_upper": 2, "impacts_lower": 3}) == "2-3"


def test_friction_that_sticks_leaves_contacts_to_be_counted() -> None:
    rubs = [{"name": "ground", "row": [1.0], "kinetic": 0.3, "static": 1.5}]
    system = System.from_mapping(SOFT | {"friction": rubs})
    cell = {name: values.tolist() for name, values in solve_tile(system, {"omega": 0.5}, Settings(**SOLVE)).items()}
    assert cell["regime"] == PERIODIC and 0.0 < cell["ground_stuck"] < 1.0
    assert (cell["impacts_upper"], cell["impacts_lower"]) == (cell["wall_upper"], cell["wall_lower"])
    assert impacts_of(system, cell) == f"{cell['wall_upper']}-{cell['wall_lower']}" and cell["wall_upper"] >= 1


@pytest.mark.slow
@pytest.mark.parametrize("definition", [SOFT, ONE_MASS], ids=["soft", "rigid"])
def test_each_attractor_has_the_measures_of_a_cell_that_reaches_it(definition: dict[str, object]) -> None:
    system, settings = System.from_mapping(definition), Settings(**SOLVE)
    many = solve_attractors(system, {"omega": 1.4}, settings, AttractorSettings(4))
    one = solve_tile(system, {"omega": 1.4}, settings)
    own = {v.name for v in system.variables(settings)} - {v.name for v in System.from_mapping(
        {key: value for key, value in ONE_MASS.items() if key != "measures"}).variables(settings)}  # fmt: skip
    assert own
    for name in own:
        assert many[name][many["own_attractor"]] == pytest.approx(one[name], rel=1e-9, abs=1e-9), name
