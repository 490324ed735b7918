"""What is read of a store: once when it is opened, and by whom it is read again.

Truth: the store's own objects, counted as they are asked for, by its place and by Zarr.
"""

import pickle
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import atlas
from atlas.errors import InputError
from atlas.overview.pyramid import Pyramid, pyramid_of
from atlas.query.open import handle_of
from atlas.store import handle_cache
from atlas.store.backend import LocalBackend
from atlas.store.create import create_store
from atlas.store.schema import SPEC_KEY
from atlas.store.store import AtlasStore, open_store
from atlas.store.zarr_store import BackendStore
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob, run_tile_job
from tests.planes import plane_of

ROOT, METADATA = "zarr.json", "regime/zarr.json"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[tuple[str, str]]]:
    """How often each object of any store was read ("get") or looked for ("exists") by its place."""
    counts: Counter[tuple[str, str]] = Counter()

    def counting(name: str) -> None:
        whole = getattr(LocalBackend, name)

        def call(place: LocalBackend, key: str, *part: slice | None) -> object:
            counts[name, key] += 1
            return whole(place, key, *part)

        monkeypatch.setattr(LocalBackend, name, call)

    for name in ("get", "exists"):
        counting(name)
    yield counts


def of_metadata(counts: Counter[tuple[str, str]]) -> Counter[tuple[str, str]]:
    return Counter({(how, key): count for (how, key), count in counts.items() if key.endswith("zarr.json")})


def test_a_tile_reads_the_attributes_of_the_root_twice_and_no_other_metadata(
    tmp_path: Path, asked: Counter[tuple[str, str]]
) -> None:
    """Before it is solved and before it is written; after the first tile of a process, which has read the handle."""
    handle = create_store(tmp_path / "plane.zarr", plane_of(), (2, 3))
    job = RunJob((0, 0), StoreRef(handle.backend, handle.run_id, handle.solver_version))
    run_tile_job(job)
    asked.clear()
    run_tile_job(replace(job, index=(1, 1)))
    assert of_metadata(asked) == {("get", SPEC_KEY): 2}


QUESTIONS: dict[str, Callable[[Any], object]] = {
    "fractions": lambda of: of.fractions(),
    "reasons": lambda of: of.count_reasons(),
    "extremes": lambda of: of.extremes("largest"),
    "regions": lambda of: of.regions(),
    "labels": lambda of: of.labels(),
    "boundary": lambda of: of.boundary("periodic"),
    "plot": lambda of: of.plot(),
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_to_a_dataset_looks_at_its_store_by_one_object_and_opens_it_no_second_time(
    finished: Path, asked: Counter[tuple[str, str]], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    keys, whole = list[str](), BackendStore.get

    async def get(store: BackendStore, key: str, *given: object, **named: object) -> object:
        keys.append(key)
        return await whole(store, key, *given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(BackendStore, "get", get)
    ds = atlas.open(finished)
    ds.atlas.fractions().to_dict()  # the first question opens the overviews
    asked.clear()
    keys.clear()
    QUESTIONS[question](ds.atlas)
    assert of_metadata(asked) == {("get", SPEC_KEY): 1}
    assert ROOT not in keys and "overviews/zarr.json" not in keys
    for ask in QUESTIONS.values():
        ask(ds.atlas)
    assert max(Counter(key for key in keys if key.endswith(ROOT)).values(), default=0) <= 1


def test_a_store_is_read_by_one_object_when_it_is_opened(finished: Path, asked: Counter[tuple[str, str]]) -> None:
    handle = open_store(finished)
    assert of_metadata(asked) == {("get", ROOT): 1}
    asked.clear()
    atlas.open(handle)
    assert of_metadata(asked) == {("get", "stability/zarr.json"): 1}


def test_a_run_of_a_finished_store_reads_its_header_once(finished: Path, asked: Counter[tuple[str, str]]) -> None:
    """And looks at the root once more, behind the claim."""
    atlas.run(plane_of(), finished)
    assert asked["get", METADATA] == 0


def test_only_jobs_that_write_cells_open_the_arrays_of_cells_for_writing(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handle_cache, "_handles", {})
    handle = open_store(finished)
    site = StoreRef(handle.backend, handle.run_id, handle.solver_version)
    handle = site.open()
    assert handle.spec and "arrays" not in handle.cache


def test_what_jobs_open_for_writing_is_opened_once(tmp_path: Path) -> None:
    handle = create_store(tmp_path / "plane.zarr", plane_of(), (2, 3))
    job = RunJob((0, 0), StoreRef(handle.backend, handle.run_id, handle.solver_version))
    assert job.handle().arrays is replace(job, index=(1, 1)).handle().arrays


@pytest.mark.parametrize("through", [lambda ds: ds, lambda ds: ds.isel(omega=slice(2, 5)), deepcopy])
def test_a_dataset_finds_what_was_read_of_its_store(finished: Path, through: object) -> None:
    handle = open_store(finished)
    assert handle_of(through(atlas.open(handle))) is handle  # type: ignore[operator]


def test_a_dataset_that_plain_xarray_opened_finds_its_store_by_name_and_run(finished: Path) -> None:
    import xarray as xr

    assert handle_of(xr.open_zarr(finished)) == open_store(finished)


def test_a_dataset_whose_store_has_been_replaced_is_told_so(finished: Path) -> None:
    ds = atlas.open(finished)
    shutil.rmtree(finished)
    create_store(finished, plane_of(), (2, 3))
    with pytest.raises(InputError, match="the store was replaced after this dataset was opened; open it again"):
        handle_of(ds)


def test_a_dataset_sees_what_its_store_has_got_since(tmp_path: Path) -> None:
    """As the overviews that a run makes after the store."""
    spec = atlas.Spec("two-mass", {"omega": {"start": 2.0, "stop": 4.0, "num": 200}, "b": [0.1, 0.2]})
    ds = atlas.open(create_store(tmp_path / "plane.zarr", spec, (2, 64)))
    assert not pyramid_of(handle_of(ds)).exists
    Pyramid(open_store(tmp_path / "plane.zarr")).create()
    assert pyramid_of(handle_of(ds)).exists


def test_a_header_that_is_sent_takes_along_nothing_that_it_has_opened(finished: Path) -> None:
    handle = open_store(finished)
    assert handle.arrays and handle.spec
    sent: AtlasStore = pickle.loads(pickle.dumps(handle))
    assert sent == handle
    assert not sent.cache
    assert sent.spec == handle.spec


def test_zarr_reads_the_root_of_a_store_once_when_it_is_opened_as_a_dataset(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys, whole = list[str](), BackendStore.get

    async def get(store: BackendStore, key: str, *given: object, **named: object) -> object:
        keys.append(key)
        return await whole(store, key, *given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(BackendStore, "get", get)
    atlas.open(finished)
    assert keys.count(ROOT) <= 1
