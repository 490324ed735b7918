"""Stores given as objects: obstore stores, URLs with storage options, and any Zarr store for reading.

Truth: the same store by its path or its URL.
"""

import pickle
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
import zarr.storage
from click.testing import CliRunner
from distributed import Client
from obstore import store as obstores
from zarr.abc.store import ByteRequest, Store
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.core.sync import sync

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.query.resample import read_view
from atlas.query.store_block import find_part
from atlas.store.access import StorageAccess, access_by
from atlas.store.backend import StoreBackend
from atlas.store.object_backend import LocalBackend, ObjectBackend, open_backend
from atlas.store.zarr_backend import ZarrBackend
from tests.object_server import BUCKET, object_server
from tests.planes import plane_of
from tests.synthetic import complete

SECRET = "a-secret-that-nobody-may-see"
KEYS = (("ACCESS_KEY_ID", "me"), ("SECRET_ACCESS_KEY", SECRET))


SPEC = """
system = "two-mass"
[axes]
omega = { start = 2.0, stop = 4.0, num = 7 }
b = { start = 0.1, stop = 0.5, num = 5 }
[solve]
max_periods = 500
tolerance = 0.1
section_samples = 2
"""
"""The spec of ``plane_of``."""


class Session(Store):
    """A Zarr store of somebody else's, such as a session's: with what Zarr asks of a store and no more."""

    supports_writes = supports_deletes = supports_listing = True

    def __init__(self, objects: dict[str, bytes]) -> None:
        super().__init__(read_only=False)
        self.objects = objects

    def __eq__(self, other: object) -> bool:
        return self is other

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        memory: Any = zarr.storage.MemoryStore({k: prototype.buffer.from_bytes(v) for k, v in self.objects.items()})
        found: Buffer | None = await memory.get(key, prototype, byte_range)
        return found

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    async def exists(self, key: str) -> bool:
        return key in self.objects

    async def set(self, key: str, value: Buffer) -> None:
        raise AssertionError(f"wrote {key}")

    async def delete(self, key: str) -> None:
        raise AssertionError(f"removed {key}")

    async def list(self) -> AsyncIterator[str]:
        for key in self.objects:
            yield key

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        for key in self.objects:
            if key.startswith(prefix):
                yield key

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        begin = f"{prefix}/".lstrip("/")
        for name in {key.removeprefix(begin).partition("/")[0] for key in self.objects if key.startswith(begin)}:
            yield name


def objects_of(path: Path) -> dict[str, bytes]:
    place = LocalBackend(path)
    return place.get_all(place.list_keys())


def memory(objects: dict[str, bytes]) -> Any:
    made = zarr.storage.MemoryStore()
    for key, data in objects.items():
        sync(made.set(key, default_buffer_prototype().buffer.from_bytes(data)))
    return made


def obstore_memory(objects: dict[str, bytes]) -> Any:
    made = obstores.MemoryStore()
    for key, data in objects.items():
        made.put(key, data)
    return made


MAKERS: dict[str, Any] = {
    "zarr.storage.MemoryStore": memory,
    "zarr.storage.ObjectStore": lambda objects: zarr.storage.ObjectStore(obstore_memory(objects)),
    "obstore.store.MemoryStore": obstore_memory,
    "a store of somebody else's": Session,
}


@pytest.fixture(params=MAKERS)
def given(request: pytest.FixtureRequest, solved_plane: Path) -> Any:
    """The solved plane in an object of each kind."""
    return MAKERS[request.param](objects_of(solved_plane))


def same(one: Any, other: Any) -> bool:
    return all(one[name].identical(other[name]) for name in other.variables) and set(one) == set(other)


def test_an_atlas_in_a_zarr_store_is_read_as_from_its_folder(given: Any, solved_plane: Path) -> None:
    ds, truth = atlas.open(given), atlas.open(solved_plane)
    assert same(ds, truth)
    assert ds.atlas.fractions().to_dict() == truth.atlas.fractions().to_dict()
    assert ds.atlas.at(omega=3.0, b=0.3).identical(truth.atlas.at(omega=3.0, b=0.3))
    assert same(deepcopy(ds), truth)
    assert str(atlas.status(given)) == str(atlas.status(solved_plane))


def test_a_part_of_it_has_the_overviews_of_its_store(tmp_path: Path) -> None:
    handle = complete(tmp_path / "a.zarr")
    given = memory(objects_of(handle.path))
    parts = [atlas.open(place).isel(omega=slice(3, 40)) for place in (given, handle.path)]
    assert all(find_part(part, ["largest"]) for part in parts)
    coarse, truth = (read_view(part, ["largest"], pixels=(8, 8)) for part in parts)
    assert coarse.encoding["level"] > 0 and same(coarse, truth)


def test_a_zarr_store_is_verified_and_packed_and_never_written(given: Any, solved_plane: Path, tmp_path: Path) -> None:
    assert atlas.verify(given, sample=0).chunks == atlas.verify(solved_plane, sample=0).chunks
    atlas.pack(given, tmp_path / "a.zip")
    assert same(atlas.open(tmp_path / "a.zip"), atlas.open(solved_plane))
    for write in (lambda: atlas.run(plane_of(), given), lambda: atlas.verify(given, repair=True)):
        with pytest.raises(InputError, match=r"a Zarr store object is read-only; give a path or a URL$"):
            write()


@pytest.mark.parametrize("ask", [atlas.open, atlas.status, lambda given: atlas.verify(given, sample=0)])
def test_a_zip_store_that_nobody_has_opened_is_read(solved_plane: Path, tmp_path: Path, ask: Any) -> None:
    atlas.pack(solved_plane, tmp_path / "a.zip")
    given, whole = zarr.storage.ZipStore(tmp_path / "a.zip", mode="r"), ask(solved_plane)
    found = ask(given)
    given.close()
    assert type(found) is type(whole)


def test_a_zip_store_that_cannot_be_opened_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"nothing")
    for name in ("a.zip", "none.zip"):
        with pytest.raises(InputError, match="cannot be opened: "):
            atlas.status(zarr.storage.ZipStore(tmp_path / name, mode="r"))


def test_what_is_no_store_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="no such store"):
        atlas.open(zarr.storage.MemoryStore())
    with pytest.raises(InputError, match=r"^found 3, must be a path, a URL, an obstore store or a Zarr store$"):
        atlas.open(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is the whole disk"):
        atlas.open(obstores.LocalStore())


def test_an_obstore_store_of_a_folder_is_that_folder(solved_plane: Path) -> None:
    assert open_backend(obstores.LocalStore(solved_plane)) == LocalBackend(solved_plane)


# Servers


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """How an S3 server is reached, of which the environment says nothing."""
    with object_server(tmp_path_factory.mktemp("s3")) as found, pytest.MonkeyPatch.context() as patch:
        for name in found:
            patch.delenv(name, raising=False)
        yield {
            "endpoint": found["AWS_ENDPOINT_URL"],
            "access_key_id": found["AWS_ACCESS_KEY_ID"],
            "secret_access_key": found["AWS_SECRET_ACCESS_KEY"],
            "region": found["AWS_REGION"],
        }


@pytest.mark.slow
def test_an_atlas_is_computed_and_extended_by_storage_options_and_read_as_an_object(
    server: dict[str, str], client: Client, solved_plane: Path, tmp_path: Path
) -> None:
    words = {"endpoint": server["endpoint"], "key": "any", "secret": "any", "region": "us-east-1"}
    url, finer = f"s3://{BUCKET}/options/plane.zarr", f"s3://{BUCKET}/options/finer.zarr"
    assert atlas.run(plane_of(), url, client, storage_options=words).tiles_done == 9
    truth = atlas.open(solved_plane)
    assert same(atlas.open(url, storage_options=words), truth)
    assert atlas.status(url, storage_options=words).fraction == 1.0
    assert atlas.verify(url, sample=0, storage_options=words).is_sound
    assert atlas.pack(url, tmp_path / "plane.zip", storage_options=words).is_complete
    assert atlas.extend(url, finer, refine=2, client=client, storage_options=words).failures == ()
    again = url.replace("plane", "again")
    assert atlas.retry(url, again, "chaotic", survival=100_000, client=client, storage_options=words).failures == ()
    assert atlas.open(again, storage_options=words).atlas.fractions().to_dict().keys() >= {"periodic"}
    given = obstores.S3Store(BUCKET, prefix="options/plane.zarr", client_options={"allow_http": True}, **server)
    ds = atlas.open(given)
    assert same(ds, truth) and ds.atlas.fractions().to_dict() == truth.atlas.fractions().to_dict()
    assert atlas.status(given).fraction == 1.0 and atlas.verify(given, sample=0).is_sound


def test_the_store_that_cells_are_taken_from_is_reached_as_the_new_one_or_refused(
    server: dict[str, str], solved_plane: Path
) -> None:
    new = obstores.S3Store(BUCKET, prefix="other/plane.zarr", client_options={"allow_http": "true"}, **server)
    for old in (memory(objects_of(solved_plane)), Session(objects_of(solved_plane))):
        with pytest.raises(InputError, match=r"workers reach it in the same way|must be a path, file:// or one of"):
            atlas.extend(old, new, refine=2)


def test_an_atlas_is_computed_into_an_obstore_store_and_resumed_by_its_url(
    server: dict[str, str], client: Client, solved_plane: Path
) -> None:
    given = obstores.S3Store(BUCKET, prefix="object/plane.zarr", client_options={"allow_http": "true"}, **server)
    assert atlas.run(plane_of(), given, client).tiles_done == 9
    url = f"s3://{BUCKET}/object/plane.zarr"
    assert atlas.run(plane_of(), url, client, storage_options=server).cells_solved == 0
    assert same(atlas.open(url, storage_options=server), atlas.open(solved_plane))


def test_a_command_reaches_a_url_by_its_storage_options_and_only_that_command(
    server: dict[str, str], client: Client, solved_plane: Path, tmp_path: Path
) -> None:
    url = f"s3://{BUCKET}/command/plane.zarr"
    atlas.run(plane_of(), url, client, storage_options=server)
    options = [word for pair in server.items() for word in ("--storage-option", "=".join(pair))]
    (tmp_path / "plane.toml").write_text(SPEC)
    for words in (
        ["status", url],
        ["query", url],
        ["plot", url, "-o", str(tmp_path / "a.png")],
        ["compare", str(solved_plane), url],
        ["run", str(tmp_path / "plane.toml"), "-o", url],
        ["explore", url, "-o", str(tmp_path / "a.html")],
    ):
        ended = CliRunner().invoke(main, [*words, *options], catch_exceptions=False)
        assert ended.exit_code == 0, (words, ended.output)
    assert open_backend(url) == ObjectBackend(url)


@pytest.mark.parametrize(("given", "says"), [("anon", "must be NAME=VALUE"), ("anon=1 anon=0", "given twice")])
def test_a_storage_option_that_makes_no_sense_is_one_line(given: str, says: str) -> None:
    words = [word for option in given.split() for word in ("--storage-option", option)]
    ended = CliRunner().invoke(main, ["status", "s3://public/plane.zarr", *words])
    assert (ended.exit_code, says in ended.output) == (2, True)


@contextmanager
def requests() -> Iterator[tuple[str, list[str | None]]]:
    """A server that has nothing; its address, and the signature of each request that it has had, None without."""
    seen: list[str | None] = []

    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            seen.append(self.headers.get("Authorization"))
            self.send_response(404)
            self.send_header("Content-Length", "0")
            self.end_headers()

        do_GET = do_HEAD = answer

        def log_message(self, *words: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}", seen
        server.shutdown()


@pytest.mark.parametrize("word", ["anon", "anonymous", "skip_signature"])
def test_requests_to_a_public_bucket_are_not_signed(word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, secret in KEYS:
        monkeypatch.setenv(f"AWS_{name}", secret)
    for value, signed in ((False, True), (True, False)):
        with requests() as (endpoint, seen), pytest.raises(InputError, match="no such store"):
            atlas.open("s3://public/plane.zarr", storage_options={"endpoint": endpoint, word: value})
        assert seen and all((signature is not None) == signed for signature in seen)


def test_a_command_reads_a_public_bucket_by_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    with requests() as (endpoint, seen):
        for name, value in (("ENDPOINT", endpoint), ("SKIP_SIGNATURE", "true"), *KEYS):
            monkeypatch.setenv(f"AWS_{name}", value)
        shown = CliRunner().invoke(main, ["query", "s3://public/plane.zarr"])
    assert (shown.exit_code, seen) == (2, [None] * len(seen)) and seen
    assert shown.stderr == "Error: s3://public/plane.zarr: no such store\n"


def test_a_place_crosses_to_workers_with_its_access_and_never_shows_it() -> None:
    url = "s3://bucket/plane.zarr"
    options = {"secret": SECRET, "key": "k", "client_options": {"default_headers": {"x-team": SECRET}}}
    place = open_backend(url, storage_options=options)
    assert isinstance(place, ObjectBackend)
    again = pickle.loads(pickle.dumps(place))
    assert (again, hash(again)) == (place, hash(place)) and again != open_backend(url)
    assert again.client.config["secret_access_key"] == SECRET
    shown = [repr(place), str(place), repr(atlas.RunOptions(storage_options=options))]
    assert not [text for text in shown if SECRET in text]


@pytest.mark.parametrize(
    ("made", "url"),
    [
        (lambda: obstores.S3Store("b", prefix="a/p.zarr", region="x"), "s3://b/a/p.zarr"),
        (lambda: obstores.GCSStore("b", prefix="p.zarr", skip_signature=True), "gs://b/p.zarr"),
        (lambda: obstores.AzureStore("c", prefix="p.zarr", account_name="a", skip_signature=True), "az://c/p.zarr"),
        (lambda: obstores.HTTPStore("https://host/p.zarr/"), "https://host/p.zarr"),
    ],
)
def test_an_obstore_store_of_a_server_has_its_url_and_its_settings(made: Any, url: str) -> None:
    given = made()
    place: StoreBackend = open_backend(given)
    assert isinstance(place, ObjectBackend) and str(place) == url
    kept = getattr(given, "config", {})
    assert {name: getattr(place.client, "config", {}).get(name) for name in kept} == kept


@pytest.mark.parametrize(
    ("store", "options", "message"),
    [
        ("plane.zarr", {"anon": True}, "storage_options: need a URL, found 'plane.zarr'"),
        ("file:///tmp/plane.zarr", {"anon": True}, "storage_options: need a server, found file://"),
        ("s3://b/p", ["anon"], "storage_options: found ['anon'], must be settings by name, such as anon=True"),
        ("s3://b/p", {"anon": True, "skip_signature": True}, "storage_options: skip_signature and another name of"),
        ("s3://b/p", {"secret": [SECRET]}, "storage_options: secret: must be a text, a number, or true or false"),
        ("s3://b/p", {"client_options": 3}, "storage_options: client_options: found 3, must be settings by name"),
        (
            "s3://b/p",
            {"colour": "red"},
            "s3://b/p: not a valid location for a store: Configuration key: 'colour' is not valid",
        ),
        (
            "gs://b/p",
            {"secret": SECRET},
            "gs://b/p: not a valid location for a store: Configuration key: 'secret' is not valid",
        ),
    ],
)
def test_bad_options_get_one_line_without_a_secret(store: str, options: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        atlas.open(store, storage_options=options)
    text = str(caught.value)
    assert text.startswith(message) and "\n" not in text and SECRET not in text


def test_credentials_that_cannot_be_sent_to_workers_are_refused(server: dict[str, str], client: Client) -> None:
    def provider() -> dict[str, Any]:  # a function of a function cannot be pickled
        return {"access_key_id": "any", "secret_access_key": "any", "expires_at": None}

    options = {"endpoint": server["endpoint"], "region": "us-east-1", "credential_provider": provider}
    with pytest.raises(InputError, match="its credential_provider cannot be sent to workers"):
        atlas.run(plane_of(), f"s3://{BUCKET}/unsent/plane.zarr", client, storage_options=options)


def test_two_objects_are_two_places() -> None:
    one, other = memory({}), memory({})
    assert ZarrBackend(one) == ZarrBackend(one) != ZarrBackend(other)
    assert access_by({"anon": True}, "gs://b") == StorageAccess((("skip_signature", True),))
    assert np.unique([hash(ZarrBackend(one)), hash(ZarrBackend(one))]).size == 1
