"""Claims about what a store has beside its cells: a byte flipped in any of its objects is found, named and mended.

Truth is the byte that was flipped. Tables and curves are made up; the cells are solved.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas.check.verify import verify
from atlas.errors import ChunkError, InputError
from atlas.orbits.curves.table import read_curves, write_curves
from atlas.orbits.labels.table import AttractorLabels, LabelCounts, stored_count, write_labels
from atlas.query.open import open_table
from atlas.robustness.table import LINEAR, StoredMeasures, empty, of_family, write_measures
from atlas.service.lease import LEASE_NAME
from atlas.service.progress import Progress
from atlas.store import create, store
from atlas.store.groups import ATTRACTORS, CURVES, LABELS, STABILITY, write_table
from atlas.store.parts import put_part
from atlas.store.schema import StoredArray
from atlas.store.sidecar import sidecar_of
from tests.corruption import flip
from tests.orbits.curves.test_curves_table import BOTH

pytestmark = pytest.mark.slow

STARTS = {"attractors": {"starts": 4}, "solve": {"exponents": "none"}}


@pytest.fixture(scope="module")
def whole(solved_plane: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solved plane with curves, measures, and a part of a search of both."""
    path = Path(shutil.copytree(solved_plane, tmp_path_factory.mktemp("groups") / "plane.zarr"))
    handle = store.open_store(path)
    write_curves(handle, BOTH)
    put_part(handle, CURVES, "seed-0", b'{"found": []}')
    write_measures(
        handle, StoredMeasures(empty(of_family(LINEAR), handle.spec.shape), {LINEAR: {"content": "", "norm": {}}})
    )
    put_part(handle, STABILITY, "linear-0.0-0", b"")
    return path


@pytest.fixture(scope="module")
def basins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of basins, none of its tiles solved, with a table of attractors."""
    spec = atlas.Spec("two-mass", {"x1": [0.0, 0.01], "v1": [0.0, 0.1]}, **STARTS)
    handle = create.create_store(tmp_path_factory.mktemp("basins") / "basins.zarr", spec, (2, 2))
    column = StoredArray(np.array([0.5, 0.25]), ("attractor",), {"long_name": "share", "units": "1"})
    points = StoredArray(np.arange(24.0).reshape(2, 3, 4), ("attractor", "point", "component"), {"units": "1"})
    write_table(handle, ATTRACTORS, {"share": column, "points": points}, {"title": "attractors by their labels"})
    return handle.path


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of all attractors, none of its tiles solved, with labels."""
    spec = atlas.Spec("two-mass", {"omega": [1.0, 2.0], "b": [0.1, 0.2]}, **STARTS)
    handle = create.create_store(tmp_path_factory.mktemp("labelled") / "labelled.zarr", spec, (2, 2))
    one = np.array([1], dtype=np.int64)
    names = ("regime", "period", "impacts_upper", "impacts_lower", "symmetric")
    labels = np.zeros((2, 2, spec.attractors.keep if spec.attractors else 0), dtype=np.int64)
    found = AttractorLabels(
        labels, one, np.array([1.0]), one, dict.fromkeys(names, one), LabelCounts(1, 1, 1, 1, 0, 0, 0, 0)
    )
    write_labels(handle, found)
    return handle.path


def faults(path: Path) -> list[str]:
    """All that is said to be wrong; of a store that cannot be read, why."""
    try:
        return [str(fault) for fault in verify(path, sample=0).faults]
    except InputError as error:
        assert str(path) in str(error)
        return [str(error)]


def copied(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / original.name))


def objects(path: Path) -> list[Path]:
    """One chunk of each array, and all metadata but the root's."""
    files = sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file())
    arrays = {file.parts[: file.parts.index("c")] if "c" in file.parts else file.parts: file for file in files}
    return [file for file in arrays.values() if str(file) != store.ROOT]


def test_stores_as_they_were_made_have_no_fault(whole: Path, basins: Path, labelled: Path) -> None:
    for path in (whole, basins, labelled):
        assert faults(path) == []


@pytest.mark.parametrize("which", ["whole", "basins", "labelled"])
def test_a_flipped_byte_is_found_in_every_object(which: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    path = copied(request.getfixturevalue(which), tmp_path)
    missed = []
    for k, file in enumerate(objects(path)):  # the first, a middle or the last byte in turn
        before = (path / file).read_bytes()
        byte = (0, len(before) // 2, len(before) - 1)[k % 3]
        flip(path / file, byte)
        if not faults(path):
            missed.append((str(file), byte))
        (path / file).write_bytes(before)
    assert missed == []


GROUPS = [
    ("whole", "curves/position/c/0/0", "atlas find curves {} makes it anew"),
    ("whole", "curves/zarr.json", "curves/zarr.json is damaged"),
    ("whole", "searches/parts/curves/seed-0", "parts/curves/seed-0 is damaged"),
    ("whole", "stability/reactivity/c/0/0", "atlas attractors measure {} makes it anew"),
    ("whole", "stability/zarr.json", "stability/zarr.json is damaged"),
    ("whole", "searches/parts/stability/linear-0.0-0", "parts/stability/linear-0.0-0 is damaged"),
    ("whole", "tiles/records/c.0.0.0", "tiles/records/c.0.0.0 is damaged"),
    ("whole", "tiles/records/zarr.json", "tiles/records/zarr.json is damaged"),
    ("basins", "attractors/share/c/0", "attractors/share/c/0 is damaged"),
    ("basins", "attractors/points/zarr.json", "attractors/points/zarr.json is"),
    ("basins", "attractors/zarr.json", "attractors/zarr.json is damaged"),
    ("labelled", "labels/label/c/0/0/0", "atlas attractors label {} makes it anew"),
    ("labelled", "labels/zarr.json", "labels/zarr.json is damaged"),
]


@pytest.mark.parametrize(("which", "key", "says"), GROUPS)
def test_damage_of_a_group_is_named_and_after_a_repair_gone(
    which: str, key: str, says: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    path = copied(request.getfixturevalue(which), tmp_path)
    flip(path / key, 0)
    assert any(says.format(path) in fault for fault in faults(path))
    assert verify(path, sample=0, repair=True).restored
    assert faults(path) == []


@pytest.mark.parametrize(
    ("which", "group"),
    [("whole", "curves"), ("whole", "stability"), ("labelled", "labels"), ("basins", "attractors")],
)
def test_a_group_whose_own_metadata_are_lost_has_them_again_after_a_repair(
    which: str, group: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    path = copied(request.getfixturevalue(which), tmp_path)
    before = (path / group / "zarr.json").read_bytes()
    (path / group / "zarr.json").unlink()
    assert faults(path) == [f"{group}/zarr.json is missing: atlas verify --repair {path} restores them"]
    verify(path, sample=0, repair=True)
    assert (path / group / "zarr.json").read_bytes() == before
    assert faults(path) == []


def test_a_damaged_record_of_a_machine_is_replaced_by_that_of_an_unknown_one(
    solved_plane: Path, tmp_path: Path
) -> None:
    path = copied(solved_plane, tmp_path)
    (record,) = (path / "hosts").glob("*/zarr.json")
    record.write_bytes(record.read_bytes().replace(b"numpy", b"numpi"))
    assert f"{record.relative_to(path)} is damaged" in faults(path)
    verify(path, sample=0, repair=True)
    assert not record.exists()
    report = verify(path, sample=1)
    assert (report.faults, report.comparison) == ((), "error")


@pytest.mark.parametrize("key", ["labels/label/c/0/0/0", "labels/label/zarr.json", "labels/zarr.json"])
def test_reading_damaged_labels_names_the_store_and_the_remedy(labelled: Path, tmp_path: Path, key: str) -> None:
    path = copied(labelled, tmp_path)
    flip(path / key, 0)
    with pytest.raises(ChunkError, match=rf"{path}: {key} is damaged .*: atlas attractors label {path} makes it anew"):
        atlas.open(path).label.load()
    # The group itself repeats the metadata of its arrays.
    assert (stored_count(store.open_store(path)) is None) == (key != "labels/label/zarr.json")


@pytest.mark.parametrize("lost", [True, False])
def test_reading_a_damaged_table_names_the_store_and_the_remedy(basins: Path, tmp_path: Path, lost: bool) -> None:
    path = copied(basins, tmp_path)
    chunk = path / "attractors/share/c/0"
    chunk.unlink() if lost else flip(chunk, 3)
    with pytest.raises(ChunkError, match=rf"{path}: attractors/share/c/0 is .*: atlas verify --repair {path}"):
        open_table(store.open_store(path), ATTRACTORS).load()


def test_damaged_curves_name_the_store_and_the_remedy(whole: Path, tmp_path: Path) -> None:
    path = copied(whole, tmp_path)
    flip(path / "curves/unstable/c/0", 3)
    with pytest.raises(ChunkError, match=rf"{path}: curves/unstable/c/0 is damaged .*: atlas find curves {path}"):
        read_curves(store.open_store(path))


def test_labels_that_lost_their_checksum_are_damaged(labelled: Path, tmp_path: Path) -> None:
    path = copied(labelled, tmp_path)
    root, own = (json.loads((path / key).read_text()) for key in ("zarr.json", "labels/zarr.json"))
    for group in (own, root["consolidated_metadata"]["metadata"][LABELS]):
        del group["attributes"]["checksum"], group["attributes"]["arrays"]
    (path / "zarr.json").write_text(json.dumps(root))
    (path / LABELS / "zarr.json").write_text(json.dumps(own))
    assert any(fault.startswith("labels/zarr.json is damaged") for fault in faults(path))


def test_a_repair_holds_the_claim_from_before_it_reads(whole: Path, tmp_path: Path) -> None:
    path, claims = copied(whole, tmp_path), []
    verify(
        path, sample=0, repair=True, on_progress=lambda _: claims.append(sidecar_of(path).get(LEASE_NAME) is not None)
    )
    assert claims and all(claims)
    assert sidecar_of(path).get(LEASE_NAME) is None


def test_verifying_without_a_repair_takes_no_claim(whole: Path, tmp_path: Path) -> None:
    path = copied(whole, tmp_path)

    def watch(_: Progress) -> None:
        assert sidecar_of(path).get(LEASE_NAME) is None

    assert verify(path, sample=0, on_progress=watch).faults == ()
