"""A small plane for tests of planning, storing and running."""

import os

import atlas
from atlas.store import store
from atlas.store.create import check_run
from atlas.store.object_backend import StoreBackend, open_backend


def plane_of(tile: tuple[int, int] = (2, 3), **changes: object) -> atlas.Spec:
    """The small plane with another tile shape, or other parameters."""
    return atlas.Spec(
        "two-mass",
        axes={"omega": {"start": 2.0, "stop": 4.0, "num": 7}, "b": {"start": 0.1, "stop": 0.5, "num": 5}},
        parameters=changes,
        solve={"max_periods": 500, "tolerance": 0.1, "section_samples": 2},
        store={"tile": tile},
    )


def find(path: str | os.PathLike[str] | StoreBackend, spec: atlas.Spec) -> store.AtlasStore | None:
    """The handle of a store that a run of this spec may complete, None where it may make one; see ``check_run``."""
    place = open_backend(path)
    handle = store.find_store(place)
    check_run(place, spec, handle)
    return handle
