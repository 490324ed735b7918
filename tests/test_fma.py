"""One rounding for a product and a sum."""

from fractions import Fraction

import numpy as np

from workers.kernel.fma import fma
from workers.kernel.jit import kernel


@kernel
def sums(a, b, c, out):
    """fma of each."""
    for i in range(len(a)):
        out[i] = fma(a[i], b[i], c[i])


def test_product_and_sum_are_rounded_once() -> None:
    """c takes all but the last digits of a b away, so that a product rounded first would leave nothing right."""
    a, b = np.random.default_rng(3).uniform(1.0, 2.0, (2, 500))
    c, out = -a * b, np.empty(500)
    sums(a, b, c, out)
    exact = [float(Fraction(x) * Fraction(y) + Fraction(z)) for x, y, z in zip(a, b, c, strict=True)]
    assert out.tolist() == exact
    assert np.count_nonzero(out) > 400
