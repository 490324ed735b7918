"""Random cells over the whole parameter space of the two-mass oscillator."""

import math

import numpy as np

from scripts.stress.findings import Params, RandomCell

STATES = ("x1", "x2", "v1", "v2")


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A random number between two bounds, log-uniform."""
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


def draw(seed: int, number: int) -> RandomCell:
    """Cell ``number`` of a seed; depends on these two alone.

    Log-uniform: omega, mu_m, mu_k in 1e-3..1e3, zeta in 1e-4..50, b in 1e-6..1e6 of the response, for half of the
    cells in 1e-3..1, with impacts. Mixed in: no damping, resonance, critical damping, R = 0, R = 1 and next to it, no
    force on mass 1; starts inside, on a stop with every sign of velocity, and outside.
    """
    rng = np.random.default_rng([seed, number])
    R_kind, zeta_kind, f_kind, start = rng.random(4)
    p = {name: log_uniform(rng, 1e-3, 1e3) for name in ("omega", "mu_m", "mu_k")}
    p["R"] = float(rng.random())
    if R_kind < 0.08:
        p["R"] = 0.0
    elif R_kind < 0.16:
        p["R"] = 1.0
    elif R_kind < 0.20:
        p["R"] = 1.0 - log_uniform(rng, 1e-8, 1e-1)
    p["zeta"] = log_uniform(rng, 1e-4, 50.0)
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
    p["b"] = max(float(sizes[0]), 1e-30) * log_uniform(rng, *((1e-3, 1.0) if narrow else (1e-6, 1e6)))
    size = float(np.max(sizes)) * log_uniform(rng, 1e-2, 10.0)
    p["x1"] = p["b"] * float(rng.uniform(-1.0, 1.0))
    p["x2"], p["v1"], p["v2"] = (float(v) for v in size * rng.normal(size=3) * [1.0, p["omega"], p["omega"]])
    if start < 0.05:
        p["x1"] = p["x2"] = p["v1"] = p["v2"] = 0.0
    elif start < 0.25:
        p["x1"] = math.copysign(p["b"], p["x1"])
        p["v1"] *= float(rng.integers(2))
    elif start < 0.27:
        p["x1"] = math.copysign(p["b"] * (1.0 + log_uniform(rng, 1e-14, 10.0)), p["x1"])
    trace = 2.0 * p["zeta"] * (1.0 + (1.0 + p["mu_k"]) / p["mu_m"])
    return RandomCell(number, "two-mass", p, p, STATES, (1.0, 0.0), p["b"], -p["b"], trace)
