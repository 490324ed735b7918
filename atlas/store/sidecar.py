"""The sidecar of a store: small objects beside it that processes share, such as the lease of a run.

The sidecar of ``plane.zarr`` is the folder or the object prefix ``.plane.zarr.run`` beside it. It lies outside the
store, because a lease exists before its store and because Zarr owns everything inside.
"""

import json
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

from atlas.errors import InputError, RunError
from atlas.store.backend import Confirmation
from atlas.store.object_backend import Given, LocalBackend, ObjectBackend, StoreBackend, open_backend
from atlas.store.zarr_backend import ZarrBackend

LEASE_NAME = "claim"
"""Name of the object of a sidecar that is the lease of the store. The run whose token it contains has the lease."""


def sidecar_of(store: Given) -> StoreBackend:
    """Return the backend of a store's sidecar. For ``s3://bucket/plane.zarr`` it is at ``s3://bucket/.plane.zarr.run``.

    If the path of the store is a link, the sidecar lies beside the target, so that a store has one lease. A store that
    is only read, such as a Zarr store object, has no sidecar. Its own backend is returned, which has no object with a
    sidecar's names. Raise InputError for a store at the root of a bucket.
    """
    backend = open_backend(store)
    if isinstance(backend, ObjectBackend):
        parts = urlsplit(backend.url)
        above, _, name = parts.path.rstrip("/").rpartition("/")
        if not name:
            raise InputError(f"{backend}: a store needs a name below the bucket, such as {backend}/plane.zarr")
        return replace(backend, url=parts._replace(path=f"{above}/.{name}.run").geturl())
    path = backend.file if isinstance(backend, ZarrBackend) else backend.local
    if path is None:
        return backend
    path = Path(os.path.realpath(path))
    return LocalBackend(path.parent / f".{path.name}.run")


def read_lease_token(sidecar: StoreBackend) -> str:
    """Return the token of the run that leases a store; empty if there is no lease or it is damaged. It takes one
    read.
    """
    try:
        return str(json.loads(sidecar.get(LEASE_NAME) or b"{}")["token"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""


def with_confirmation(
    store: StoreBackend, token: str, error: type[RunError], reason: str, before: Confirmation = lambda: None
) -> StoreBackend:
    """Return the backend of a store with a confirmation that raises an error unless a run leases the store.

    store    backend of the store
    token    token of the run
    error    class of the error
    reason   text of the error, after the name of the store
    before   function that is called before the token is read
    """
    sidecar = sidecar_of(store)

    def confirm() -> None:
        before()
        if read_lease_token(sidecar) != token:
            raise error(f"{store}: {reason}")

    return store.with_lease(confirm)


def clear_sidecar(sidecar: StoreBackend, names: Iterable[str]) -> None:
    """Remove the named objects of a sidecar; on a disk remove also its folder if nothing else is in it."""
    sidecar.remove_all(list(names))
    if sidecar.local is not None:
        for partial in sidecar.local.glob("*.partial"):  # left by a process that was killed while it wrote
            partial.unlink(missing_ok=True)
        with suppress(OSError):  # it holds more
            sidecar.local.rmdir()
