"""The machine that solves cells: what their bits depend on besides the solver's version."""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

MACHINES = "machines"
"""The group of a store with the machines that solved its tiles, each an empty group with attributes."""
PACKAGES = ("numpy", "scipy", "numba", "llvmlite")
JIT_VARIABLES = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_DISABLE_JIT", "NUMBA_OPT", "NUMBA_ENABLE_AVX")


@dataclass(frozen=True)
class Machine:
    """A kind of machine: a name made of its facts, and the facts. Machines of one name give a cell the same bits."""

    name: str
    facts: Mapping[str, str] = field(compare=False)

    def __str__(self) -> str:
        facts = self.facts
        return f"{facts.get('processor', 'unknown processor')}, {facts.get('software', 'unknown software')}"


def machine_of(facts: Mapping[str, str]) -> Machine:
    """The machine of these facts."""
    return Machine(hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16], facts)


UNKNOWN = machine_of({"processor": "unknown: its record was damaged"})


@lru_cache(maxsize=1)
def this_machine() -> Machine:
    """The machine that this process runs on: processor, instructions that kernels are compiled for, versions."""
    from llvmlite import binding

    facts = {
        "processor": _processor(),
        "architecture": platform.machine(),
        "compiled_for": binding.get_host_cpu_name(),
        "instructions": " ".join(sorted(name for name, there in binding.get_host_cpu_features().items() if there)),
        "compiler_settings": "; ".join(f"{name}={os.environ[name]}" for name in JIT_VARIABLES if name in os.environ),
        "library": " ".join(platform.libc_ver()),
        "software": "; ".join(
            [f"python {platform.python_version()}", *(f"{package} {package_version(package)}" for package in PACKAGES)]
        ),
    }
    return machine_of(facts)


def package_version(package: str) -> str:
    """The installed version of a distribution, or "unknown"."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _processor() -> str:
    """The processor's name, as the system's own list of processors has it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())
