"""The description of a host that solves cells: processor, instructions, versions of packages. They affect last bits."""

import hashlib
import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version

from atlas.platform import processor_name

HOSTS = "hosts"
"""Name of the group of the hosts that solved tiles of a store; each host is an empty group with attributes."""
PACKAGES = ("numpy", "scipy", "numba", "llvmlite")
CPU_VARIABLES = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_ENABLE_AVX")
"""Names of environment variables that make Numba compile for another processor than that of this host."""
BIT_VARIABLES = (*CPU_VARIABLES, "NUMBA_DISABLE_JIT", "NUMBA_OPT", "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES")
"""Names of environment variables that change the last bits of results."""


@dataclass(frozen=True)
class HostInfo:
    """A kind of host: facts about its processor and packages, and a name derived from the facts.

    Hosts of one name give a cell the same bits.
    """

    name: str
    facts: Mapping[str, str] = field(compare=False)

    def __str__(self) -> str:
        facts = self.facts
        return f"{facts.get('processor', 'unknown processor')}, {facts.get('software', 'unknown software')}"


def host_from_facts(facts: Mapping[str, str]) -> HostInfo:
    """Return the host with these facts, under the name derived from them."""
    return HostInfo(hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16], facts)


UNKNOWN = host_from_facts({"processor": "unknown: its record was damaged"})


@lru_cache(maxsize=1)
def current_host() -> HostInfo:
    """Return the description of this host: processor, instructions for which kernels are compiled, versions of
    packages.
    """
    from llvmlite import binding

    facts = {
        "processor": processor_name(),
        "architecture": platform.machine(),
        "compiled_for": binding.get_host_cpu_name(),
        "instructions": " ".join(
            sorted(name for name, is_available in binding.get_host_cpu_features().items() if is_available)
        ),
        "compiler_settings": _settings(BIT_VARIABLES),
        "library": " ".join(platform.libc_ver()),
        "software": "; ".join(
            [f"python {platform.python_version()}", *(f"{package} {package_version(package)}" for package in PACKAGES)]
        ),
    }
    return host_from_facts(facts)


def compiled_for() -> str:
    """Return a name of the processor and the instructions for which kernels are compiled, for use in a file name."""
    from llvmlite import binding

    name, settings = binding.get_host_cpu_name(), _settings(CPU_VARIABLES)
    return f"{name}-{hashlib.sha256(settings.encode()).hexdigest()[:16]}" if settings else name


def _settings(names: Iterable[str]) -> str:
    return "; ".join(f"{name}={os.environ[name]}" for name in names if name in os.environ)


def package_version(package: str) -> str:
    """Return the installed version of a distribution, or "unknown"."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
