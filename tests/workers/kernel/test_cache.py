"""Claims about the folder of compiled kernels, and about the kernels of others in the same process."""

import importlib.util
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from numba import config

from tests.paths import ROOT
from workers.kernel.cache import CACHE, UNUSED_DAYS, _remove_unused
from workers.kernel.jit import kernel

CALLER = """
from numba import njit

@njit(cache=True)
def double(x):
    return 2.0 * x
"""

UNROLLED = """
from numba import float64, int64, njit

def total(a, n):
    s, i = 0.0, 0
    while i < n:
        s, i = 0.5 * s + a[i], i + 1
    return s

def size(dispatcher):
    dispatcher.compile((float64[::1], int64))
    (code,) = dispatcher.inspect_asm().values()
    return len(code.splitlines())

sizes = [size(njit(total))]
from workers.kernel.jit import kernel
sizes.append(size(njit(total)))
total.__module__ = "workers.kernel.sample"
sizes.append(size(kernel(total).inner_kernel))
total.__module__ = "__main__"
sizes.append(size(njit(total)))
print(*sizes)
"""


def test_kernels_of_others_keep_their_cache(tmp_path: Path) -> None:
    """Beside their source, Numba's default; or where the caller's own setting says."""
    source = tmp_path / "caller.py"
    source.write_text(CALLER)
    spec = importlib.util.spec_from_file_location("caller", source)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    usual = Path(config.CACHE_DIR) if config.CACHE_DIR else tmp_path / "__pycache__"
    assert module.double(1.5) == 3.0
    assert Path(module.double.stats.cache_path).is_relative_to(usual)
    assert CACHE is None or not Path(module.double.stats.cache_path).is_relative_to(CACHE)


def test_kernels_of_this_package_are_in_its_folder() -> None:
    @kernel
    def sample(x):
        return x

    if CACHE is not None:
        assert Path(sample.python_kernel.stats.cache_path).is_relative_to(CACHE)


def test_loops_of_others_are_compiled_as_without_this_package() -> None:
    """Instructions of one loop: before the import, after it, in a kernel of this package, and after that."""
    done = subprocess.run([sys.executable, "-c", UNROLLED], cwd=ROOT, capture_output=True, text=True, check=True)
    before, imported, own, after = map(int, done.stdout.split())
    assert before == imported == after > own


@pytest.mark.parametrize(("days", "stays"), [(UNUSED_DAYS + 1.0, False), (UNUSED_DAYS - 1.0, True)])
def test_folders_of_old_versions_are_removed_when_unused(tmp_path: Path, days: float, stays: bool) -> None:
    """The newest file decides, in whatever folder; other folders stay."""
    now = time.time()
    names = "workers-0123456789abcdef", "workers-fedcba9876543210", "workers-of-mine", "other"
    for name in names:
        (tmp_path / name / "kernel_1").mkdir(parents=True)
        for k, age in enumerate((400.0, days)):
            file = tmp_path / name / "kernel_1" / f"{k}.nbc"
            file.write_bytes(b"code")
            os.utime(file, (now - age * 86400.0,) * 2)
        os.utime(tmp_path / name, (now - 400.0 * 86400.0,) * 2)
    _remove_unused(tmp_path / names[0])
    assert [(tmp_path / name).exists() for name in names] == [True, stays, True, True]


def test_a_folder_that_a_process_found_lately_stays(tmp_path: Path) -> None:
    (tmp_path / "workers-0123456789abcdef").mkdir()
    _remove_unused(tmp_path / "workers-fedcba9876543210")
    assert (tmp_path / "workers-0123456789abcdef").exists()
