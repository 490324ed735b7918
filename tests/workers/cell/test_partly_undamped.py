"""Impact-free motion of a machine that is damped in some modes only: the others go on for ever."""

import numpy as np
import pytest

from workers import Settings, System, solve_tile
from workers.results import NO_IMPACT

RELATIVE = {
    "name": "relative-damper",
    "coordinates": ["x1", "x2"],
    "mass": [[1.0, 0.0], [0.0, 1.0]],
    "damping": [[0.1, -0.1], [-0.1, 0.1]],
    "stiffness": [[3.0, -1.0], [-1.0, 3.0]],
    "force": [0.3, -0.3],
    "gap": [1.0, 0.0],
    "upper": 5.0,
    "lower": -5.0,
    "restitution": 0.8,
}
"""Two equal masses: moving together, the damper between them does nothing, nor does the force."""


def test_the_undamped_mode_keeps_its_energy_and_the_damped_one_its_forced_motion() -> None:
    start = {"omega": 1.0, "tau": 0.0, "x1": 1.3, "x2": 0.7}
    found = solve_tile(System.from_mapping(RELATIVE), start, Settings(exponents="spectrum"))
    x1, x2, v1, v2 = found["state"]
    assert found["regime"] == NO_IMPACT
    # Together: q = (x1 + x2) / 2 with q'' + 2 q = 0, from q = 1 at rest.
    assert ((x1 + x2) / 2) ** 2 + ((v1 + v2) / 2) ** 2 / 2 == pytest.approx(1.0, rel=1e-12)
    # Against each other: r = (x1 - x2) / 2 with r'' + .2 r' + 4 r = .3 sin t.
    answer = 0.3 / complex(4.0 - 1.0, 0.2)
    assert ((x1 - x2) / 2, (v1 - v2) / 2) == pytest.approx((answer.imag, answer.real), rel=1e-12)
    assert np.sort(found["spectrum"])[::-1] == pytest.approx(2 * np.pi * np.array([0.0, 0.0, -0.1, -0.1]), abs=1e-12)
