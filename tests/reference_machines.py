"""Families of machines of closed forms, the reference points of tests/data/curves.json, and exponents of orbits."""

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.paths import DATA
from workers.continuation.events import Event, SolutionPoint
from workers.continuation.extended_system import GRAZE, MINUS_ONE, PAIR, UNIT, Condition
from workers.continuation.families import Family, family_of
from workers.continuation.itinerary import Itinerary, Orbit
from workers.model.family import OrbitMachines
from workers.model.hybrid_modes import FLYING
from workers.model.system import find_system

TWO_MASS = find_system("two-mass")

Array = NDArray[np.float64]

CURVES: list[dict[str, Any]] = json.loads((DATA / "curves.json").read_text())["points"]
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
    point = SolutionPoint(values, reference_orbit(record), np.array(contacts), np.zeros(0, dtype=np.complex128), 0)
    return family, Event(record["kind"], tuple(conditions), point, kappa), values


def waves(lin: OrbitMachines) -> Array:
    """The forced part (N, H, 2) of y without impacts, as amplitudes of sines and cosines."""
    return lin.mode(FLYING).waves[:, 0]


def amplitude(lin: OrbitMachines) -> Array:
    """The amplitude (N,) of y without impacts, under a force of one harmonic."""
    return np.asarray(np.hypot(*waves(lin)[:, 0].T))


def upper_peak(family: Family, values: Array) -> float:
    """When the motion without impact is largest."""
    lin = family.model(values[None])
    sin, cos = waves(lin)[0, 0]
    return float((0.5 * math.pi - math.atan2(cos, sin) - lin.tau[0]) / lin.omega[0])


def bouncing_ball(free: tuple[str, ...], **fixed: float) -> Family:
    """y'' = -1 + A sin t above a table at y = 0; A is the relative acceleration Gamma. Orbits need not exist."""
    given = {"omega": 1.0, "tau": 0.0} | fixed
    return family_of(find_system("bouncing-ball"), given, free)._replace(certified=False)


def impact_pair(free: tuple[str, ...], **fixed: float) -> Family:
    """y'' = alpha sin t between stops at -1/2 and 1/2. Orbits need not exist."""
    given = {"omega": 1.0, "tau": 0.0, "nu": 1.0} | fixed
    return family_of(find_system("impact-pair"), given, free)._replace(certified=False)
