"""The proof that motion meets no guard again, against motions whose reach is known in closed form."""

import math

import numpy as np
import pytest

from workers.model.oscillator import OF_FLOW, OF_GUARD, make_blocks
from workers.orbit.escape import BEHIND, INSIDE, REACHED, future_of

UNFORCED = np.array([1.0, 0.0, 0.0, 0.0, 0.0])


def blocks_of(lam: list[float]) -> np.ndarray:
    """Undamped blocks q'' + lam q = 0 whose displacements add up to the signal."""
    blocks = make_blocks(np.zeros(len(lam)), np.array(lam))
    for block, stiffness in zip(blocks, lam, strict=True):
        block[OF_FLOW:OF_GUARD] = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -stiffness, 0.0]
    return blocks


@pytest.mark.parametrize(("end", "future"), [(1.0 + 1e-9, INSIDE), (1.0 - 1e-9, REACHED)])
def test_a_swing_stays_between_ends_that_lie_beyond_its_amplitude_and_no_others(end: float, future: int) -> None:
    """y = 0.6 cos(s) + 0.8 sin(s), of amplitude 1."""
    assert future_of(blocks_of([1.0]), UNFORCED, np.array([[0.6, 0.8]]), 0.0, -end, end) == future


@pytest.mark.parametrize(
    ("low", "high", "future"),
    [(-1.0, math.inf, BEHIND), (-math.inf, 9.0, REACHED), (-1.0, 9.0, REACHED), (1.5, math.inf, REACHED)],
)
def test_growth_leaves_the_end_behind_it_and_reaches_the_one_before_it(low: float, high: float, future: int) -> None:
    """y = e^s + cos(s) / 2 from 3/2 on."""
    h = np.array([[1.0, 1.0], [0.5, 0.0]])
    assert future_of(blocks_of([-1.0, 1.0]), UNFORCED, h, 0.0, low, high) == future
