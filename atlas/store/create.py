"""Create a store, whole or not at all, and check whether a run may create or resume a store."""

import errno
import glob
import os
import shutil
import tempfile
import uuid
from pathlib import Path

from atlas.errors import InputError
from atlas.spec.differences import differences
from atlas.spec.spec import Spec
from atlas.store.metadata import ROOT
from atlas.store.object_backend import (
    Given,
    LocalBackend,
    StoreBackend,
    open_backend,
    os_errors_as_input_errors,
    sibling_backend,
)
from atlas.store.origin import Origin
from atlas.store.schema import SPEC_KEY, coordinate_names, layout, remedy, root_attributes
from atlas.store.store import AtlasStore, open_store
from atlas.store.zarr_backend import check_not_packed
from workers import SOLVER_VERSION
from workers.model.reserved_names import NAMES
from workers.results import REGIME

TRIAL = ".trial-"


def check_run(backend: StoreBackend, spec: Spec, handle: AtlasStore | None, origin: Origin | None = None) -> None:
    """Raise InputError unless a run of ``spec`` may create a store in a backend, or resume the store there.

    backend  backend of the store
    spec     spec of the run
    handle   handle of the existing store, None if there is none
    origin   the origin that the existing store must have, if given
    """
    check_not_packed(backend)
    if handle is None:
        spec.check_stored_form()
        with os_errors_as_input_errors(backend, "written"):
            if backend.local is None:
                _refuse_foreign(backend, spec)
            _check_writable(backend)
        return
    if handle.solver_version != SOLVER_VERSION:
        raise InputError(
            f"{backend}: computed by solver version {handle.solver_version}, installed is {SOLVER_VERSION}; "
            "a store cannot mix solver versions, choose another path"
        )
    if handle.digest != spec.digest and handle.spec.digest != spec.digest:  # a spec from before a setting existed
        raise InputError(f"{backend}: has another spec: {'; '.join(differences(handle.spec, spec))}")
    with os_errors_as_input_errors(backend, "written"):
        if backend.local is not None:
            if not os.access(backend.local, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        elif root := backend.get(ROOT):
            backend.put_new(ROOT, root)  # writes nothing, but raises without permission to write
    if origin and origin != handle.origin:
        raise InputError(
            f"{backend}: a store that was not made from {sibling_backend(backend, origin.store)}; choose another path"
        )


def _refuse_foreign(backend: StoreBackend, spec: Spec) -> None:
    """Raise InputError if a URL has objects, such as finished tiles, that cannot be left over from an interrupted
    creation.
    """
    ours = {key.partition("/")[0] for key in layout(root_attributes(spec, spec.shape, None), spec)}
    for key in backend.list_keys():
        if key.startswith(f"{REGIME.name}/c/"):
            raise InputError(f"{backend}: holds tiles, but {ROOT} is missing: {remedy(backend)}")
        if key.partition("/")[0] not in ours and not key.startswith(TRIAL):
            raise InputError(f"{backend}: found {key}, which is no part of an atlas; choose another path or remove it")


def create_store(
    store: Given,
    spec: Spec,
    tile: tuple[int, ...],
    origin: Origin | None = None,
) -> AtlasStore:
    """Create a store without results, whole or not at all, and return its handle.

    store    path, URL or backend of the store
    spec     spec of the atlas
    tile     cells of a tile along each dimension
    origin   store whose cells the new store takes over, None if there is none
    """
    backend = open_backend(store)
    with os_errors_as_input_errors(backend, "written"):
        make_store(backend, spec, tile, origin, "")
    return open_store(backend)


def make_store(backend: StoreBackend, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    """Write the metadata and coordinates of a new store; the store appears at once or not at all.

    On a disk its folder is renamed. At a URL the metadata of the root are written after all other objects, and only if
    none exist.
    """
    objects, path = layout(root_attributes(spec, tile, origin, run_id), spec), backend.local
    if path is None:
        backend.confirm_lease()
        backend.put_all({key: data for key, data in objects.items() if key not in (ROOT, SPEC_KEY)})
        if not backend.put_new(ROOT, objects[ROOT]):
            raise InputError(f"{backend}: another run has just created it; rerun the same command to resume it")
        backend.put(SPEC_KEY, objects[SPEC_KEY])  # after the root, so that both come from one run
        return
    building = path.parent / f".{path.name}.{uuid.uuid4().hex}.partial"
    try:
        building.mkdir(parents=True)
        if building.with_name(building.name.swapcase()).exists():
            refuse_equal_names(path, spec)
        LocalBackend(building).put_all(objects)
        backend.confirm_lease()
        os.rename(building, path)
    finally:
        shutil.rmtree(building, ignore_errors=True)


def refuse_equal_names(path: Path, spec: Spec) -> None:
    """Raise InputError if names of arrays differ by case alone: a disk that ignores case would mix their chunks."""
    seen: dict[str, str] = {}
    for name in (*NAMES, *_names(spec)):
        other = seen.setdefault(name.casefold(), name)
        if other != name:
            raise InputError(
                f"{path}: the file system ignores case, so {name} and {other} collide; rename {name} in the system"
            )


def _names(spec: Spec) -> set[str]:
    """Return the names of all arrays of a store's cells and of their coordinates."""
    return {*coordinate_names(spec)} | {variable.name for variable in spec.variables}


def _check_writable(backend: StoreBackend) -> None:
    """Write and remove a test object or folder, since permission bits are not reliable; on a disk, in the nearest
    existing folder.
    """
    if backend.local is None:
        trial = f"{TRIAL}{uuid.uuid4().hex}"
        backend.put(trial, b"")
        backend.remove(trial)
        return
    home = next(folder for folder in backend.local.parents if folder.exists())
    with tempfile.TemporaryDirectory(prefix=f".{backend.local.name}.", dir=home):
        pass


def remove_half_made(store: Path) -> None:
    """Remove folders left by runs that were killed while they created this store.

    Only the lease holder may call this.
    """
    run_id = "[0-9a-f]" * 32
    for leftover in store.absolute().parent.glob(f".{glob.escape(store.name)}.{run_id}.partial"):
        shutil.rmtree(leftover, ignore_errors=True)
