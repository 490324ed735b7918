"""Claims about a system that a user defines: atlases of it are made, checked, asked and drawn, from the store alone.

The machine is the two-mass oscillator under other names, whose numbers are known.
"""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main as cli
from atlas.errors import InputError
from atlas.spec.resolved import resolved_digest
from atlas.spec.spec import Spec
from atlas.spec.system import parse_system
from atlas.store import create
from atlas.store.store import open_store
from tests.workers.model.test_systems import MACHINE, table
from workers import System, solve_tile, trace
from workers.model.system import find_system, identity

SPEC = """
system = "machine.toml"
[axes.omega]
start = 2.0
stop = 4.0
num = 4
[axes.d]
start = 0.1
stop = 0.4
num = 3
[solve]
tolerance = 0.1
max_periods = 1000
survival = 0
[store]
tile = [2, 2]
"""
LIKE = SPEC.replace("machine.toml", "two-mass").replace("axes.d", "axes.b") + "[parameters]\ntau = 0.0\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    """A store of the machine, and one of the two-mass oscillator with the same numbers. The machine's file is gone."""
    made = tmp_path_factory.mktemp("own")
    (made / "machine.toml").write_text(MACHINE)
    (made / "spec.toml").write_text(SPEC)
    (made / "like.toml").write_text(LIKE)
    for name in ("spec", "like"):
        atlas.run(Spec.from_toml(made / f"{name}.toml"), made / f"{name}.zarr", client)
    (made / "machine.toml").unlink()
    (made / "spec.toml").write_text(SPEC.replace('system = "machine.toml"\n', "") + MACHINE)
    return made


@pytest.fixture
def store(folder: Path) -> Path:
    return folder / "spec.zarr"


def call(*args: object) -> Result:
    return CliRunner().invoke(cli, [str(arg) for arg in args])


def test_its_numbers_are_those_of_the_packaged_system_to_the_bit(folder: Path) -> None:
    own, like = (atlas.open(folder / f"{name}.zarr").load() for name in ("spec", "like"))
    assert own.regime.dims == ("d", "omega")
    assert set(own.data_vars) == set(like.data_vars)
    for name in own.data_vars:
        assert own[name].values.tobytes() == like[name].values.tobytes(), name


def test_its_states_and_parameters_are_those_of_the_definition(store: Path) -> None:
    ds = atlas.open(store)
    assert ds.component.values.tolist() == ["p", "q", "u", "w"]
    assert ds.z.attrs == {"long_name": "z", "symbol": r"\zeta", "units": "1"}
    assert ds.d.attrs["long_name"] == "clearance"
    assert "two masses between stops" in ds.attrs["title"]


def test_the_store_has_the_whole_definition(store: Path) -> None:
    kept = json.loads(atlas.open(store).attrs["spec"])["system"]
    assert System.from_mapping(kept) == System.from_toml(MACHINE)
    assert open_store(store).spec.system_def == System.from_toml(MACHINE)


def test_verify_solves_a_sample_of_it_from_the_store_alone(store: Path) -> None:
    report = verify(store, sample=6)
    assert (report.tiles_done, report.cells_solved, report.faults, report.doubts) == (4, 6, (), ())


def test_a_spec_with_the_definition_in_it_is_the_same_and_resumes_the_store(
    folder: Path, store: Path, client: Client
) -> None:
    spec = Spec.from_toml(folder / "spec.toml")
    assert spec.digest == open_store(store).digest
    summary = atlas.run(spec, store, client)
    assert summary.cells_solved == 0


def test_another_definition_under_the_name_is_refused_with_what_differs(store: Path, client: Client) -> None:
    other = System.from_mapping(table(stiffness=[[1.0, -1.0], [-1.0, "1.5 + k"]]))
    stored = open_store(store).spec
    with pytest.raises(InputError, match="system machine is defined differently in the store: stiffness"):
        atlas.run(Spec(other, {a.name: a for a in stored.axes}, stored.parameters, stored.settings), store, client)


def test_other_words_are_the_same_system(store: Path) -> None:
    stored = open_store(store).spec
    worded = System.from_mapping(table(title="another title", source="a book"))
    assert Spec(worded, {a.name: a for a in stored.axes}, stored.parameters, stored.settings).digest == stored.digest


def test_it_is_queried_drawn_and_extended(store: Path, tmp_path: Path, client: Client) -> None:
    ds = atlas.open(store)
    assert float(ds.atlas.at(omega=2.0, d=0.1)["d"]) == pytest.approx(0.1)
    assert ds.atlas.per_unit_time().largest.attrs["long_name"] == "largest Lyapunov exponent per unit time"
    figure = ds.atlas.plot(overlay="grazing")
    assert "clearance" in figure.axes[0].get_ylabel()
    asked = call("query", store, "--at", "omega=2.0", "--at", "d=0.1", "--json")
    assert asked.exit_code == 0, asked.output
    drawn = call("plot", store, "-o", tmp_path / "map.png")
    assert drawn.exit_code == 0, drawn.output
    atlas.extend(store, tmp_path / "fine.zarr", refine={"omega": 2}, client=client)
    assert atlas.open(tmp_path / "fine.zarr").omega.size == 7


def test_its_portrait_is_drawn_from_the_store_alone(store: Path, tmp_path: Path) -> None:
    figure = atlas.open(store).atlas.portrait(path=tmp_path / "cell.png", omega=4.0, d=0.1)
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert "$p$" in labels and "$q$" in labels
    assert (tmp_path / "cell.png").exists()


def test_two_systems_of_one_name_are_not_compared(store: Path) -> None:
    one = atlas.open(store)
    spec = json.loads(one.attrs["spec"])
    spec["system"] = System.from_mapping(table(load=[0.5, 0.0])).table()
    with pytest.raises(InputError, match="both are called machine, but their definitions differ"):
        one.atlas.compare(one.assign_attrs(spec=json.dumps(spec)))


def test_solve_tile_and_trace_take_a_system(folder: Path) -> None:
    own = System.from_toml(MACHINE)
    here = {"omega": 3.0, "tau": 0.0}
    found, wanted = solve_tile(own, here | {"d": 0.2}), solve_tile("two-mass", here | {"b": 0.2})
    assert all(found[name].tobytes() == wanted[name].tobytes() for name in wanted)
    states = trace(own, here | {"d": 0.2}, 3).states
    assert states.tobytes() == trace("two-mass", here | {"b": 0.2}, 3).states.tobytes()


def test_commands_take_the_path_of_a_system(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    shown = call("systems", tmp_path / "machine.toml")
    assert (shown.exit_code, "machine: two masses between stops" in shown.output) == (0, True)
    solved = call("point", "--system", tmp_path / "machine.toml", "--set", "d=0.6", "--json")
    assert solved.exit_code == 0, solved.output
    assert json.loads(solved.stdout)["system"]["name"] == "machine"


def test_a_system_that_is_wrong_ends_a_command_in_one_line_and_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE.replace('"1 + k"', '"1 + kk"'))
    (tmp_path / "spec.toml").write_text(SPEC)
    ended = call("run", tmp_path / "spec.toml", "-o", tmp_path / "out.zarr")
    assert ended.exit_code == 2 and not (tmp_path / "out.zarr").exists()
    assert "machine.toml: system.stiffness[1][1]: unknown name 'kk'; did you mean 'k'?" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_a_spec_survives_json_and_pickle_with_its_system() -> None:
    spec = Spec(System.from_toml(MACHINE), {"omega": [2.0, 3.0]})
    assert Spec.from_resolved(json.loads(json.dumps(spec.to_resolved()))) == spec
    assert pickle.loads(pickle.dumps(spec)) == spec


def test_a_packaged_system_enters_a_digest_by_its_name_alone_in_its_first_version() -> None:
    spec = Spec("two-mass", {"omega": [2.0, 3.0]})
    assert spec.to_resolved()["system"] == "two-mass"
    assert "system_version" not in spec.to_resolved()


def test_a_later_version_of_a_packaged_system_has_another_digest_and_is_not_taken_for_the_first() -> None:
    later = replace(find_system("two-mass"), version=2)
    resolved = Spec("two-mass", {"omega": [2.0, 3.0]}).to_resolved() | later.to_resolved()
    assert resolved_digest(resolved) != Spec("two-mass", {"omega": [2.0, 3.0]}).digest
    assert identity(later.to_resolved()) == {"system": "two-mass", "system_version": 2}
    with pytest.raises(InputError, match="system: found two-mass of version 2, installed is version 1"):
        Spec.from_resolved(resolved)


def test_a_path_in_a_store_is_not_followed(tmp_path: Path) -> None:
    """A store names packaged systems only: it may come from anywhere, and a path of another machine means nothing."""
    (tmp_path / "machine.toml").write_text(MACHINE)
    resolved = Spec("two-mass", {"omega": [2.0, 3.0]}).to_resolved() | {"system": str(tmp_path / "machine.toml")}
    with pytest.raises(InputError, match="unknown system"):
        Spec.from_resolved(resolved)


def test_an_example_that_describes_its_own_system_has_its_name_and_others_have_none() -> None:
    own = parse_system("shaken-base")
    assert (own.name, own.title) == ("shaken-base", "mass on a shaken base with a fixed stop")
    assert Spec.from_toml("shaken-base").system_def == own
    with pytest.raises(InputError, match="unknown system 'fig6'"):
        parse_system("fig6")


LONG = "1" + "+k" * 149  # 299 characters, 599 with blanks


def test_a_long_expression_without_blanks_makes_a_store_that_is_read(tmp_path: Path) -> None:
    spec = Spec(System.from_toml(MACHINE.replace('"1 + k"', f'"{LONG}"')), {"omega": [2.0, 3.0]})
    assert atlas.plan(spec, probe=False).tiling.cells == 2
    create.create_store(tmp_path / "out.zarr", spec, (2,))
    assert open_store(tmp_path / "out.zarr").spec == spec
    assert verify(tmp_path / "out.zarr", sample=0).faults == ()


def test_a_spec_whose_store_could_not_be_read_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    machine = replace(System.from_toml(MACHINE), name="no name")
    spec = Spec(machine, {"omega": [2.0, 3.0]})
    for use in (lambda: atlas.plan(spec, probe=False), lambda: atlas.run(spec, tmp_path / "out.zarr")):
        with pytest.raises(InputError, match=r"a store of this spec could not be read: system.name: found 'no name'"):
            use()
    assert not list(tmp_path.iterdir())
