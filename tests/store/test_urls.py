"""Names of stores as users write them, and secrets in them, which no message and no attribute may show.

Truth: fsspec, which xarray and Dask use, says where a ``file://`` URL leads; RFC 7617 what a password becomes.
"""

import os
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from fsspec.core import url_to_fs

import atlas
from atlas.argument_checks import validate_path
from atlas.cli.main import main
from atlas.errors import InputError, NetworkError, without_secrets
from atlas.query.export import export
from atlas.service.extend import origin_for
from atlas.store.access import BY_ENVIRONMENT
from atlas.store.object_backend import LocalBackend, ObjectBackend, open_backend, picklable_backend
from atlas.store.sidecar import sidecar_of
from atlas.store.store import open_store

SECRET = "hunter2"
WITH_SECRETS = [
    f"https://me:{SECRET}@127.0.0.1:9/out.zarr",
    f"https://127.0.0.1:9/out.zarr?sv=1&sig={SECRET}",
    f"https://me:{SECRET}@127.0.0.1:9/out.zarr?sig={SECRET}",
]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    "url", ["file://data/plane.zarr", "file:///data/plane.zarr", "file://plane.zarr", "file://~/x"]
)
def test_a_file_url_leads_where_it_leads_xarray(url: str, home: Path) -> None:
    assert str(open_backend(url)) == url_to_fs(url)[1]


def test_a_file_url_of_this_host_is_its_path() -> None:
    assert open_backend("file://localhost/data/a%20b.zarr") == LocalBackend(Path("/data/a b.zarr"))


@pytest.mark.parametrize("make", [str, Path])
def test_a_tilde_is_the_home_of_the_user(make: Callable[[str], Any], home: Path) -> None:
    assert open_backend(make("~/new.zarr")) == LocalBackend(home / "new.zarr")
    assert validate_path(make("~/a.png")) == home / "a.png"


def test_a_file_is_exported_to_the_home_of_the_user(home: Path, solved_plane: Path) -> None:
    export(atlas.open(solved_plane), "~/a.csv")
    assert (home / "a.csv").is_file()
    assert not Path("~").exists()


def test_a_user_and_a_password_become_the_header_of_each_request_and_leave_the_url() -> None:
    place = open_backend(f"https://me:{SECRET}%2F@127.0.0.1:9/out.zarr")
    assert isinstance(place, ObjectBackend)
    header = "Basic " + b64encode(f"me:{SECRET}/".encode()).decode()
    assert place.url == "https://127.0.0.1:9/out.zarr"
    assert place.access.client == (("default_headers", (("authorization", header),)),)
    assert place.access != BY_ENVIRONMENT
    assert picklable_backend(place) == place


@pytest.mark.parametrize("url", WITH_SECRETS)
def test_no_name_and_no_message_of_a_url_has_its_secrets(url: str) -> None:
    place = open_backend(url, patience=0.0)
    notes = sidecar_of(place)
    assert isinstance(notes, ObjectBackend)
    ended = CliRunner().invoke(main, ["query", f"ftp{url.removeprefix('https')}"])
    assert ended.exit_code == 2
    texts = [str(place), repr(place), str(notes), ended.output]
    with pytest.raises(NetworkError) as caught:
        place.get("a")
    texts += [str(caught.value), str(InputError(f"{url}: is wrong"))]
    assert not [text for text in texts if SECRET in text]


def test_a_signature_stays_with_the_objects_within_a_store_and_beside_it() -> None:
    place = open_backend("https://host/a/out.zarr?sig=1")
    assert isinstance(place, ObjectBackend)
    notes = sidecar_of(place)
    assert isinstance(notes, ObjectBackend)
    assert notes.url == "https://host/a/.out.zarr.run?sig=1"


@pytest.mark.parametrize("url", WITH_SECRETS)
def test_a_store_that_needs_a_secret_is_no_origin_of_one_that_lacks_it(
    url: str, solved_plane: Path, tmp_path: Path
) -> None:
    """The attribute ``origin`` has no secret, so that workers could not open it."""
    old = open_store(solved_plane).with_backend(open_backend(url))
    with pytest.raises(InputError, match="workers reach it in the same way") as caught:
        origin_for(open_backend(tmp_path / "new.zarr"), old)
    assert SECRET not in str(caught.value)


def test_a_password_in_the_url_of_a_bucket_is_refused_without_being_shown() -> None:
    with pytest.raises(InputError, match=r"^s3://\*\*\*@bucket/x: has a user or a password, which must be in"):
        open_backend(f"s3://key:{SECRET}@bucket/x")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("https://a:b@host/x?y=1 (GET https://a:b@host/z?y=1)", "https://***@host/x?*** (GET https://***@host/z?***)"),
        ("https://a:p@ss@host/x", "https://***@host/x"),
        ("s3://bucket/plane.zarr: has omega@2?", "s3://bucket/plane.zarr: has omega@2?"),
        ("me@host said: why?", "me@host said: why?"),
    ],
)
def test_secrets_of_urls_and_nothing_else_are_left_out(text: str, shown: str) -> None:
    assert without_secrets(text) == shown


def test_nothing_is_made_in_a_folder_called_tilde(home: Path) -> None:
    ended = CliRunner().invoke(main, ["status", "~/none.zarr"])
    assert ended.stderr.splitlines()[-1] == f"Error: {home}/none.zarr: no such store"
    assert not os.path.exists("~")
