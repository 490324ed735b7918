"""Making a store appear at once or not at all, and whether one may be made or written at a place."""

import glob
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from atlas.errors import InputError, NetworkError
from atlas.spec.spec import Spec
from atlas.store.axes import ROOT
from atlas.store.build import build, consolidate
from atlas.store.location import AT_ONCE, LocalPlace, Place
from atlas.store.machine import MACHINES
from atlas.store.record import TILES
from atlas.store.schema import Origin, coordinate_names
from workers.model.names import NAMES

TRIAL = ".trial-"


@contextmanager
def refused(place: Place, what: str) -> Iterator[None]:
    """An OSError within it as an InputError, whose cause it is; a server that does not answer stays a NetworkError."""
    try:
        yield
    except NetworkError:
        raise
    except OSError as error:
        raise InputError(f"{place}: cannot be {what}: {error.strerror or error}") from error


def is_free(place: Place, spec: Spec) -> bool:
    """Whether a store of this spec may be made here: nothing is there, or only what a creation cut short left."""
    path = place.local
    if path is not None:
        return not path.exists() or (path.is_dir() and not any(path.iterdir()))
    if place.exists(ROOT):
        return False
    ours = {MACHINES, TILES} | _names(spec)
    for key in place.list_keys():
        if key.partition("/")[0] not in ours and not key.startswith(TRIAL):
            raise InputError(f"{place}: holds {key} and is not an atlas; choose another place or remove what is there")
    return True


def create_locally(path: Path, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    """Make a store without a result in a folder of this machine; a rename makes it appear."""
    building = path.parent / f".{path.name}.{uuid.uuid4().hex}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        building.mkdir()
        if building.with_name(building.name.swapcase()).exists():
            refuse_equal_names(path, spec)
        build(building, spec, tile, origin, run_id)
        os.rename(building, path)
    finally:
        shutil.rmtree(building, ignore_errors=True)


def refuse_equal_names(path: Path, spec: Spec) -> None:
    """InputError where names of arrays differ by case alone: a disk that ignores case would mix their chunks."""
    seen: dict[str, str] = {}
    for name in (*NAMES, *_names(spec)):
        other = seen.setdefault(name.casefold(), name)
        if other != name:
            raise InputError(f"{path}: the disk takes {name} and {other} for one name; rename {name} in the system")


def _names(spec: Spec) -> set[str]:
    """Names of the arrays of cells and of their coordinates."""
    return {*coordinate_names(spec)} | {variable.name for variable in spec.variables}


def create_remotely(place: Place, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    """Make a store without a result at a URL; its root, which is put last and only if absent, makes it appear."""
    with tempfile.TemporaryDirectory() as folder:
        built = LocalPlace(Path(folder) / "store")
        build(built.path, spec, tile, origin, run_id)
        _put_all(built, place, [key for key in built.list_keys() if key != ROOT])
        if not place.put_new(ROOT, (built.path / ROOT).read_bytes()):
            raise InputError(f"{place}: another run has just made a store here; start this one again to join it")


@contextmanager
def metadata_apart(place: Place, group: str) -> Iterator[Any]:
    """A copy of a store's metadata as a root group, for making a group in it anew: what is made is put many at once.

    The metadata of the group itself are put last but for the root, which then has a copy of all that is new.
    """
    import zarr

    nodes = json.loads(place.get(ROOT) or b"{}").get("consolidated_metadata", {}).get("metadata", {})
    keys = [ROOT, *(f"{name}/{ROOT}" for name in nodes if f"{name}/".partition("/")[0] != group)]
    place.remove(f"{group}/{ROOT}")
    place.remove_all(place.list_keys(f"{group}/"))
    with tempfile.TemporaryDirectory() as folder:
        built = LocalPlace(Path(folder))
        for key, data in place.get_all(keys).items():
            built.put(key, data)
        root = zarr.open_group(built.path, mode="r+", use_consolidated=False, zarr_format=3)
        yield root
        consolidate(root)
        made = {key for key in built.list_keys() if key.partition("/")[0] == group}
        _put_all(built, place, made - {f"{group}/{ROOT}"})
        for key in (f"{group}/{ROOT}", ROOT):
            place.put(key, (built.path / key).read_bytes())


def _put_all(built: LocalPlace, place: Place, keys: Iterable[str]) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(lambda key: place.put(key, (built.path / key).read_bytes()), keys))


def check_replaceable(place: Place) -> None:
    """Try to write the root if there is none: a missing permission is refused in another way."""
    root = place.get(ROOT)
    if root:
        place.put_new(ROOT, root)


def check_writable(place: Place) -> None:
    """Try it: permission bits do not say all. On a disk, in the nearest folder there is."""
    if place.local is None:
        trial = f"{TRIAL}{uuid.uuid4().hex}"
        place.put(trial, b"")
        place.remove(trial)
        return
    home = next(folder for folder in place.local.parents if folder.exists())
    with tempfile.TemporaryDirectory(prefix=f".{place.local.name}.", dir=home):
        pass


def remove_half_made(store: Path) -> None:
    """Remove what runs left behind that were killed while they made this store. For the claim's holder only."""
    run_id = "[0-9a-f]" * 32
    for leftover in store.absolute().parent.glob(f".{glob.escape(store.name)}.{run_id}.partial"):
        shutil.rmtree(leftover, ignore_errors=True)
