"""One rounding for a product and a sum, and bits that do not depend on who compiled the kernels."""

import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from workers.kernel.fma import fma
from workers.kernel.jit import kernel

SOLVE = """
import hashlib
import numpy as np
from workers import Settings, solve_tile
omega, b = np.meshgrid(np.linspace(2.0, 4.0, 12), np.linspace(0.05, 0.5, 8))
found = solve_tile("two-mass", {"omega": omega, "b": b}, Settings(exponents="spectrum", survival=1000))
print(hashlib.sha256(b"".join(np.ascontiguousarray(found[name]).tobytes() for name in sorted(found))).hexdigest())
"""


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


@pytest.mark.slow
def test_a_process_that_compiles_the_kernels_gets_the_bits_of_one_that_loads_them(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SOLVE]
    compiled, loaded = (
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout for _ in range(2)
    )
    assert any(tmp_path.rglob("*.nbc"))
    assert compiled == loaded
