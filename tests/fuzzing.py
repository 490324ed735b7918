"""How long the fuzz tests look: at the same few examples in every run, or at as many new ones as the environment says.

By hand: ``IMPACT_ATLAS_FUZZ=20000 pytest tests/interface/test_fuzz.py``.
"""

import os
from collections.abc import Callable
from typing import TypeVar

from hypothesis import HealthCheck, settings

MANY = int(os.environ.get("IMPACT_ATLAS_FUZZ", "0"))
_Test = TypeVar("_Test", bound=Callable[..., None])


def fuzz(examples: int) -> Callable[[_Test], _Test]:
    """Decorator of a test with ``@given``: so many examples unless the environment asks for more."""
    return settings(
        max_examples=MANY or examples,
        derandomize=not MANY,
        database=None,
        deadline=None,  # a kernel may have to be compiled first
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    )
