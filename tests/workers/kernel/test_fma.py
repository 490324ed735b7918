"""One rounding for a product and a sum, and in each step of a polynomial."""

from fractions import Fraction

import numpy as np

from workers.kernel.fma import fma, horner
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


def test_a_sum_that_is_zero_has_the_sign_of_the_compiled_one() -> None:
    signed = np.array([0.0, -0.0, 1.0, -1.0, 1e-200, -1e-200])
    a, b, c = (grid.ravel() for grid in np.meshgrid(signed, signed, signed))
    out = np.empty(len(a))
    sums(a, b, c, out)
    in_python = np.array([fma(*numbers) for numbers in zip(a.tolist(), b.tolist(), c.tolist(), strict=True)])
    assert in_python.tobytes() == out.tobytes()


@kernel
def cubic(x, out):
    """horner of each."""
    for i in range(len(x)):
        out[i] = horner((0.1, -0.7, 0.3, 1.1), x[i])


def test_a_polynomial_is_summed_from_its_highest_power_with_one_rounding_a_step() -> None:
    x = np.random.default_rng(4).uniform(-3.0, 3.0, 200)
    out = np.empty(200)
    cubic(x, out)
    assert out.tolist() == [fma(fma(fma(0.1, value, -0.7), value, 0.3), value, 1.1) for value in x]
    assert out.tolist() == [horner((0.1, -0.7, 0.3, 1.1), value) for value in x]
