"""Random cells over the whole parameter space of the two-mass oscillator, and what must hold of every solution."""

import math
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from workers import Settings
from workers.results import CHAOTIC, INVALID, NO_IMPACT, PERIODIC, QUASIPERIODIC, REGIMES
from workers.tile import solve_cells

Params = dict[str, float]

NAMES = {regime.code: regime.name for regime in REGIMES}
LISTED = 20
"""Cells of one kind of trouble that a report lists."""
POSITION = 1e-12
"""Share of b by which a position may lie beyond a stop."""
SUM_LAW = 1e-9
"""Defect of the sum law allowed to a periodic cell, in units of max(1, |trace(M^-1 C) T|)."""


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def matrices(p: Params) -> tuple[np.ndarray, np.ndarray]:
    """Mass (diagonal) and stiffness."""
    return np.array([1.0, p["mu_m"]]), np.array([[1.0, -1.0], [-1.0, 1.0 + p["mu_k"]]])


def frequencies(p: Params) -> np.ndarray:
    """Natural frequencies without stops, ascending."""
    mass, K = matrices(p)
    root = np.sqrt(mass)
    return np.asarray(np.sqrt(np.linalg.eigvalsh(K / np.outer(root, root))))


def response(p: Params) -> np.ndarray:
    """Amplitudes |x1|, |x2| of the forced motion without stops."""
    mass, K = matrices(p)
    w = p["omega"]
    stiffness = K * (1.0 + 2j * w * p["zeta"]) - w**2 * np.diag(mass)
    try:
        return np.asarray(np.abs(np.linalg.solve(stiffness, [1.0 - p["f2"], p["f2"]])))
    except np.linalg.LinAlgError:
        return np.ones(2)


def draw(seed: int, number: int) -> Params:
    """Cell ``number`` of a seed: it depends on these two alone.

    Log-uniform: omega, mu_m, mu_k in 1e-3..1e3, zeta in 1e-4..50, b in 1e-6..1e6 of the response, for half of the
    cells in 1e-3..1, where impacts are. Mixed in: no damping, resonance, critical damping, R = 0, R = 1 and next to
    it, no force on mass 1; starts inside, on a stop with every sign of velocity, and outside.
    """
    rng = np.random.default_rng([seed, number])
    R_kind, zeta_kind, f_kind, start = rng.random(4)
    p = {name: _log_uniform(rng, 1e-3, 1e3) for name in ("omega", "mu_m", "mu_k")}
    p["R"] = float(rng.random())
    if R_kind < 0.08:
        p["R"] = 0.0
    elif R_kind < 0.16:
        p["R"] = 1.0
    elif R_kind < 0.20:
        p["R"] = 1.0 - _log_uniform(rng, 1e-8, 1e-1)
    p["zeta"] = _log_uniform(rng, 1e-4, 50.0)
    mode = float(frequencies(p)[rng.integers(2)])
    if zeta_kind < 0.10:
        p["zeta"] = 0.0
    elif zeta_kind < 0.14:
        p["zeta"] = 1.0 / mode
    elif zeta_kind < 0.16:
        p["zeta"], p["omega"] = 0.0, mode
    p["f2"] = 0.0 if f_kind < 0.4 else 1.0 if f_kind < 0.5 else float(rng.normal(0.0, 2.0))
    p["tau"] = float(rng.uniform(0.0, 2.0 * math.pi))
    sizes = response(p)
    narrow = rng.random() < 0.5
    p["b"] = max(float(sizes[0]), 1e-30) * _log_uniform(rng, *((1e-3, 1.0) if narrow else (1e-6, 1e6)))
    size = float(np.max(sizes)) * _log_uniform(rng, 1e-2, 10.0)
    p["x1"] = p["b"] * float(rng.uniform(-1.0, 1.0))
    p["x2"], p["v1"], p["v2"] = (float(v) for v in size * rng.normal(size=3) * [1.0, p["omega"], p["omega"]])
    if start < 0.05:
        p["x1"] = p["x2"] = p["v1"] = p["v2"] = 0.0
    elif start < 0.25:
        p["x1"] = math.copysign(p["b"], p["x1"])
        p["v1"] *= float(rng.integers(2))
    elif start < 0.27:
        p["x1"] = math.copysign(p["b"] * (1.0 + _log_uniform(rng, 1e-14, 10.0)), p["x1"])
    return p


@dataclass
class Findings:
    """What was found over a number of cells. Each listed cell is (what, number, parameters)."""

    cells: int = 0
    impacting: int = 0
    sticking: int = 0
    outside: int = 0
    seconds: float = 0.0
    regimes: Counter[str] = field(default_factory=Counter)
    invalid: Counter[str] = field(default_factory=Counter)
    stopped: Counter[str] = field(default_factory=Counter)
    listed: dict[str, list[tuple[str, int, Params]]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    worst: dict[str, tuple[float, int, Params]] = field(default_factory=dict)
    checked: Counter[str] = field(default_factory=Counter)
    samples: dict[str, list[float]] = field(default_factory=dict)

    def note(self, kind: str, what: str, number: int, params: Params) -> None:
        """Count a trouble and list its cell while there is room."""
        self.counts[kind] += 1
        cells = self.listed.setdefault(kind, [])
        if len(cells) < LISTED:
            cells.append((what, number, params))

    def record(self, kind: str, value: float, number: int, params: Params) -> None:
        """Keep the largest value of a kind."""
        if kind not in self.worst or value > self.worst[kind][0]:
            self.worst[kind] = (value, number, params)

    def sample(self, kind: str, value: float) -> None:
        """Add a value to a distribution."""
        self.samples.setdefault(kind, []).append(value)

    def add(self, other: "Findings") -> None:
        """Take in the findings over other cells."""
        for name in ("cells", "impacting", "sticking", "outside", "seconds"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("regimes", "invalid", "stopped", "counts", "checked"):
            getattr(self, name).update(getattr(other, name))
        for kind, cells in other.listed.items():
            self.listed[kind] = sorted(self.listed.get(kind, []) + cells, key=lambda cell: cell[1])[:LISTED]
        for kind, worst in other.worst.items():
            self.record(kind, *worst)
        for kind, values in other.samples.items():
            self.samples.setdefault(kind, []).extend(values)


def solve(seed: int, first: int, count: int, settings: Settings) -> Findings:
    """Solve cells first, first + 1, ... one by one, and check what each says against what must hold."""
    found = Findings()
    for number in range(first, first + count):
        params = draw(seed, number)
        begun = time.process_time()
        solution = solve_cells("two-mass", params, settings)
        seconds = time.process_time() - begun
        result = {name: value[()] for name, value in solution.arrays.items()}
        _count(found, number, params, result, next(iter(solution.reasons), ""), seconds)
        for trouble in misplaced(params, result):
            found.note("NaN or infinity where none belongs", trouble, number, params)
        _check_positions(found, number, params, result)
        _check_sum_law(found, number, params, result)
    return found


def _count(found: Findings, number: int, params: Params, result: dict[str, Any], reason: str, seconds: float) -> None:
    regime = NAMES[int(result["regime"])]
    found.cells += 1
    found.seconds += seconds
    found.regimes[regime] += 1
    found.sticking += bool(result["sticks"])
    found.impacting += bool(result["impacts_per_period"] > 0 or result["sticks"])
    found.record("periods", float(result["periods_used"]), number, params)
    found.record("seconds", seconds, number, params)
    if regime == "invalid":
        found.invalid[reason] += 1
    elif regime == "failed":
        found.stopped[reason] += 1
        found.note("failed", reason, number, params)
    elif reason:
        found.note("given up, said to be undetermined", reason, number, params)
    outside = abs(params["x1"]) > params["b"] and "resonance" not in reason
    found.outside += outside
    if outside != (reason == "the initial state lies beyond a stop"):
        found.note("a state beyond a stop not recognised", f"{regime}, {reason!r}", number, params)


def misplaced(params: Params, result: dict[str, Any]) -> list[str]:
    """Which results are NaN or infinite although their regime promises a number.

    -infinity belongs in the last places of the spectrum of a cell that sticks (two) or has R = 0 (one or two).
    """
    regime = int(result["regime"])
    wrong = [name for name, value in result.items() if np.any(np.asarray(value, dtype=float) == np.inf)]
    if regime not in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC):
        return wrong
    promised = ["largest", "error", "stuck_fraction", "state", "section"]
    if not result["sticks"]:
        promised.append("impacts_per_period")
        if params["R"] > 0.0 or regime == NO_IMPACT:
            promised.append("sum_law_defect")
    wrong += [name for name in promised if not np.all(np.isfinite(result[name]))]
    lost = int(np.sum(result["spectrum"] == -np.inf))
    most = 2 if result["sticks"] or (params["R"] == 0.0 and regime != NO_IMPACT) else 0
    if np.any(np.isnan(result["spectrum"])) or lost > most or (result["sticks"] and lost < 2 and regime == PERIODIC):
        wrong.append(f"spectrum {result['spectrum']}")
    if result["impacts_per_period"] > 0.0 and not math.isfinite(result["min_impact_speed"]):
        wrong.append("min_impact_speed")
    return wrong


def _check_positions(found: Findings, number: int, params: Params, result: dict[str, Any]) -> None:
    if int(result["regime"]) == INVALID:
        return
    positions = np.abs(np.append(result["section"][:, 0], result["state"][0]))
    positions = positions[np.isfinite(positions)]
    found.checked["section positions"] += len(positions)
    if np.any(positions > params["b"] * (1.0 + POSITION)):
        found.note("position beyond a stop", f"section |x1|/b = {positions.max() / params['b']!r}", number, params)


def _check_sum_law(found: Findings, number: int, params: Params, result: dict[str, Any]) -> None:
    defect = abs(float(result["sum_law_defect"]))
    if math.isnan(defect):
        return
    regime = NAMES[int(result["regime"])]
    trace = 2.0 * params["zeta"] * (1.0 + (1.0 + params["mu_k"]) / params["mu_m"])
    defect /= max(1.0, trace * 2.0 * math.pi / params["omega"])
    found.checked[f"sum law, {regime}"] += 1
    found.record(f"sum law, {regime}", defect, number, params)
    if regime == "periodic" and not defect <= SUM_LAW:
        found.note("sum law broken by a periodic cell", f"{defect:.2e}", number, params)
