"""How many cells that are called chaotic settle later, against what watching them costs.

Each plane is solved with several settings of ``survival``, and once without exponents but every cell watched for very
long: what that finds settled is taken as the truth. ``wrong`` is the share of the cells called chaotic that settle
within 80,000 further periods, with its 95 % interval (Wilson); ``of all`` the same cells as a share of the whole plane;
``undecided`` the share of undetermined cells; ``periods`` the mean cost of a cell, without those that proofs of orbits
take.

Usage: python -m scripts.bench_survival [--light] [--planes PARTS] [--keep]
"""

import argparse
import multiprocessing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.measured import header, keep_table, line, parsed
from workers import Settings, solve_tile
from workers.attractors.initial_states import wilson
from workers.cell.cell_batch import CellBatch
from workers.cell.schedule import AdaptiveSchedule
from workers.model.system import DEFAULT, find_system
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, UNDETERMINED, result_variables
from workers.tile import result_arrays

FURTHER = 80_000
"""Periods after a verdict in which a settled motion makes it wrong."""

SETTLED = (NO_IMPACT, PERIODIC)

PLANES: dict[str, dict[str, Any]] = {
    "packaged omega-b": {"omega": (1.0, 4.5), "b": (0.05, 0.6)},
    "omega-R, zeta .005": {"omega": (1.5, 4.5), "R": (0.9, 1.0), "zeta": 0.005, "b": 0.3, "mu_k": 5.0, "mu_m": 2.0},
    "zeta 1e-4, omega-R": {"omega": (1.5, 4.5), "R": (0.99, 1.0), "zeta": 1e-4, "b": 0.3, "mu_k": 5.0, "mu_m": 2.0},
    "R near 1, omega-b": {"omega": (1.0, 4.5), "b": (0.05, 0.6), "R": 0.97},
    "low damping, omega-b": {"omega": (1.0, 4.5), "b": (0.05, 0.6), "zeta": 0.01, "R": 0.7},
    "soft-impact, omega-a": {"system": "soft-impact", "omega": (0.6, 1.2), "a": (0.2, 1.0)},
    "capsule, omega-alpha": {"system": "capsule", "omega": (0.3, 1.6), "alpha": (0.2, 3.0)},
}
"""Parameters of each plane; of another system than the default one also its name."""

DESCRIBED = {
    "packaged omega-b": "omega 1 to 4.5, b .05 to .6 (`omega-b`: R .8, zeta .05)",
    "omega-R, zeta .005": "omega 1.5 to 4.5, R .9 to 1; zeta .005, b .3",
    "zeta 1e-4, omega-R": "omega 1.5 to 4.5, R .99 to 1; zeta 1e-4, b .3",
    "R near 1, omega-b": "as the first, R .97",
    "low damping, omega-b": "as the first, R .7, zeta .01",
    "soft-impact, omega-a": "`soft-impact`: omega .6 to 1.2, a .2 to 1",
    "capsule, omega-alpha": "`capsule`: omega .3 to 1.6, alpha .2 to 3",
}
"""The planes in words."""


def plane(name: str, side: int) -> dict[str, NDArray[Any] | float]:
    """Parameters of a plane of side x side cells, flat."""
    given = {key: value for key, value in PLANES[name].items() if key != "system"}
    axes = [key for key, value in given.items() if isinstance(value, tuple)]
    grids = np.meshgrid(*(np.linspace(given[key][0], given[key][1], side) for key in axes))
    return {**given, **{key: grid.ravel() for key, grid in zip(axes, grids, strict=True)}}


def solved(
    pool: Any, params: dict[str, Any], settings: Settings, pieces: int = 8, system: str = DEFAULT
) -> dict[str, NDArray[Any]]:
    """Results of flat cells."""
    count = max(np.size(value) for value in params.values())
    parts = [np.arange(k, count, pieces) for k in range(min(pieces, count))]
    works = [(system, {k: v[part] if np.size(v) > 1 else v for k, v in params.items()}, settings) for part in parts]
    found = pool.starmap(solve_tile, works, chunksize=1)
    arrays = {name: np.empty((count, *a.shape[1:]), a.dtype) for name, a in found[0].items()}
    for part, piece in zip(parts, found, strict=True):
        for name, values in piece.items():
            arrays[name][part] = values
    return arrays


def _follow(work: tuple[str, dict[str, NDArray[Any]], int]) -> dict[str, NDArray[Any]]:
    system, params, periods = work
    record, settings = find_system(system), Settings(exponents="none", survival=periods)
    count = max(np.size(value) for value in params.values())
    flat = {p.name: np.broadcast_to(params.get(p.name, p.default), count).copy() for p in record.parameters}
    oscillators, reasons = record.build_many(flat)
    found = result_arrays(result_variables(settings), settings, count, len(record.states))
    starts = np.stack([flat[name] for name in record.states], axis=-1)
    cells = CellBatch(oscillators, reasons, starts, settings, found)
    course = AdaptiveSchedule(
        cells, survival_share_of=np.ones_like
    )  # whatever looks chaotic is watched for all of ``survival``
    with np.errstate(all="ignore"):
        course.run()
    return found


def followed(
    pool: Any, params: dict[str, Any], periods: int, pieces: int = 32, system: str = DEFAULT
) -> dict[str, NDArray[Any]]:
    """The results of flat cells that are all watched for so many periods."""
    count = max(np.size(value) for value in params.values())
    full = {name: np.broadcast_to(value, count) for name, value in params.items()}
    parts = np.array_split(np.arange(count), min(pieces, count))
    works = [(system, {k: v[part] for k, v in full.items()}, periods) for part in parts]
    found = pool.map(_follow, works, chunksize=1)
    return {name: np.concatenate([piece[name] for piece in found]) for name in found[0]}


def measure(pool: Any, name: str, side: int, survivals: list[int], far: int, tolerance: float) -> list[dict[str, Any]]:
    """One row for each survival."""
    params, system = plane(name, side), PLANES[name].get("system", DEFAULT)
    truth = followed(pool, params, far, system=system)
    settles = np.isin(truth["regime"], SETTLED)
    rows = []
    for survival in survivals:
        found = solved(pool, params, Settings(tolerance=tolerance, survival=survival), system=system)
        chaotic = found["regime"] == CHAOTIC
        later = truth["periods_used"] <= found["periods_used"] + FURTHER
        wrong = chaotic & settles & later
        count = len(chaotic)
        rows.append(
            {
                "plane": name,
                "survival": survival,
                "chaotic": int(chaotic.sum()),
                "wrong": int(wrong.sum()),
                "wrong_share": wrong.sum() / max(chaotic.sum(), 1),
                "interval": tuple(map(float, wilson(int(wrong.sum()), int(chaotic.sum())))),
                "wrong_of_all": wrong.sum() / count,
                "undetermined": (found["regime"] == UNDETERMINED).sum() / count,
                "periods": float(found["periods_used"].mean()),
            }
        )
    return rows


HEAD = ("plane", "`survival`", "chaotic", "wrong, % of them", "of all, %", "undetermined, %", "periods a cell")


def cells_of(row: dict[str, Any], first: bool) -> list[str]:
    """A row of the table; ``first`` is that of a plane, whose name it has. The default survival is set bold."""
    low, high = row["interval"]
    survival = f"{row['survival']:,}"
    return [
        DESCRIBED[row["plane"]] if first else "",
        f"**{survival}**" if row["survival"] == Settings().survival else survival,
        str(row["chaotic"]),
        f"{100 * row['wrong_share']:.2f} ({100 * low:.1f} to {100 * high:.1f})",
        f"{100 * row['wrong_of_all']:.2f}",
        f"{100 * row['undetermined']:.2f}",
        f"{row['periods']:,.0f}",
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", action="store_true", help="few cells, short: rough numbers in seconds")
    parser.add_argument("--side", type=int, default=32, help="cells along each axis")
    parser.add_argument("--far", type=int, default=120_000, help="periods for which all are watched for the truth")
    parser.add_argument("--planes", default="", help="parts of names of planes, by comma; all by default")
    parser.add_argument("--survivals", default="0,16000,48000,160000")
    parser.add_argument("--tolerance", type=float, default=0.02)
    options = parsed(parser)
    side, far = (6, 4000) if options.light else (options.side, options.far)
    survivals = [0, 4000] if options.light else [int(s) for s in options.survivals.split(",")]
    chosen = [name for name in PLANES if any(part in name for part in options.planes.split(","))]
    rows: list[list[str]] = []
    print(header(HEAD))
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for name in chosen:
            for k, row in enumerate(measure(pool, name, side, survivals, far, options.tolerance)):
                rows.append(cells_of(row, first=k == 0))
                print(line(rows[-1]), flush=True)
    if options.keep:
        keep_table("survival-modes" if all("system" in PLANES[name] for name in chosen) else "survival", HEAD, rows)


if __name__ == "__main__":
    main()
