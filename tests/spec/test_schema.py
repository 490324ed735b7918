"""What is added to results, parameters and settings later leaves stores from before as they are, and the reverse."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.spec.resolved import resolved_digest, unpack_axes
from tests.planes import plane_of
from tests.synthetic import change_attributes
from workers import Settings


@pytest.fixture
def store(finished: Path) -> Path:
    return finished


def remove_from_spec(store: Path, table: str, name: str) -> None:
    """Make the store one from before there was that setting or parameter."""

    def change(attributes: dict[str, Any]) -> None:
        spec = json.loads(attributes["spec"])
        del spec[table][name]
        attributes |= {"spec": json.dumps(spec), "digest": resolved_digest(unpack_axes(spec))}

    change_attributes(store, change)


def is_completed(store: Path, client: Client) -> bool:
    """Whether a store that has lost a tile is resumed by a spec of today, and sound after it."""
    (store / "regime" / "c" / "1" / "1").unlink()
    return atlas.run(plane_of(), store, client=client).tiles_solved == 1 and verify(store).is_sound


def test_a_store_without_a_result_of_its_spec_is_damaged(store: Path) -> None:
    shutil.rmtree(store / "state")
    assert any("state/zarr.json is missing" in str(fault) for fault in verify(store, sample=0).faults)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["max_period", "survival"])
def test_a_store_from_before_there_was_a_setting_is_sound_and_can_be_completed(
    store: Path, client: Client, name: str
) -> None:
    remove_from_spec(store, "solve", name)
    assert verify(store).is_sound
    assert is_completed(store, client)


@dataclass(frozen=True)
class LaterSettings(Settings):
    """Settings with one that was added."""

    patience: int = 5


def test_a_setting_added_later_changes_a_digest_only_where_it_is_not_at_its_default() -> None:
    resolved = plane_of().to_resolved()
    before = resolved_digest(resolved)
    with_default, with_another = (resolved | {"solve": resolved["solve"] | {"patience": n}} for n in (5, 6))
    assert resolved_digest(with_default, LaterSettings) == before
    assert resolved_digest(with_another, LaterSettings) != before
