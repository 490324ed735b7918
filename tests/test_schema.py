"""What is added to results, parameters and settings later leaves stores from before as they are, and the reverse."""

import json
import shutil
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.errors import InputError
from atlas.service.extend import extend
from atlas.spec.resolved import resolved_digest, with_values
from atlas.store.record import COVERED, RECORD
from atlas.store.store import read_header
from atlas.store.tiles import put_record, read_tile, record_of
from tests.planes import find, plane_of
from tests.synthetic import change_root, remove_arrays, respare
from workers import Settings


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    path = tmp_path_factory.mktemp("schema") / "plane.zarr"
    atlas.run(plane_of(), path, client=client)
    return path


@pytest.fixture
def store(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "plane.zarr"))


def remove_from_spec(store: Path, table: str, name: str) -> None:
    """Make the store one from before there was that setting or parameter."""

    values = read_header(store).values

    def change(root: dict[str, Any]) -> None:
        outline = json.loads(root["attributes"]["spec"])
        del outline[table][name]
        digest = resolved_digest(with_values(outline, values))
        root["attributes"] |= {"spec": json.dumps(outline), "digest": digest}

    change_root(store, change)


def is_completed(store: Path, client: Client) -> bool:
    """Whether a store that has lost a tile is resumed by a spec of today, and sound after it."""
    (store / "regime" / "c" / "1" / "1").unlink()
    return atlas.run(plane_of(), store, client=client).tiles_solved == 1 and verify(store).fine


@pytest.mark.slow
@pytest.mark.parametrize("name", ["min_impact_speed", "state", "largest", "period", "stuck_fraction", "survived"])
def test_a_store_from_before_there_was_a_result_is_sound_and_can_be_completed(
    store: Path, client: Client, name: str
) -> None:
    remove_arrays(store, name)
    assert verify(store).fine
    assert name not in atlas.open(store)
    assert is_completed(store, client)
    assert not (store / name).exists()


def test_cells_of_a_store_from_before_there_was_a_result_are_not_copied(store: Path, tmp_path: Path) -> None:
    remove_arrays(store, "state")
    with pytest.raises(InputError, match="too old, it has no state: compute the new atlas by atlas run"):
        extend(store, tmp_path / "new.zarr", refine=2)


def test_a_result_whose_metadata_are_gone_is_missing_where_there_are_chunks_of_it(store: Path) -> None:
    kept = store.parent / "c"
    shutil.copytree(store / "state" / "c", kept)
    remove_arrays(store, "state")
    shutil.copytree(kept, store / "state" / "c")
    assert [str(fault) for fault in verify(store).faults] == ["state/zarr.json is missing"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["max_period", "survival"])
def test_a_store_from_before_there_was_a_setting_is_sound_and_can_be_completed(
    store: Path, client: Client, name: str
) -> None:
    remove_from_spec(store, "solve", name)
    assert verify(store).fine
    assert is_completed(store, client)


def test_a_store_from_before_there_was_a_parameter_is_sound_and_can_be_completed(store: Path, client: Client) -> None:
    remove_arrays(store, "f2")
    remove_from_spec(store, "parameters", "f2")
    assert verify(store).fine
    assert "f2" not in atlas.open(store).coords
    assert is_completed(store, client)


@dataclass(frozen=True)
class LaterSettings(Settings):
    """Settings with one that was added."""

    patience: int = 5


def test_a_setting_added_later_changes_a_digest_only_where_it_is_not_at_its_default() -> None:
    resolved = plane_of().resolved()
    before = resolved_digest(resolved)
    with_default, with_another = (resolved | {"solve": resolved["solve"] | {"patience": n}} for n in (5, 6))
    assert resolved_digest(with_default, LaterSettings) == before
    assert resolved_digest(with_another, LaterSettings) != before


@pytest.fixture
def newer(store: Path) -> Path:
    """A store that a later version made, with a result that is unknown here and enters the digests."""
    group: Any = zarr.open_group(store, mode="r+", use_consolidated=False)
    like = group["largest"]
    added = group.create_array(
        "later", shape=like.shape, chunks=like.chunks, dtype="float32", dimension_names=("b", "omega")
    )
    added[...] = 1.5
    group[RECORD].attrs[COVERED] = [*group[RECORD].attrs[COVERED], "later"]
    with warnings.catch_warnings(action="ignore"):  # Zarr's, that consolidated metadata are an extension
        zarr.consolidate_metadata(store)
    respare(store)
    header = read_header(store)
    for tile in header.tiling.tiles():
        later = {"later": np.full(tile.shape, 1.5, "float32")}
        put_record(header, tile.index, record_of(header, tile.index, read_tile(header, tile.index) | later))
    return store


def test_a_newer_store_with_an_unknown_result_opens_and_is_sound(newer: Path) -> None:
    ds = atlas.open(newer)
    assert (ds.later.values == 1.5).all()
    assert ds.atlas.fractions()
    assert verify(newer).fine


def test_damage_to_an_unknown_result_is_found(newer: Path) -> None:
    zarr.open_group(newer, mode="r+", use_consolidated=False)["later"][0, 0] = 2.5  # type: ignore[index]
    assert [fault.tile for fault in verify(newer, sample=0).faults] == [(0, 0)]


def test_a_newer_store_with_an_unknown_result_is_not_resumed(newer: Path) -> None:
    with pytest.raises(InputError, match="has later, unknown to this version"):
        find(newer, plane_of())
