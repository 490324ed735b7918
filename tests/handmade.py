"""Oscillators made by hand as records of workers.continuation, and the reference points of tests/data/curves.json."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import Itinerary, Orbit
from workers.continuation.events import Event, Point
from workers.continuation.extended import GRAZE, MINUS_ONE, PAIR, UNIT, Condition
from workers.continuation.linear import Family, ModalOscillator, family_of
from workers.model.system import find_system

TWO_MASS = find_system("two-mass")

Array = NDArray[np.float64]

CURVES: list[dict[str, Any]] = json.loads((Path(__file__).parent / "data" / "curves.json").read_text())["points"]
"""Bifurcation points of the two-mass system: 40-digit residuals, confirmed by following their stable sides."""

CONDITIONS = {
    "fold": UNIT,
    "symmetry_breaking": MINUS_ONE,
    "period_doubling": MINUS_ONE,
    "neimark_sacker": PAIR,
    "graze": GRAZE,
}


def reference_name(record: dict[str, Any]) -> str:
    kinds = "-".join(kind.split()[0] for kind in record.get("conditions") or [record["kind"]])
    return f"{kinds} {record['point']['omega']}"


def reference_values(record: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in record["params"].items()} | {"tau": 0.0}


def reference_orbit(record: dict[str, Any]) -> Orbit:
    """The orbit; without impacts in its symmetric form."""
    none = not record["times"]
    itinerary = Itinerary(tuple(record["sides"]), record["period"], record["half_map"] or none)
    times, speeds = (np.array([float(x) for x in record[key]]) for key in ("times", "speeds"))
    return Orbit(itinerary, times, speeds)


def reference_event(record: dict[str, Any], free: tuple[str, ...]) -> tuple[Family, Event, Array]:
    """The event at a reference point, over these parameters, and their values there."""
    given = reference_values(record)
    family = family_of(TWO_MASS, given, free)
    values = np.array([given[name] for name in free])
    kappa, contacts, conditions = math.nan, [], []
    for kind in record.get("conditions") or [record["kind"]]:
        name = kind.split()[0]
        if name == "graze":
            contacts.append(float(record["extra"][0]) if record["extra"] else upper_peak(family, values))
        if name == "neimark_sacker":
            kappa = float(record["extra"][0])
        conditions.append(Condition(CONDITIONS[name], side=1, kappa=0.0 if math.isnan(kappa) else kappa))
    point = Point(values, reference_orbit(record), np.array(contacts), np.zeros(0, dtype=np.complex128), 0)
    return family, Event(record["kind"], tuple(conditions), point, kappa), values


def upper_peak(family: Family, values: Array) -> float:
    """When the motion without impact is largest."""
    lin = family.model(values[None])[0]
    crest = 0.5 * math.pi - math.atan2(lin.cos_part[0, 0], lin.sin_part[0, 0]) - lin.tau[0]
    return float(crest / lin.omega[0])


def bouncing_ball(free: tuple[str, ...], **fixed: float) -> Family:
    """y'' = -1 + A sin t above a table at y = 0; A is the relative acceleration Gamma."""

    def model(rows: Array) -> tuple[ModalOscillator, None]:
        N = len(rows)
        given = {name: np.full(N, value) for name, value in fixed.items()}
        given |= {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(free)}
        one, none = np.ones(N), np.zeros(N)
        return ModalOscillator(
            eta=none[:, None],
            lam=none[:, None],
            c=np.tile([[1.0, 0.0]], (N, 1, 1)),
            k=np.tile([[0.0, 1.0]], (N, 1, 1)),
            sin_part=-given["A"][:, None],
            cos_part=none[:, None],
            load=-one[:, None],
            upper=np.full(N, np.inf),
            lower=none,
            omega=one,
            tau=none,
            R=given["R"],
            trace=none,
        ), None

    return Family(free, model)


def impact_pair(free: tuple[str, ...], **fixed: float) -> Family:
    """y'' = alpha sin t between stops at -1/2 and 1/2."""

    def model(rows: Array) -> tuple[ModalOscillator, None]:
        N = len(rows)
        given = {name: np.full(N, value) for name, value in fixed.items()}
        given |= {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(free)}
        none = np.zeros(N)
        return ModalOscillator(
            eta=none[:, None],
            lam=none[:, None],
            c=np.tile([[1.0, 0.0]], (N, 1, 1)),
            k=np.tile([[0.0, 1.0]], (N, 1, 1)),
            sin_part=-given["alpha"][:, None],
            cos_part=none[:, None],
            load=none[:, None],
            upper=np.full(N, 0.5),
            lower=np.full(N, 0.5),
            omega=np.ones(N),
            tau=none,
            R=given["R"],
            trace=none,
        ), None

    return Family(free, model)


def general(seed: int = 1, harmonics: int = 2, rigid_damping: float = 0.3) -> ModalOscillator:
    """An oscillator with everything: coupled damping (both entries of c and k), a rigid mode, loads, harmonics."""
    rng = np.random.default_rng(seed)
    eta = np.array([[0.2, 3.0, rigid_damping]])
    lam = np.array([[2.5, 4.0, 0.0]])
    c, k = rng.normal(size=(1, 3, 2)), rng.normal(size=(1, 3, 2))
    c[0, 2, 1] = k[0, 2, 0] = 0.0
    row, row1 = c[0].ravel(), np.stack([-lam[0] * c[0, :, 1], c[0, :, 0] - 2.0 * eta[0] * c[0, :, 1]], -1).ravel()
    free = np.array([0, 1, 2, 3, 5])  # k of the rigid mode stays a velocity
    rows = np.stack([row, row1])[:, free]
    flat = k[0].ravel()[free]
    flat += np.linalg.lstsq(rows, np.array([0.0, 1.0]) - rows @ flat, rcond=None)[0]
    kick = np.zeros(6)
    kick[free] = flat
    return ModalOscillator(
        eta=eta,
        lam=lam,
        c=c,
        k=kick.reshape(1, 3, 2),
        sin_part=rng.normal(size=(1, harmonics)),
        cos_part=rng.normal(size=(1, harmonics)),
        load=rng.normal(size=(1, 3)),
        upper=np.array([1.0]),
        lower=np.array([0.7]),
        omega=np.array([1.7]),
        tau=np.array([0.4]),
        R=np.array([0.6]),
        trace=2.0 * eta.sum(1),
    )
