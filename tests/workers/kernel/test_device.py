"""The text of the lanes' kernels serves another device: CUDA's simulator, a thread for each lane."""

import json
import os
import subprocess
import sys

from tests.paths import ROOT
from workers.kernel.device import make_translator
from workers.kernel.jit import Kernel, kernel


@kernel
def half(x):
    return 0.5 * x


@kernel
def quarter(x):
    return half(half(x))


def test_a_kernel_and_all_that_it_calls_are_translated_once() -> None:
    seen = []

    def decorate(function):
        seen.append(function.__name__)
        return function

    translate = make_translator(decorate)
    assert translate(quarter)(3.0) == 0.75
    assert translate(half) is translate(quarter).__globals__["half"]
    assert seen == ["half", "quarter"]
    assert isinstance(quarter.py_func.__globals__["half"], Kernel)


def test_rounds_of_lanes_on_cudas_simulator_have_the_bits_of_the_compiled_ones() -> None:
    """The simulator runs the kernels' text as Python, where a product and a sum are fused exactly where fma says so.

    So they are on the processor. A real device may fuse others too: its compiler is to be asked not to.
    """
    done = subprocess.run(
        [sys.executable, "-m", "tests.simulated"],
        cwd=ROOT, env=os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["events"] > 50
    assert found["device"] == found["compiled"]
    assert len(set(found["device"])) == len(found["device"])
