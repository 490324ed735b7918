"""Shared by several entries: events of a branch, a cell's results as plain numbers, curves."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

import atlas
from workers import Settings, System, solve_tile
from workers.results import REGIME

Machine = str | System
Given = Mapping[str, float]
Window = tuple[float, float]
PERIODIC = Settings(survival=0, max_periods=4000)
"""Settings of cells with a stable orbit."""


def events(system: Machine, given: Given, along: str, window: Window, kind: str) -> list[float]:
    """Parameter values of events of a kind on the branch of a cell's orbit, ascending."""
    found = atlas.branch(given, along=along, window=window, system=system, settings=PERIODIC).events
    return sorted(found[along][found["kind"] == kind])


def event(system: Machine, given: Given, along: str, window: Window, kind: str) -> float:
    """The only event of a kind on the branch of a cell's orbit; NaN for none or several."""
    found = events(system, given, along, window, kind)
    return float(found[0]) if len(found) == 1 else float("nan")


def cell(system: Machine, given: Mapping[str, Any], settings: Settings = PERIODIC) -> dict[str, Any]:
    """The results of one cell; the regime by its name."""
    solved = {name: value.tolist() for name, value in solve_tile(system, given, settings).items()}
    return {**solved, "regime": REGIME.meaning(solved["regime"]).name}


@cache
def curves_of(example: str) -> Any:
    """The curves of a packaged plane, computed once per process: a data frame, one row per point."""
    with TemporaryDirectory() as folder:
        store = Path(folder) / "plane.zarr"
        atlas.run(atlas.Spec.from_toml(example), store)
        atlas.find_curves(store)
        return pd.concat(atlas.open(store).atlas.curves())  # points, and points of codimension two


def largest_difference(ours: Any, published: Any) -> float:
    """The largest modulus of the differences."""
    return float(np.max(np.abs(np.asarray(ours) - np.asarray(published))))
