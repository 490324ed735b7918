"""The values of a store's axes are in its coordinates alone: how they are read, checked, and made again."""

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import ChunkError, InputError
from atlas.spec.axis import Axis, StoredAxis
from atlas.store import create, store
from atlas.store.object_backend import LocalBackend
from tests.planes import plane_of
from tests.synthetic import respare

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
    changed = replace(axis, **other)
    assert axis != changed
    assert StoredAxis(axis.outline(), lambda: {"omega": axis.values}) == axis
    assert StoredAxis(changed.outline(), lambda: {changed.name: changed.values}) != axis


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


def test_the_attributes_do_not_grow_with_the_axes(tmp_path: Path) -> None:
    omega = np.sort(np.random.default_rng(0).uniform(2.0, 4.0, 100_000))
    spec = atlas.Spec("two-mass", {"omega": omega, "b": {"start": 0.1, "stop": 0.5, "num": 100_000}})
    handle = create.create_store(tmp_path / "a.zarr", spec, (512, 512))
    assert json.loads(json.loads((handle.path / "zarr.json").read_text())["attributes"]["spec"])["axes"] == [
        {"name": "omega", "scale": "linear", "start": omega[0], "stop": omega[-1], "num": 100_000},
        {"name": "b", "scale": "linear", "start": 0.1, "stop": 0.5, "num": 100_000},
    ]
    assert (handle.path / "zarr.json").stat().st_size < 62_000


@pytest.mark.parametrize("spec", [plane_of(), LISTED, TABLE], ids=["plane", "list", "points"])
def test_no_coordinate_is_read_before_its_values_are_asked_for_and_then_each_once(
    spec: atlas.Spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create.create_store(tmp_path / "a.zarr", spec, tile_of(spec))
    asked = []
    opened = zarr.open_array

    def noted(*args: Any, **options: Any) -> Any:
        asked.append(options["path"])
        return opened(*args, **options)

    monkeypatch.setattr(zarr, "open_array", noted)
    place = Counted(tmp_path / "a.zarr")
    handle = store.open_store(place)
    cheap = (
        handle.spec.shape,
        handle.spec.dims,
        handle.spec.axis_descriptions,
        handle.variables,
        store.done_tiles(handle),
    )
    assert cheap[0] == spec.shape
    assert (asked, place.read) == ([], ["zarr.json", "regime/zarr.json", "component/spare"])  # type: ignore[attr-defined]
    assert handle.spec.cell_params(tuple(slice(0, 1) for _ in spec.shape))["omega"] == 2.0
    assert handle.spec.axes == spec.axes and handle.spec.digest == handle.digest
    assert asked == ["omega", "b"]


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


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_evenly_spaced_axes_are_made_again_to_the_bit(
    tmp_path: Path, damage: Callable[[Path], None], scale: str
) -> None:
    axes = {"omega": {"start": 2.1, "stop": 4.0, "num": 7, "scale": scale}, "b": [0.1, 0.15, 0.3]}
    spec = atlas.Spec("two-mass", axes)
    path = create.create_store(tmp_path / "a.zarr", spec, (2, 3)).path
    whole = (path / "omega/c/0").read_bytes()
    damage(path / "omega/c/0")
    assert store.open_store(path).spec.axes[0].values == spec.axes[0].values
    (fault,) = verify(path, repair=True).faults
    assert str(fault).startswith("coordinate omega is ")
    assert (path / "omega/c/0").read_bytes() == whole
    assert verify(path).faults == ()


@pytest.mark.parametrize("key", ["omega/c/0", "omega/zarr.json", "omega/copy"])
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
@pytest.mark.parametrize("spec", [LISTED, TABLE], ids=["list", "points"])
def test_listed_values_outlive_damage_to_one_of_their_two_copies(
    spec: atlas.Spec, damage: Callable[[Path], None], key: str, tmp_path: Path
) -> None:
    path = create.create_store(tmp_path / "a.zarr", spec, spec.shape).path
    whole = {path / name: (path / name).read_bytes() for name in ("omega/c/0", "omega/copy")}
    damage(path / key)
    values = store.open_store(path).spec.cell_params(tuple(slice(None) for _ in spec.shape))["omega"]
    assert np.ravel(values).tolist() == [2.0, 2.5, 3.9]
    assert len(verify(path, repair=True).faults) == 1
    assert verify(path).faults == ()
    assert {file: file.read_bytes() for file in whole} == whole


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("spec", [LISTED, TABLE], ids=["list", "points"])
def test_listed_values_of_which_both_copies_are_damaged_are_refused_in_one_line(
    spec: atlas.Spec, damage: str, tmp_path: Path, client: Client
) -> None:
    path = create.create_store(tmp_path / "a.zarr", spec, spec.shape).path
    for key in ("omega/c/0", "omega/copy"):
        (path / key).unlink() if damage == "is missing" else (path / key).write_bytes(b"damaged")
    with pytest.raises(ChunkError, match=rf"^{path}: omega {damage}"):
        store.open_store(path).spec.cell_params(tuple(slice(0, 1) for _ in spec.shape))
    (fault,) = verify(path, repair=True).faults
    assert str(fault).startswith(f"coordinate omega {damage}") and str(fault).endswith(": it cannot be computed again")
    ended = CliRunner().invoke(main, ["verify", str(path)])
    assert (ended.exit_code, type(ended.exception)) == (1, SystemExit)


def test_evenly_spaced_axes_have_no_copy(tmp_path: Path) -> None:
    path = create.create_store(tmp_path / "a.zarr", LISTED, (2, 3)).path
    assert [key.parent.name for key in path.rglob("copy")] == ["omega"]


def test_values_that_were_exchanged_for_others_are_not_used(tmp_path: Path) -> None:
    path = create.create_store(tmp_path / "a.zarr", LISTED, (2, 3)).path
    (path / "omega/copy").write_bytes(np.array([2.0, 2.7, 3.9]).tobytes())
    zarr.open_group(path, mode="r+", use_consolidated=False)["omega"][1] = 2.6
    with pytest.raises(ChunkError, match="has a digest that does not match the spec and its coordinates"):
        _ = store.open_store(path).spec.axes[0].values
    assert [str(fault) for fault in verify(path).faults] == ["zarr.json: the digest does not match the spec"]


@pytest.mark.parametrize("key", ["start", "stop"])
def test_an_end_that_is_not_that_of_the_coordinate_is_found(tmp_path: Path, key: str) -> None:
    path = create.create_store(tmp_path / "a.zarr", plane_of(), (2, 3)).path
    right = plane_of().outline()["axes"][0][key]
    change_spec(path, lambda spec: spec["axes"][0].update({key: 2.5}))
    (fault,) = verify(path).faults
    assert str(fault).startswith(f"zarr.json has attribute spec.axes[0].{key} 2.5, must be {right}: ")
    respare(path)
    assert store.open_store(path).spec.axes[0].values == plane_of().axes[0].values
    assert [str(fault) for fault in verify(path).faults] == ["zarr.json: axis omega differs from its coordinate"]


def test_a_parameter_that_was_changed_in_the_attributes_is_found_before_a_value_is_used(tmp_path: Path) -> None:
    path = create.create_store(tmp_path / "a.zarr", plane_of(), (2, 3)).path
    change_spec(path, lambda spec: spec["parameters"].update(R=0.5))
    respare(path)
    with pytest.raises(ChunkError, match="has a digest that does not match the spec"):
        store.open_store(path).spec.cell_params((slice(0, 1), slice(0, 1)))


@pytest.mark.parametrize("wrong", [{"num": 8}, {"num": "7"}, {"start": None}, {"scale": "cubic"}, {"name": "omgea"}])
def test_a_wrong_outline_is_refused_in_one_line(tmp_path: Path, wrong: dict[str, Any]) -> None:
    path = create.create_store(tmp_path / "a.zarr", plane_of(), (2, 3)).path
    change_spec(path, lambda spec: spec["axes"][0].update(wrong))
    respare(path)
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
