"""Waiting for what other threads and processes do."""

import time
from collections.abc import Callable


def until(true: Callable[[], bool], seconds: float = 120.0) -> None:
    """Return once it is true; AssertionError after so many seconds."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.005)
