"""Claims about motions that begin exactly at an end of a signal, with all the derivatives that rounding shows at zero.

Truth: the same machine with the end moved by 1e-12.
"""

from typing import Any

import numpy as np
import pytest

from workers import Settings, System, solve_tile

SETTINGS = Settings(exponents="none", max_periods=500, survival=0)


def pair(seed: int, **more: Any) -> System:
    """Two masses on springs at random, of which ``more`` says what moves the first and what the second meets."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(0.3, 2.0)
    return System.from_mapping({
        "name": "pair", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, rng.uniform(0.5, 2.0)]],
        "damping": [[0.15, 0.0], [0.0, 0.15]], "stiffness": [[1.0 + k, -k], [-k, k + 0.5]], **more,
        "parameters": {"end": 0.0},
    })  # fmt: skip


SOFT = {"contacts": [{"name": "stop", "gap": [0.0, 1.0], "upper": "end", "stiffness": 9.0, "damping": 0.1}]}
VERTEX = {"springs": [{"name": "kink", "row": [0.0, 1.0], "law": [[-2.0, -4.0], ["end", "2 * end"], [2.0, "2 + end"]]}]}


@pytest.mark.parametrize("met", [SOFT, VERTEX], ids=["soft contact", "vertex"])
@pytest.mark.parametrize("moved", [{"force": [0.3, 0.0]}, {"cosine": [0.3, 0.0]}, {"load": [0.3, 0.0]}], ids=str)
def test_a_motion_from_rest_at_an_end_is_that_from_beside_it(met: dict[str, Any], moved: dict[str, Any]) -> None:
    """The second mass leaves its place as t^4 or t^5. One in three of these cells took a million evaluations."""
    for seed in range(6):
        system = pair(seed, **met, **moved)
        there, beside = (solve_tile(system, {"end": end}, SETTINGS) for end in (0.0, 1e-12))
        assert there["reason"] == beside["reason"] == 0, seed
        assert there["regime"] == beside["regime"], seed
        np.testing.assert_allclose(there["state"], beside["state"], atol=1e-8, err_msg=str(seed))
