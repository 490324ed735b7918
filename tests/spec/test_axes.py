"""The values of a store's axes are in its coordinates alone: how they are read, checked, and made again."""

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zarr
from click.testing import CliRunner

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.spec.axis import Axis
from atlas.store import create, store
from atlas.store.object_backend import LocalBackend
from tests.planes import plane_of
from tests.synthetic import change_attributes

DIGESTS = {
    "plane": "a07830e9a9b7ad28233fb7721af0d5d942a9e1eb70637aa9268e041ac55926a8",
    "points": "4e28a2e493c45132ccf889e6d4244b2be70d1d4bcd306a70f533180ae74e2180",
    "continued": "ce3815665b01988d2cf1a23a6904afca948d1095a26bb119e3ab416c6b9a2270",
}
"""Of format version 2."""
SOLVE = {"max_periods": 500, "tolerance": 0.1}
LISTED = atlas.Spec("two-mass", {"omega": [2.0, 2.5, 3.9], "b": {"start": 0.1, "stop": 0.4, "num": 2}}, solve=SOLVE)
TABLE = atlas.Spec("two-mass", points={"omega": [2.0, 2.5, 3.9], "b": [0.1, 0.3, 0.2]}, solve=SOLVE)


def specs() -> dict[str, atlas.Spec]:
    log = {"start": 0.1, "stop": 1, "num": 4, "scale": "log", "continuation": "forward"}
    return {
        "plane": plane_of(),
        "points": atlas.Spec("two-mass", points={"omega": [2.0, 3.0], "b": [0.1, 0.2]}),
        "continued": atlas.Spec("two-mass", {"omega": {"start": 2, "stop": 4, "num": 5}, "b": log}),
    }


@pytest.fixture(params=[*DIGESTS])
def spec(request: pytest.FixtureRequest) -> atlas.Spec:
    return specs()[request.param]


def tile_of(spec: atlas.Spec) -> tuple[int, ...]:
    return (2, 3) if spec.continuation is None and len(spec.shape) == 2 else spec.shape


@pytest.mark.parametrize(
    "other",
    [
        {"values": (1.0, 2.5, 3.0)}, {"values": (1.0, 2.0)}, {"name": "b"}, {"scale": "log"},
        {"continuation": "forward"},
    ],
)  # fmt: skip
def test_axes_that_differ_in_a_value_or_a_word_are_not_equal(other: dict[str, Any]) -> None:
    axis = Axis("omega", (1.0, 2.0, 3.0))
    assert axis != replace(axis, **other)


class Counted(LocalBackend):
    """A folder that notes which objects are read as they are."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        object.__setattr__(self, "read", [])

    def get(self, key: str) -> bytes | None:
        self.read.append(key)  # type: ignore[attr-defined]
        return super().get(key)


@pytest.mark.parametrize("name", [*DIGESTS])
def test_a_spec_has_the_digest_that_it_had_when_its_store_had_its_values_as_attributes(name: str) -> None:
    assert specs()[name].digest == DIGESTS[name]


def test_a_store_has_the_values_of_its_spec_to_the_bit(spec: atlas.Spec, tmp_path: Path) -> None:
    found = create.create_store(tmp_path / "a.zarr", spec, tile_of(spec)).spec
    assert found == atlas.Spec.from_resolved(spec.to_resolved())
    assert (found.digest, [axis.values for axis in found.axes]) == (spec.digest, [axis.values for axis in spec.axes])
    assert (found.axis_descriptions, found.shape, dict(found.points)) == (
        spec.axis_descriptions,
        spec.shape,
        dict(spec.points),
    )


def test_the_attributes_do_not_grow_with_an_evenly_spaced_axis(tmp_path: Path) -> None:
    spec = atlas.Spec("two-mass", {"omega": [2.0, 3.5, 3.9], "b": {"start": 0.1, "stop": 0.5, "num": 100_000}})
    handle = create.create_store(tmp_path / "a.zarr", spec, (512, 512))
    assert json.loads(handle.attributes["spec"])["axes"] == [
        {"name": "omega", "scale": "linear", "values": [2.0, 3.5, 3.9]},
        {"name": "b", "scale": "linear", "start": 0.1, "stop": 0.5, "num": 100_000},
    ]
    assert handle.spec.axes == spec.axes


@pytest.mark.parametrize("spec", [plane_of(), LISTED, TABLE], ids=["plane", "list", "points"])
def test_a_store_opened_by_one_object_knows_all_values(spec: atlas.Spec, tmp_path: Path) -> None:
    create.create_store(tmp_path / "a.zarr", spec, tile_of(spec))
    place = Counted(tmp_path / "a.zarr")
    handle = store.open_store(place)
    assert handle.spec.axes == spec.axes and handle.spec.digest == handle.digest
    assert place.read == ["zarr.json"]  # type: ignore[attr-defined]


def test_a_spec_of_a_store_can_be_sent_elsewhere(tmp_path: Path) -> None:
    for spec, name in ((plane_of(), "a"), (TABLE, "b")):
        found = create.create_store(tmp_path / f"{name}.zarr", spec, tile_of(spec)).spec
        again = pickle.loads(pickle.dumps(found))
        assert (again, again.digest) == (found, spec.digest)


# Damage


def flipped(chunk: Path) -> None:
    data = bytearray(chunk.read_bytes())
    data[6] ^= 0x10
    chunk.write_bytes(data)


DAMAGE = {"is damaged": flipped, "is missing": Path.unlink}


@pytest.mark.parametrize("key", ["omega/c/0", "omega/zarr.json", "zarr.json", "spec/zarr.json"])
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
@pytest.mark.parametrize("spec", [plane_of(), LISTED, TABLE], ids=["plane", "list", "points"])
def test_damaged_values_of_an_axis_are_written_again_to_the_bit(
    spec: atlas.Spec, damage: Callable[[Path], None], key: str, tmp_path: Path
) -> None:
    path = create.create_store(tmp_path / "a.zarr", spec, tile_of(spec)).path
    whole = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    damage(path / key)
    (fault,) = verify(path, repair=True).faults
    assert str(fault).startswith(f"{key} ")
    assert verify(path).faults == ()
    assert {file: file.read_bytes() for file in whole} == whole


def test_cells_are_placed_by_the_spec_whatever_a_coordinate_holds(tmp_path: Path) -> None:
    path = create.create_store(tmp_path / "a.zarr", LISTED, (2, 3)).path
    zarr.open_group(path, mode="r+", use_consolidated=False)["omega"][1] = 2.6
    assert atlas.open(path)["omega"].values.tolist() == [2.0, 2.5, 3.9]
    assert [str(fault).partition(":")[0] for fault in verify(path).faults] == ["omega/c/0 is damaged or another chunk"]


def test_a_parameter_that_was_changed_in_the_attributes_is_found_before_a_value_is_used(tmp_path: Path) -> None:
    path = create.create_store(tmp_path / "a.zarr", plane_of(), (2, 3)).path
    change_spec(path, lambda spec: spec["parameters"].update(R=0.5))
    with pytest.raises(InputError, match=r"zarr.json is damaged \(its checksum is wrong\): atlas verify --repair"):
        store.open_store(path)
    assert verify(path, repair=True).restored == ("zarr.json written again",)
    assert store.open_store(path).spec.digest == plane_of().digest


@pytest.mark.parametrize("wrong", [{"num": "7"}, {"start": None}, {"scale": "cubic"}, {"name": "omgea"}])
def test_a_spec_that_cannot_be_read_is_refused_in_one_line(tmp_path: Path, wrong: dict[str, Any]) -> None:
    path = create.create_store(tmp_path / "a.zarr", plane_of(), (2, 3)).path

    def change(attributes: dict[str, Any]) -> None:
        spec = json.loads(attributes["spec"])
        spec["axes"][0].update(wrong)
        attributes["spec"] = json.dumps(spec)

    change_attributes(path, change)
    ended = CliRunner().invoke(main, ["status", str(path)])
    assert ended.exit_code == 2 and len(ended.stderr.splitlines()) <= 3 and f"{path}: its " in ended.stderr


def change_spec(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    root = json.loads((path / "zarr.json").read_text())
    spec = json.loads(root["attributes"]["spec"])
    change(spec)
    root["attributes"]["spec"] = json.dumps(spec)
    (path / "zarr.json").write_text(json.dumps(root))


# From a dataset


def test_an_opened_atlas_gives_its_spec(spec: atlas.Spec, tmp_path: Path) -> None:
    path = create.create_store(tmp_path / "a.zarr", spec, tile_of(spec)).path
    assert atlas.Spec.from_dataset(atlas.open(path)).digest == spec.digest


def test_an_exported_atlas_gives_its_spec_too(finished: Path, tmp_path: Path) -> None:
    import xarray as xr

    from atlas.query.export import export

    export(atlas.open(finished), tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as ds:
        assert atlas.Spec.from_dataset(ds).digest == plane_of().digest


def test_a_part_of_an_atlas_gives_none(finished: Path) -> None:
    with pytest.raises(InputError, match="lacks cells of its atlas"):
        atlas.Spec.from_dataset(atlas.open(finished).isel(omega=slice(3)))
    with pytest.raises(InputError, match="lacks the spec"):
        atlas.Spec.from_dataset(atlas.open(finished).drop_attrs())


def test_a_store_is_copied_with_its_axes(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished, tmp_path / "copy.zarr")
    assert store.open_store(tmp_path / "copy.zarr").spec == store.open_store(finished).spec


@pytest.mark.parametrize("given", [(1, 4, 40), (1.0, 4.0)])
def test_a_tuple_that_may_be_meant_as_ends_is_no_axis(given: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"axes.omega: found the tuple .*must be a list of values, or a table with st"):
        atlas.Spec("two-mass", {"omega": given})
