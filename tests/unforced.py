"""Machines without a force that several tests solve."""

from typing import Any

import numpy as np

from workers import System


def machine(**entries: Any) -> System:
    """A mass of 1 on a spring of 1."""
    mass = {"name": "mass", "coordinates": ["x"], "mass": [[1.0]], "stiffness": [[1.0]]}
    return System.from_mapping(mass | entries)


def random_pair(seed: int) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Matrices, friction and stop of two masses at random, one on a belt and the other driven against the stop."""
    rng = np.random.default_rng(seed)
    k, c, d = rng.uniform(0.3, 2.0), rng.uniform(0.0, 0.1), rng.uniform(-0.15, -0.02)
    rigid = bool(rng.integers(2))
    how = {"restitution": rng.uniform(0.3, 0.9)} if rigid else {"stiffness": rng.uniform(5, 20), "damping": 0.1}
    rub = {"row": [1.0, 0.0], "kinetic": rng.uniform(0.2, 0.6), "static": 1.0, "belt": rng.uniform(0.1, 0.6)}
    matrices = {
        "mass": [[1.0, 0.0], [0.0, rng.uniform(0.5, 2.0)]], "damping": [[c, 0.0], [0.0, d]],
        "stiffness": [[1.0 + k, -k], [-k, k + 0.5]],
    }  # fmt: skip
    return matrices, rub, how | {"upper": rng.uniform(0.3, 1.0)}


def pair_of(matrices: dict[str, Any], rub: dict[str, Any], stop: dict[str, Any]) -> System:
    """The machine of what ``random_pair`` gives."""
    return System.from_mapping({
        "name": "pair", "coordinates": ["x1", "x2"], **matrices, "friction": [{"name": "belt", **rub}],
        "contacts": [{"name": "stop", "gap": [0.0, 1.0], **stop}],
    })  # fmt: skip
