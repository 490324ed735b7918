"""A small plane for tests of planning, storing and running."""

import os

import atlas
from atlas.store import store
from atlas.store.location import Place, place_of
from atlas.store.making import check_run


def plane_of(tile: tuple[int, int] = (2, 3), **changes: object) -> atlas.Spec:
    """The small plane with another tile shape, or other parameters."""
    return atlas.Spec(
        "two-mass",
        axes={"omega": {"start": 2.0, "stop": 4.0, "num": 7}, "b": {"start": 0.1, "stop": 0.5, "num": 5}},
        parameters=changes,
        solve={"max_periods": 500, "tolerance": 0.1, "section_samples": 2},
        store={"tile": tile},
    )


def find(path: str | os.PathLike[str] | Place, spec: atlas.Spec) -> store.Atlas | None:
    """The handle of a store that a run of this spec may complete, None where it may make one; see ``check_run``."""
    place = place_of(path)
    handle = store.find(place)
    check_run(place, spec, handle)
    return handle
