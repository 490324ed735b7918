"""Small planes whose curves are known, for tests of finding them; and the search without Dask or a store."""

import json
from typing import Any

import numpy as np

import atlas
from atlas.orbits.curves.plane import CurvePlane
from atlas.orbits.curves.search import CurveSearch
from atlas.orbits.curves.search_result import finish_search
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.table import Curve, Curves
from atlas.orbits.curves.tasks import run_task
from atlas.orbits.curves.to_json import curve_from_json

QUICK = {"max_periods": 1000, "tolerance": 0.1}


def forces() -> atlas.Spec:
    """The two masses over clearance and the force on the second one: all depends on b / |Y(f2)| alone."""
    axes = {"b": {"start": 0.1, "stop": 0.3, "num": 8}, "f2": {"start": -0.3, "stop": 0.3, "num": 4}}
    return atlas.Spec("two-mass", axes, {"omega": 2.6}, QUICK, {"tile": [2, 8]})


def ball() -> atlas.Spec:
    """A ball that starts above the table: its orbit of period 1 is born at a fold and doubles."""
    axes = {"omega": {"start": 0.85, "stop": 1.15, "num": 9}, "R": {"start": 0.5, "stop": 0.7, "num": 5}}
    return atlas.Spec("bouncing-ball", axes, {"y": 0.5, "v": 3.0}, QUICK)


def pair() -> atlas.Spec:
    """A free mass in a shaken box: its symmetric orbit breaks symmetry."""
    axes = {"nu": {"start": 0.5, "stop": 5.5, "num": 10}, "R": {"start": 0.4, "stop": 0.9, "num": 6}}
    return atlas.Spec("impact-pair", axes, solve=QUICK)


def found_serially(plane: CurvePlane, settings: CurveSettings | None = None) -> Curves:
    """The naive twin of ``find_curves``: every task at once, in order, in this process."""
    search = CurveSearch(plane, settings or CurveSettings())
    parts: dict[str, dict[str, Any]] = {}
    while tasks := search.tasks():
        for name, task in tasks.items():
            found = run_task(task, search.orbits, parts.__getitem__, lambda part: curve_from_json(parts[part]["curve"]))
            parts[name] = json.loads(json.dumps(found))
        search.add_results([parts[name] for name in tasks])
    return finish_search(search)


def same(one: Curve, other: Curve) -> bool:
    """Whether two curves are equal to the bit."""
    arrays = ("points", "unstable", "impacts_upper", "impacts_lower")
    equal = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)
    rest = [{name: value for name, value in vars(curve).items() if name not in arrays} for curve in (one, other)]
    return equal and rest[0] == rest[1]


def all_same(one: Curves, other: Curves) -> bool:
    """Whether two tables of curves, and all that is said of them, are equal to the bit."""
    equal = len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return equal and one.axes == other.axes and dict(one.report) == dict(other.report)
