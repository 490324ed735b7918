"""Chains of 3 to 8 equal masses: the entries of their definition that depend on the number of masses."""

from collections.abc import Mapping
from typing import Any

import numpy as np

CHAINS = {f"chain-{n}": n for n in range(3, 9)}
"""Number of masses by the name of the system."""


def chain(common: Mapping[str, Any], n: int) -> dict[str, Any]:
    """Return the definition of n masses on springs in a row, the first tied to the ground.

    M = I, K = [[2, -1], [-1, 2, -1], ..., [-1, 1]], C = 2 zeta K. The force acts on the first mass, and the stop on the
    last. ``common`` has the entries that all chains share.
    """
    stiffness = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    stiffness[-1, -1] = 1.0
    unit = np.eye(n).tolist()
    parameters = dict(common["parameters"])
    for i in range(n):
        parameters[f"x{i + 1}"] = {"meaning": f"initial displacement of mass {i + 1}"}
        parameters[f"v{i + 1}"] = {"meaning": f"initial velocity of mass {i + 1}"}
    return {
        **common,
        "name": f"chain-{n}",
        "title": f"{n} {common['title']}",
        "coordinates": [f"x{i + 1}" for i in range(n)],
        "mass": unit,
        "damping": [[f"{2.0 * entry} * zeta" if entry else 0.0 for entry in row] for row in stiffness.tolist()],
        "stiffness": stiffness.tolist(),
        "force": ["F", *([0.0] * (n - 1))],
        "gap": unit[-1],
        "parameters": parameters,
    }
