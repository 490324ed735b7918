"""Creation of a store, whole or not at all, and the check whether a run may create or resume a store."""

import errno
import glob
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from atlas.errors import InputError, RunError
from atlas.spec.differences import differences
from atlas.spec.spec import Spec
from atlas.store.axes import ROOT, copies
from atlas.store.host import HOSTS
from atlas.store.metadata_backup import SPARE, encode_backup, remedy
from atlas.store.object_backend import (
    Given,
    LocalBackend,
    StoreBackend,
    open_backend,
    os_errors_as_input_errors,
    sibling_backend,
)
from atlas.store.origin import ALLOWANCES, Origin, budget_variables
from atlas.store.record_format import TILES, create_arrays
from atlas.store.schema import (
    codecs,
    consolidate,
    coordinate_names,
    coordinates,
    create_variable,
    create_whole,
    root_attributes,
)
from atlas.store.store import AtlasStore, open_group, open_store
from atlas.store.tiling import Tiling
from atlas.store.zip_backend import check_not_packed
from workers import SOLVER_VERSION
from workers.model.reserved_names import NAMES
from workers.results import REGIME

TRIAL = ".trial-"


def check_run(
    place: StoreBackend, spec: Spec, handle: AtlasStore | None, origin: Origin | None = None, run_id: str = ""
) -> None:
    """Raise InputError unless a run of ``spec`` may create a store in a backend, or resume the store there.

    place    backend of the store
    spec     spec of the run
    handle   handle of the existing store, None if there is none
    origin   the origin that the existing store must have, if given
    run_id   the run that must have created the store, if given; otherwise raise RunError
    """
    check_not_packed(place)
    if handle is None:
        spec.check_stored_form()
        with os_errors_as_input_errors(place, "written"):
            if place.local is None:
                _refuse_foreign(place, spec)
            _check_writable(place)
        return
    if handle.solver_version != SOLVER_VERSION:
        raise InputError(
            f"{place}: computed by solver version {handle.solver_version}, installed is {SOLVER_VERSION}; "
            "a store cannot mix solver versions, choose another path"
        )
    # Equal digests are enough: the values of the stored spec may be damaged.
    if handle.digest != spec.digest and handle.spec.digest != spec.digest:
        raise InputError(f"{place}: has another spec: {'; '.join(differences(handle.spec, spec))}")
    with os_errors_as_input_errors(place, "written"):
        if place.local is not None:
            if not os.access(place.local, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        elif root := place.get(ROOT):
            place.put_new(ROOT, root)  # writes nothing, but raises without permission to write
    if run_id and run_id != handle.run_id:
        raise RunError(f"{place}: not the store of run {run_id}")
    if origin and origin != handle.origin:
        raise InputError(
            f"{place}: a store that was not made from {sibling_backend(place, origin.store)}; choose another path"
        )


def _refuse_foreign(place: StoreBackend, spec: Spec) -> None:
    """Raise InputError if a URL has objects that no interrupted creation has left there, such as finished tiles."""
    ours = {HOSTS, TILES} | _names(spec)
    for key in place.list_keys():
        if key.startswith(f"{REGIME.name}/c/"):
            raise InputError(f"{place}: holds tiles, but {ROOT} is missing: {remedy(place)}")
        if key.partition("/")[0] not in ours and not key.startswith(TRIAL):
            raise InputError(f"{place}: found {key}, which is no part of an atlas; choose another path or remove it")


def create_store(
    store: Given,
    spec: Spec,
    tile: tuple[int, ...],
    origin: Origin | None = None,
    run_id: str = "",
) -> AtlasStore:
    """Create a store without results, see ``make_store``, and return its handle.

    store    path, URL or backend of the store
    spec     spec of the atlas
    tile     cells of a tile along each dimension
    origin   store whose cells the new store takes over, None if there is none
    run_id   identifier of the run; drawn at random if empty
    """
    place = open_backend(store)
    with os_errors_as_input_errors(place, "written"):
        make_store(place, spec, tile, origin, run_id)
    return open_store(place)


def make_store(place: StoreBackend, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    """Create a store without results; the store appears at once or not at all."""
    with _appearing(place) as folder:
        if place.local is not None and folder.with_name(folder.name.swapcase()).exists():
            refuse_equal_names(place.local, spec)
        _build(folder, spec, tile, origin, run_id)


@contextmanager
def _appearing(place: StoreBackend) -> Iterator[Path]:
    """Yield a local folder whose content appears in a backend at the end of the block.

    On a disk the folder is renamed. At a URL the metadata of the root are written after all other objects, and only if
    none exist. Their backup follows, so both come from one run.
    """
    path = place.local
    if path is None:
        with tempfile.TemporaryDirectory() as folder:
            built = LocalBackend(Path(folder) / "store")
            yield built.path
            place.put_all(built.get_all(key for key in built.list_keys() if key not in (ROOT, SPARE)))
            if not place.put_new(ROOT, (built.path / ROOT).read_bytes()):
                raise InputError(f"{place}: another run has just created it; rerun the same command to resume it")
            place.put(SPARE, (built.path / SPARE).read_bytes())
        return
    building = path.parent / f".{path.name}.{uuid.uuid4().hex}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        building.mkdir()
        yield building
        place.check_fence()
        os.rename(building, path)
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _build(path: Path, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    """Create a store without results in a local folder."""
    import zarr

    from atlas.store.zarr_stores import zarr_store  # loads Zarr, which takes a while

    variables, tiling = spec.variables, Tiling(spec.shape, tuple(map(min, tile, spec.shape)))
    store = zarr_store(LocalBackend(path), read_only=False)
    group = zarr.create_group(store, zarr_format=3, attributes=root_attributes(spec, origin, run_id))
    group.create_group(HOSTS, attributes={"long_name": "processors and software that solved this atlas"})
    for name, coordinate in coordinates(spec).items():
        create_whole(group, name, coordinate)
    retried = budget_variables(spec) if origin and origin.retry else ()
    for variable in (*variables, *retried):
        create_variable(group, variable, spec, tiling)
    create_arrays(group, (*variables, *ALLOWANCES), spec.dims, tiling.grid, codecs())
    consolidate(group)
    for key, data in copies(spec).items():
        LocalBackend(path).put(key, data)
    LocalBackend(path).put(SPARE, encode_backup((path / ROOT).read_bytes()))


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
    """Return the names of the arrays of cells and of their coordinates."""
    return {*coordinate_names(spec)} | {variable.name for variable in spec.variables}


@contextmanager
def detached_root(place: StoreBackend, group: str) -> Iterator[Any]:
    """Yield a copy of a store's metadata as a root group, in which one group is created again, then written at the end.

    The metadata of the group are written after its members. The metadata of the root, which contain copies of them, are
    written last.
    """
    nodes = json.loads(place.get(ROOT) or b"{}").get("consolidated_metadata", {}).get("metadata", {})
    keys = [ROOT, *(f"{name}/{ROOT}" for name in nodes if f"{name}/".partition("/")[0] != group)]
    place.remove(f"{group}/{ROOT}")
    place.remove_all(place.list_keys(f"{group}/"))
    with tempfile.TemporaryDirectory() as folder:
        built = LocalBackend(Path(folder))
        for key, data in place.get_all(keys).items():
            built.put(key, data)
        root = open_group(built, "r+")
        yield root
        consolidate(root)
        made = {key for key in built.list_keys() if key.partition("/")[0] == group}
        place.put_all(built.get_all(made - {f"{group}/{ROOT}"}))
        for key in (f"{group}/{ROOT}", ROOT):
            place.put(key, (built.path / key).read_bytes())


def _check_writable(place: StoreBackend) -> None:
    """Try to write, since permission bits are not reliable; on a disk, in the nearest existing folder."""
    if place.local is None:
        trial = f"{TRIAL}{uuid.uuid4().hex}"
        place.put(trial, b"")
        place.remove(trial)
        return
    home = next(folder for folder in place.local.parents if folder.exists())
    with tempfile.TemporaryDirectory(prefix=f".{place.local.name}.", dir=home):
        pass


def remove_half_made(store: Path) -> None:
    """Remove folders left by runs that were killed while they created this store.

    Only the lease holder may call this.
    """
    run_id = "[0-9a-f]" * 32
    for leftover in store.absolute().parent.glob(f".{glob.escape(store.name)}.{run_id}.partial"):
        shutil.rmtree(leftover, ignore_errors=True)
