"""Oscillators made by hand as records of workers.continuation, and the reference points of tests/data/curves.json."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import ImpactMotion
from workers.continuation.events import Event, Point
from workers.continuation.extended import GRAZE, MINUS_ONE, PAIR, UNIT, Condition
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.oscillator import Family, ModalOscillator, family_of
from workers.continuation.stability import pieces
from workers.model.oscillator import COLUMN, NUMBER, OF_FLOW, OF_GUARD, Mode, make_blocks
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
    lin = family.model(values[None])
    crest = 0.5 * math.pi - math.atan2(lin.gap.cos_part[0, 0], lin.gap.sin_part[0, 0]) - lin.tau[0]
    return float(crest / lin.omega[0])


def exponents(motion: ImpactMotion) -> Array:
    """Lyapunov exponents (N, 2n) per forcing period, largest first: ln|multipliers|, whatever their spread.

    The eigenvalues of the cyclic matrix of the factors of a turn are the roots of the multipliers: none is lost
    beside another as in the product of the factors.
    """
    factors, itinerary = pieces(motion), motion.itinerary
    N, m, size = factors.shape[:3]
    cyclic = np.zeros((N, m * size, m * size))
    for i in range(m):
        after = (i + 1) % m
        cyclic[:, after * size : (after + 1) * size, i * size : (i + 1) * size] = factors[:, i]
    with np.errstate(divide="ignore"):
        logs = -np.sort(-np.log(np.abs(np.linalg.eigvals(cyclic))), axis=1)
    periods = itinerary.periods * (0.5 if itinerary.symmetric else 1.0)
    return np.asarray(logs.reshape(N, size, m).sum(2) / periods)


def oscillator(
    eta: Array,
    lam: Array,
    c: Array,
    k: Array,
    waves: Array,
    load: Array,
    stops: tuple[Array, Array],
    omega: Array,
    tau: Array,
    R: Array,
) -> ModalOscillator:
    """N oscillators: blocks (N, n), gap rows c and kick columns k (N, n, 2), waves (2, N, H), stops (upper, lower).

    Bounds of the signal are left out: its crossings are not certified.
    """
    N, n = eta.shape
    row1 = np.stack([-lam * c[..., 1], c[..., 0] - 2.0 * eta * c[..., 1]], axis=-1)
    kick1 = np.stack([k[..., 1], -lam * k[..., 0] - 2.0 * eta * k[..., 1]], axis=-1)
    blocks = make_blocks(eta, lam)
    blocks[..., COLUMN.load] = load
    blocks[..., OF_FLOW:OF_GUARD] = np.concatenate([c, row1, k, kick1, np.zeros((N, n, 2))], axis=-1)
    numbers = np.full((N, len(NUMBER)), np.nan)
    numbers[:, NUMBER.omega] = omega
    gap = Mode(blocks, np.stack(waves, axis=-1), numbers, np.zeros((N, n, 2, waves.shape[2], 2)))
    return ModalOscillator(gap, *stops, tau, R)


def ball_between(
    free: tuple[str, ...], fixed: dict[str, float], wave: str, load: float, upper: float, lower: float
) -> Family:
    """A free mass between stops under a load, y measured from a table that shakes; the parameter ``wave`` says how."""

    def model(rows: Array) -> ModalOscillator:
        N = len(rows)
        given = {name: np.full(N, value) for name, value in fixed.items()}
        given |= {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(free)}
        none = np.zeros((N, 1))
        waves = np.stack([-given[wave][:, None], none])
        stops = np.full(N, upper), np.full(N, lower)
        c, k = (np.tile(unit, (N, 1, 1)) for unit in np.eye(2))
        return oscillator(none, none, c, k, waves, none + load, stops, np.ones(N), np.zeros(N), given["R"])

    return Family(free, model, certified=False)


def bouncing_ball(free: tuple[str, ...], **fixed: float) -> Family:
    """y'' = -1 + A sin t above a table at y = 0; A is the relative acceleration Gamma."""
    return ball_between(free, fixed, "A", -1.0, np.inf, 0.0)


def impact_pair(free: tuple[str, ...], **fixed: float) -> Family:
    """y'' = alpha sin t between stops at -1/2 and 1/2."""
    return ball_between(free, fixed, "alpha", 0.0, 0.5, 0.5)


def general(seed: int = 1, harmonics: int = 2, rigid_damping: float = 0.3) -> ModalOscillator:
    """An oscillator with everything: coupled damping (both entries of c and k), a rigid mode, its load, harmonics."""
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
    waves, load = rng.normal(size=(2, 1, harmonics)), rng.normal(size=(1, 3)) * (lam == 0.0)
    stops = np.array([1.0]), np.array([0.7])
    at = np.array([1.7]), np.array([0.4]), np.array([0.6])
    return oscillator(eta, lam, c, kick.reshape(1, 3, 2), waves, load, stops, *at)
