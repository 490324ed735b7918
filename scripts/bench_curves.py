"""Points per second of curves of bifurcations and grazes, and what a point takes: Newton steps.

The curves go through bifurcation points of the two-mass system known to 40 digits, in the plane of omega and b. Timed
in processor time on one core, best of several.

With --plane, instead, all curves of the packaged plane omega-b, with one N-th of its cells along either axis: how many
there are, which share of the edges between regions they explain, and the processor time that finding them takes.

Usage: .venv/bin/python -m scripts.bench_curves [--light] [--plane N] [--json]
"""

import argparse
import json
import tomllib
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import atlas
from atlas.service.options import RunOptions
from atlas.spec.examples import example_text
from scripts.bench_kernel import one_core, processor_seconds
from workers.continuation import BranchRun, Condition, Event, Itinerary, Orbit, Point, curve, family_of
from workers.model.system import DEFAULT, find_system

FREE = ("omega", "b")
WINDOW = {"omega": (0.5, 4.5), "b": (0.02, 1.5)}

STARTS: list[tuple[str, Condition, dict[str, float], Itinerary, list[float], list[float], list[float]]] = [
    (
        "symmetry_breaking",
        Condition("minus_one"),
        {"omega": 1.8443244880291019, "b": 0.33, "R": 0.8},
        Itinerary((1,), 1, symmetric=True),
        [1.0189538951595758],
        [0.67299783747295054],
        [],
    ),
    (
        "period_doubling",
        Condition("minus_one"),
        {"omega": 3.3343080214883709, "b": 0.091, "R": 0.8},
        Itinerary((1, -1), 1),
        [0.74081358800280189, 1.2681160294691107],
        [0.4586481304901036, -0.44661801857786559],
        [],
    ),
    (
        "fold",
        Condition("unit"),
        {"omega": 2.0130904979164509, "b": 0.15, "R": 0.95},
        Itinerary((1, -1, -1), 1),
        [0.89577615092639928, 1.9346385850774050, 2.595966588408751],
        [0.6043537286396591, -0.26046116018718839, -0.26592798277093465],
        [],
    ),
    (
        "graze",
        Condition("graze", side=1),
        {"omega": 2.4445454740672967, "b": 0.15, "R": 0.417},
        Itinerary((1, -1), 1),
        [0.61962084865223321, 2.3291838269005394],
        [0.60266183234891193, -0.68173290040564009],
        [1.5096971767592138],
    ),
]
"""Kind and condition, parameters, itinerary, times, speeds and contact times of a point (tau = 0)."""


def measure(repeats: int, budget: int) -> list[dict[str, Any]]:
    """One row per curve."""
    rows = []
    for kind, condition, given, itinerary, times, speeds, contacts in STARTS:
        family = family_of(find_system(DEFAULT), {"tau": 0.0} | given, FREE)
        values = np.array([given[name] for name in FREE])
        orbit = Orbit(itinerary, np.array(times), np.array(speeds))
        event = Event(kind, (condition,), Point(values, orbit, np.array(contacts), np.zeros(0, dtype=complex), 0))
        found: list[BranchRun] = []
        curve(family, event, values, WINDOW, budget=2)  # compiles, or loads what an earlier run compiled

        def once(
            event: Event = event, family: Any = family, values: Any = values, found: list[BranchRun] = found
        ) -> None:
            found.append(curve(family, event, values, WINDOW, budget=budget))

        seconds = min(processor_seconds(once) for _ in range(repeats))
        run = found[0]
        rows.append(
            {
                "kind": kind,
                "points": len(run.points),
                "ends": list(run.ends),
                "events": [event.kind for event in run.events],
                "newton_steps_per_point": run.newton_steps / len(run.points),
                "points_per_second": len(run.points) / seconds,
            }
        )
    return rows


def of_plane(coarser: int) -> dict[str, Any]:
    """The curves of the packaged plane with 1 / coarser of its cells along either axis, found by one worker."""
    given = tomllib.loads(example_text("omega-b"))
    for axis in given["axes"].values():
        axis["num"] //= coarser
    with TemporaryDirectory() as folder:
        store = f"{folder}/plane.zarr"
        atlas.run(atlas.Spec.from_mapping(given), store, options=RunOptions(workers=1))
        found = atlas.find_curves(store, options=RunOptions(workers=1))
    told = found.as_dict()
    return {
        "cells": " x ".join(str(axis["num"]) for axis in given["axes"].values()),
        "edges": told["edges"]["regions"]["all"],
        "explained": told["explained"]["regions"],
        **{key: told[key] for key in ("curves", "points", "processor_seconds")},
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", action="store_true", help="ten points a way: seconds, rough numbers")
    parser.add_argument("--json", action="store_true", help="one JSON list on standard output, nothing else")
    parser.add_argument("--plane", type=int, metavar="N", help="the curves of the packaged plane, N times coarser")
    options = parser.parse_args()
    if options.plane:
        row = of_plane(options.plane)
        print(json.dumps([row]) if options.json else "\n".join(f"{key}: {value}" for key, value in row.items()))
        return
    one_core()
    rows = measure(1, 10) if options.light else measure(3, 2000)
    if options.json:
        print(json.dumps(rows))
        return
    print("| curve | points | Newton steps a point | points a second | ends |")
    print("|---|---|---|---|---|")
    for row in rows:
        numbers = f"{row['points']} | {row['newton_steps_per_point']:.2f} | {row['points_per_second']:.0f}"
        print(f"| {row['kind']} | {numbers} | {', '.join(row['ends'])} |")


if __name__ == "__main__":
    main()
