import os
import sys
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.extend import extend
from atlas.service.status import read_status
from atlas.store import create, store
from atlas.store import object_backend as placing
from atlas.store.metadata import unsealed
from atlas.store.object_backend import LocalBackend, ObjectBackend, StoreBackend, open_backend
from atlas.store.schema import SPEC_KEY
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import open_store
from atlas.store.tile_records import forget_records
from atlas.store.tiles import drop_tile
from tests.object_server import BUCKET, object_server
from tests.planes import find, plane_of
from workers.settings import MAX_PERIODS


@pytest.fixture(scope="module")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The URL of a bucket on a real S3 server, and the environment by which obstore finds it."""
    with (
        object_server(tmp_path_factory.mktemp("s3")) as environment,
        pytest.MonkeyPatch.context() as patch,
    ):
        for name, value in environment.items():
            patch.setenv(name, value)
        yield f"s3://{BUCKET}"


@pytest.fixture(params=["local", "s3"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> StoreBackend:
    """An empty place of each kind."""
    name = f"{tmp_path.name}/plane.zarr"
    if request.param == "s3":
        return open_backend(f"{request.getfixturevalue('bucket')}/{name}")
    return open_backend(str(tmp_path / "plane.zarr"))


def arrays_of(where: Any) -> dict[str, bytes]:
    ds = atlas.open(where)
    return {str(name): ds[name].values.tobytes() for name in ds.variables}


def test_each_kind_of_place_has_its_class(place: StoreBackend, request: pytest.FixtureRequest) -> None:
    kinds = {"local": LocalBackend, "s3": ObjectBackend}
    assert type(place) is kinds[request.node.callspec.params["place"]]


def test_what_is_put_can_be_got_listed_and_removed(place: StoreBackend) -> None:
    assert (place.get("a/b/c"), place.exists("a/b/c"), list(place.list_keys())) == (None, False, [])
    place.put("a/b/c", b"one")
    place.put("a/d", b"two")
    place.put("a/d", b"three")
    assert (place.get("a/b/c"), place.get("a/d"), place.exists("a/d"), place.exists("a")) == (
        b"one",
        b"three",
        True,
        False,
    )
    assert sorted(place.list_keys()) == ["a/b/c", "a/d"]
    assert list(place.list_keys("a/b/")) == ["a/b/c"]
    place.remove("a/d")
    place.remove("a/d")
    assert list(place.list_keys("a/")) == ["a/b/c"]


def test_many_objects_are_got_and_removed_together(place: StoreBackend) -> None:
    for name in "abc":
        place.put(f"x/{name}", name.encode())
    assert place.get_all(["x/b", "x/none", "x/a"]) == {"x/b": b"b", "x/a": b"a"}
    place.remove_all(["x/c", "x/none", "x/a"])
    assert list(place.list_keys()) == ["x/b"]
    place.remove_all([])
    assert (list(place.list_keys()), place.get_all([])) == (["x/b"], {})


def test_objects_are_taken_over_from_a_place_of_the_same_kind(
    place: StoreBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: what is put. None of their bytes come through this process, and either place may replace its own."""
    other = open_backend(f"{place}.new")
    place.put_all({"a/0": b"zero", "a/1": b"one"})
    with monkeypatch.context() as patch:
        patch.setattr(type(place), "get", None)
        patch.setattr(type(place), "put", None)
        other.copy_all(place, ["a/0", "a/1", "a/none"])
        other.copy_all(place, ["a/1"])
    assert other.get_all(["a/0", "a/1", "a/none"]) == {"a/0": b"zero", "a/1": b"one"}
    assert sorted(other.list_keys()) == ["a/0", "a/1"]
    place.put("a/0", b"changed")
    other.remove("a/1")
    assert (other.get("a/0"), place.get("a/1")) == (b"zero", b"one")


def test_objects_are_taken_over_from_a_place_of_another_kind(bucket: str, tmp_path: Path) -> None:
    local, remote = open_backend(tmp_path / "plane.zarr"), open_backend(f"{bucket}/{tmp_path.name}.zarr")
    local.put("a/0", b"zero")
    remote.copy_all(local, ["a/0", "a/none"])
    open_backend(tmp_path / "back.zarr").copy_all(remote, ["a/0", "a/none"])
    assert open_backend(tmp_path / "back.zarr").get("a/0") == b"zero"


def test_an_object_is_put_new_only_once(place: StoreBackend) -> None:
    assert [place.put_new("x", b"first"), place.put_new("x", b"second"), place.get("x")] == [True, False, b"first"]


def test_a_part_of_an_object_is_got(place: StoreBackend) -> None:
    place.put("x", b"0123456789")
    parts = slice(2, 5), slice(7, None), slice(-2, None)
    assert [place.get("x", part) for part in parts] == [b"234", b"789", b"89"]
    assert place.get("none", slice(0, 2)) is None


def test_the_notes_of_a_run_lie_beside_its_store(place: StoreBackend) -> None:
    notes = sidecar_of(place)
    assert notes.put_new(LEASE_NAME, b"1")
    assert (notes.get(LEASE_NAME), list(place.list_keys())) == (b"1", [])
    assert str(notes).endswith("/.plane.zarr.run")


@pytest.mark.slow
def test_the_whole_flow_gives_the_bits_of_a_local_store(
    place: StoreBackend, solved_plane: Path, client: Client
) -> None:
    url = str(place)
    summary = atlas.run(plane_of(), url, client=client)
    assert (summary.store, summary.tiles_done, summary.failures) == (url, 9, ())
    assert arrays_of(url) == arrays_of(solved_plane)
    assert verify(url, sample=4).is_sound

    handle = store.open_store(url)
    assert store.done_tiles(handle) == {(i, j) for i in range(3) for j in range(3)}
    drop_tile(handle, (1, 2))
    assert atlas.run(plane_of(), url, client=client).tiles_solved == 1
    assert arrays_of(url) == arrays_of(solved_plane)

    assert extend(url, f"{url}-fine", refine={"b": 2}, client=client).cells_solved == 7 * 4
    fine = atlas.open(f"{url}-fine")
    assert fine.state.values[::2].tobytes() == arrays_of(url)["state"]
    again = atlas.retry(url, f"{url}-again", "chaotic", survival=MAX_PERIODS // 100, client=client)
    assert 0 < again.cells_solved < 35
    assert verify(f"{url}-again", sample=4).is_sound


@pytest.mark.slow
def test_worker_processes_write_to_a_url(bucket: str) -> None:
    spec = atlas.Spec("two-mass", axes={"omega": [2.0, 3.0]}, solve={"max_periods": 50}, store={"tile": [1]})
    assert atlas.run(spec, f"{bucket}/processes/sweep.zarr", options=atlas.RunOptions(workers=1)).tiles_done == 2


@pytest.mark.slow
def test_a_corrupted_object_is_found_and_repaired(place: StoreBackend, client: Client) -> None:
    atlas.run(plane_of(), str(place), client=client)
    before = arrays_of(place)
    data = bytearray(place.get("state/c/0/1/0") or b"")
    data[9] ^= 1
    place.put("state/c/0/1/0", bytes(data))
    place.remove("error/c/2/0")
    report = verify(str(place), sample=0, repair=True)
    assert report.repaired == ((0, 1), (2, 0))
    assert "state/c/0/1/0 is damaged" in str(report)
    assert atlas.run(plane_of(), str(place), client=client).tiles_solved == 2
    assert arrays_of(place) == before


@pytest.mark.slow
def test_every_command_takes_a_url(bucket: str, tmp_path: Path, client: Client) -> None:
    def call(*args: object) -> str:
        result = CliRunner().invoke(main, [str(arg) for arg in args])
        assert result.exit_code == 0, result.output
        return result.stdout

    url = f"{bucket}/commands/tiny.zarr"
    call("plan", "tiny", "-o", url, "--no-probe")
    assert f"{url}: 4 of 4 tiles done" in call("run", "tiny", "-o", url, "--scheduler", client.scheduler.address)
    assert f'"store": "{url}"' in call("status", url, "--json")
    call("verify", url, "--sample", 2)
    assert "periodic" in call("query", url)
    call("query", url, "--at", "omega=3", "--at", "b=0.3")
    call("plot", url, "-o", tmp_path / "tiny.png")
    assert (tmp_path / "tiny.png").exists()


def test_plain_xarray_opens_a_store_on_s3(bucket: str, client: Client) -> None:
    atlas.run(plane_of(), f"{bucket}/xarray/plane.zarr", client=client)
    remote = placing.ObjectBackend(f"{bucket}/xarray/plane.zarr").client
    ds = xr.open_zarr(zarr.storage.ObjectStore(remote, read_only=True))  # warnings are errors here
    assert (ds.regime.values >= 0).all()


def test_the_root_is_written_last_so_that_a_creation_cut_short_leaves_no_store(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = open_backend(f"{bucket}/short/plane.zarr")
    order: list[str] = []
    whole = ObjectBackend.put

    def dies(self: ObjectBackend, key: str, data: bytes) -> None:
        order.append(key)
        if len(order) == 12:
            raise OSError("the network is gone")
        whole(self, key, data)

    with monkeypatch.context() as patch:
        patch.setattr(ObjectBackend, "put", dies)
        with pytest.raises(InputError, match="cannot be written: the network is gone"):
            create.create_store(place, plane_of(), (2, 3))
    assert "zarr.json" not in order and SPEC_KEY not in order
    with pytest.raises(InputError, match="no such store"):
        store.open_store(place)
    assert find(place, plane_of()) is None  # what is left is in nobody's way
    create.create_store(place, plane_of(), (2, 3))
    assert find(place, plane_of()) == store.open_store(place)


def test_of_two_that_make_a_store_at_once_one_is_told(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    place = open_backend(f"{bucket}/race/plane.zarr")
    whole = ObjectBackend.put_new

    def overtaken(self: ObjectBackend, key: str, data: bytes) -> bool:
        with monkeypatch.context() as patch:
            patch.setattr(ObjectBackend, "put_new", whole)
            create.create_store(place, plane_of(), (2, 3))
        return whole(self, key, data)

    monkeypatch.setattr(ObjectBackend, "put_new", overtaken)
    with pytest.raises(InputError, match="another run has just created it"):
        create.create_store(place, plane_of(), (2, 3))
    assert verify(str(place), sample=0).faults == ()


def test_of_two_that_make_a_store_at_once_the_second_spec_is_that_of_the_root(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that comes second has written all but the root when it is told."""
    place = open_backend(f"{bucket}/second/plane.zarr")
    whole = ObjectBackend.put_new

    def overtaken(self: ObjectBackend, key: str, data: bytes) -> bool:
        if key != "zarr.json":
            return whole(self, key, data)
        with monkeypatch.context() as patch:
            patch.setattr(ObjectBackend, "put_new", whole)
            with pytest.raises(InputError, match="another run has just created it"):
                assert whole(self, key, data)
                create.create_store(place, plane_of(), (2, 3))
        return True

    monkeypatch.setattr(ObjectBackend, "put_new", overtaken)
    handle = create.create_store(place, plane_of(), (2, 3))
    assert unsealed(place.get(SPEC_KEY)) == handle.attributes
    assert verify(str(place), sample=0).faults == ()


def test_what_is_not_ours_at_a_url_is_left_alone(bucket: str) -> None:
    place = open_backend(f"{bucket}/foreign")
    place.put("thesis.tex", b"mine")
    with pytest.raises(InputError, match=r"found thesis.tex, which is no part of an atlas"):
        find(place, plane_of())
    zarr.create_group(zarr.storage.ObjectStore(open_backend(f"{bucket}/group").client))  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="not an atlas"):
        find(f"{bucket}/group", plane_of())


def test_the_ledger_is_one_listing(bucket: str, client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    atlas.run(plane_of(), f"{bucket}/ledger", client=client)
    handle = store.open_store(f"{bucket}/ledger")
    asked: list[str] = []
    whole = ObjectBackend.list_keys
    monkeypatch.setattr(
        ObjectBackend, "list_keys", lambda self, prefix="": (asked.append(prefix), whole(self, prefix))[1]
    )
    monkeypatch.setattr(ObjectBackend, "exists", lambda *_: pytest.fail("a question for each tile"))
    assert len(store.done_tiles(handle)) == 9
    assert asked == ["regime/c/"]


def test_a_status_of_a_finished_atlas_takes_ten_requests_at_most(
    bucket: str, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    atlas.run(plane_of(), f"{bucket}/few", client=client)
    asked: list[str] = []

    def count(owner: Any, name: str) -> None:
        whole = getattr(owner, name)

        def counted(*args: Any, **named: Any) -> Any:
            asked.append(name)
            return whole(*args, **named)

        monkeypatch.setattr(owner, name, counted)

    for name in ("get", "exists", "list_keys"):
        count(ObjectBackend, name)
    status = read_status(store.open_store(f"{bucket}/few"))
    assert (status.tiles_done, status.cells_done) == (9, 35)
    assert len(asked) <= 10, asked
    assert not status.run


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("nowhere://x/plane.zarr", "nowhere://x/plane.zarr: found nowhere://, must be a path, file:// or one of s3, "),
        ("memory://x", "memory://x: found memory://, must be "),
        ("simplecache::s3://x/y", "simplecache::s3://x/y: found simplecache::s3://, must be "),
        ("s3://no-such-bucket/plane.zarr", "s3://no-such-bucket/plane.zarr: cannot be written: "),
    ],
)
def test_a_url_that_leads_nowhere_is_reported_in_one_line(bucket: str, url: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as told:
        find(url, plane_of())
    assert "\n" not in str(told.value)


def test_a_url_without_obstore_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(InputError, match=r"s3://x/y: .*; needs obstore: pip install obstore"):
        open_backend("s3://x/y")


def test_a_store_that_may_only_be_read_is_refused_before_a_tile_is_solved(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = open_backend(f"{bucket}/readonly/plane.zarr")
    handle = create.create_store(place, plane_of(), (2, 3))
    assert find(place, plane_of()) == handle

    def refused(*_: object) -> bool:
        raise PermissionError(13, "Access Denied")

    monkeypatch.setattr(ObjectBackend, "put_new", refused)
    with pytest.raises(InputError, match="cannot be written: Access Denied"):
        find(place, plane_of())
    assert store.open_store(place) == handle


@pytest.fixture
def web(tmp_path: Path) -> Iterator[str]:
    """The URL of a folder that a plain web server hands out."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path))) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_a_published_store_is_read_from_a_plain_web_server(web: str, tmp_path: Path, client: Client) -> None:
    atlas.run(plane_of(), tmp_path / "plane.zarr", client=client)
    assert arrays_of(f"{web}/plane.zarr") == arrays_of(tmp_path / "plane.zarr")
    with pytest.raises(InputError, match="cannot be written"):
        find(f"{web}/other.zarr", plane_of())


def test_a_finished_atlas_on_a_plain_web_server_has_the_status_and_the_answers_of_its_folder(
    web: str, finished: Path
) -> None:
    url = f"{web}/{finished.name}"
    here, there = read_status(open_store(finished)), read_status(open_store(url))
    assert (there.tiles_done, there.regimes, there.trouble) == (9, here.regimes, "")
    assert str(there) == str(here)
    answers = [CliRunner().invoke(main, ["query", str(where), "--json"]) for where in (finished, url)]
    assert [answer.exit_code for answer in answers] == [0, 0]
    assert answers[0].stdout == answers[1].stdout


@pytest.mark.parametrize("command", ["status", "verify"])
def test_what_needs_a_listing_says_so_in_one_line_on_a_plain_web_server(web: str, finished: Path, command: str) -> None:
    forget_records(open_store(finished), [(1, 1)])
    drop_tile(open_store(finished), (1, 1))
    url = f"{web}/{finished.name}"
    ended = CliRunner().invoke(main, [command, url])
    said = f"Error: {url}: this web server does not list the objects of the store; copy the store to a disk"
    assert (ended.exit_code, ended.stderr.splitlines()[-1]) == (1, said)


@pytest.mark.parametrize("given", ["x.zarr", "./x.zarr", "file:///tmp/a%20b/x.zarr"])
def test_a_path_is_made_absolute_and_a_file_url_is_a_path(given: str) -> None:
    expected = "/tmp/a b/x.zarr" if given.startswith("file") else os.path.join(os.getcwd(), "x.zarr")
    assert str(open_backend(given)) == expected


def test_a_store_at_a_bucket_itself_has_no_room_for_notes(bucket: str) -> None:
    with pytest.raises(InputError, match="needs a name below the bucket"):
        sidecar_of(ObjectBackend(bucket))


def test_a_chunk_that_was_never_written_reads_as_pending(place: StoreBackend) -> None:
    create.create_store(place, plane_of(), (2, 3))
    assert (np.asarray(atlas.open(place).regime) == -1).all()
