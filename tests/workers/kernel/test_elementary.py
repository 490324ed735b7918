"""exp, log, sin and cos of the vector loops, against 40-digit arithmetic."""

import ast
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp

from tests.oscillators import mass_spring
from workers.kernel import elementary
from workers.kernel.elementary import cosc_sinc, exp, exp_minus, log, sin_cos
from workers.model.oscillator import COLUMN, LARGEST_ANGLE, make_blocks

EPS = 2.0**-52


def angles(count: int) -> np.ndarray:
    """Angles of every size up to the largest, and doubles next to multiples of pi / 2, where sin or cos is tiny."""
    rng = np.random.default_rng(1)
    random = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-8, math.log10(LARGEST_ANGLE), count)
    return np.concatenate([[0.0], random, rng.integers(1, 1.9e7, count) * (math.pi / 2)])


def test_sine_and_cosine_are_right_to_an_ulp_of_one_up_to_the_largest_angle() -> None:
    with mp.workdps(40):
        for x in angles(2000).tolist():
            s, c = sin_cos(x)
            assert abs(s - mp.sin(x)) <= EPS
            assert abs(c - mp.cos(x)) <= EPS


def test_small_sines_keep_their_digits() -> None:
    """Also just next to the multiples of pi, where the reduction has to carry three parts of pi / 2."""
    with mp.workdps(40):
        for k in (0, 1, 2, 1000, 123_456, 9_000_001):
            for x in (k * math.pi + 1e-9, k * math.pi + 1e-3):
                assert abs(sin_cos(x)[0] / mp.sin(x) - 1) <= 1.5 * EPS


def test_the_exponential_is_right_to_an_ulp() -> None:
    with mp.workdps(40):
        for x in [0.0, *np.linspace(0.0, 700.0, 3001).tolist(), *np.geomspace(1e-20, 1.0, 200).tolist()]:
            assert abs(exp_minus(x) / mp.exp(-x) - 1) <= 1.2 * EPS


def test_the_exponential_of_either_sign_is_right_to_two_ulps() -> None:
    with mp.workdps(40):
        for x in [0.0, *np.linspace(-700.0, 700.0, 3001).tolist(), -1e-20, 1e-20]:
            assert abs(exp(x) / mp.exp(x) - 1) <= 2.0 * EPS
    assert (exp(-math.inf), exp(math.inf)) == (0.0, math.inf) and math.isnan(exp(math.nan))


def test_kernels_call_the_c_library_for_lengths_of_pairs_alone() -> None:
    """hypot bounds turning points and multipliers; square roots are correctly rounded by the processor.

    Truth: the syntax of workers/kernel, whose only exponentials, logarithms, sines and cosines are its own.
    """
    exact = {"sqrt", "floor", "isfinite", "isnan", "copysign", "frexp", "ldexp", "abs"}
    found = set()
    for source in sorted(Path(elementary.__file__).parent.rglob("*.py")):
        functions = [node for node in ast.parse(source.read_text()).body if isinstance(node, ast.FunctionDef)]
        for node in (node for function in functions for node in ast.walk(function)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                module, name = getattr(node.func.value, "id", ""), node.func.attr
                if module in ("math", "cmath") or (module == "np" and isinstance(getattr(np, name), np.ufunc)):
                    found |= {name} - exact
    assert found <= {"hypot", "sign"}


def test_the_exponential_ends_in_zero() -> None:
    assert exp_minus(709.0) == exp_minus(1e300) == exp_minus(math.inf) == 0.0 < exp_minus(707.0)


def test_the_exponential_of_what_is_no_number_is_none() -> None:
    assert math.isnan(exp_minus(math.nan))


def test_the_logarithm_is_right_to_an_ulp_also_next_to_one() -> None:
    near = [sign * 10.0**-k + 1.0 for k in range(1, 16) for sign in (-1.0, 1.0)]
    with mp.workdps(40):
        for x in [*np.geomspace(1e-307, 1e308, 3001).tolist(), *np.linspace(0.5, 2.0, 1000).tolist(), *near]:
            assert abs(log(x) - mp.log(x)) <= EPS * abs(mp.log(x))


def test_the_logarithm_of_one_zero_infinity_and_no_number() -> None:
    assert (log(1.0), log(0.0), log(math.inf)) == (0.0, -math.inf, math.inf)
    assert math.isnan(log(math.nan))


def test_the_series_are_cosine_and_sinc_of_either_sign() -> None:
    with mp.workdps(40):
        for x in np.linspace(-0.1, 0.1, 401).tolist():
            root = mp.sqrt(mp.mpc(x))
            cosc, sinc = cosc_sinc(x)
            assert abs(cosc - mp.cos(root).real) <= EPS
            assert abs(sinc - (mp.sin(root) / root if x else mp.mpf(1)).real) <= EPS


@pytest.mark.parametrize("function", [exp_minus, log, sin_cos, cosc_sinc], ids=["exp", "log", "sin and cos", "series"])
def test_compiled_and_interpreted_differ_by_rounding_alone(function: Callable[[float], object]) -> None:
    """Products and sums may be fused, nothing else."""
    rng = np.random.default_rng(2)
    for x in rng.uniform(0.0, 0.1 if function is cosc_sinc else 500.0, 500).tolist():
        assert function(x) == pytest.approx(function.py_func(x), rel=4 * EPS, abs=EPS)  # type: ignore[attr-defined]


def test_a_period_of_more_oscillations_than_digits_is_refused() -> None:
    unit = np.eye(1)
    with pytest.raises(ValueError, match="radians of a free oscillation"):
        mass_spring(
            mass=unit, damping=0.0 * unit, stiffness=unit, gap_row=np.ones(1), force=np.ones(1),
            omega=2e-8 * math.pi, tau=0.0, b_upper=1.0, b_lower=1.0, R=0.5,
        )  # fmt: skip


def test_a_block_knows_its_decay_rates() -> None:
    block = make_blocks(np.float64(2.0), np.float64(3.0))
    assert (block[COLUMN.slow], block[COLUMN.fast]) == pytest.approx((1.0, 3.0))
