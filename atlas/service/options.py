"""The options of a run that do not affect its results: workers, reports, waiting times."""

import inspect
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import Any, TypeVar

from atlas.argument_checks import is_integer, validate_path, validate_type
from atlas.errors import InputError, brief_repr
from atlas.formatting import short_repr
from atlas.service.cluster import Tls
from atlas.service.progress import Progress
from atlas.service.timing import TIMING, Timing
from atlas.store.outage import LONG_PATIENCE

F = TypeVar("F", bound=Callable[..., Any])
MAX_WORKERS = 1024
"""Maximum number of processes of a local cluster. It exceeds the processors of any host, and can still be started."""


@dataclass(frozen=True)
class RunOptions:
    """Options of ``run`` and of the functions that compute from a store.

    workers             processes of a local cluster, by default one per processor; not with a scheduler or a client; an
                        active client is then not used
    scheduler           address of a Dask scheduler, such as ``tcp://host:8786``
    tls                 files for an encrypted connection to the scheduler
    tile                index of a tile to solve alone in this process, for debugging: its exceptions are not caught
    on_progress         function called with each Progress; None for a bar in a notebook, and nothing elsewhere
    dashboard           True if a local cluster has a dashboard, whose address is reported; needs Bokeh
    performance_report  HTML file for Dask's report on the workers' time; needs Bokeh
    storage_options     access to a store at a URL beyond the environment: ``{"endpoint": ..., "anon": True}``
    patience            seconds to wait for a server at a URL that stops responding
    wait                seconds to wait for the first worker of a cluster, whose own job may be queued for days
    timing              all other waiting times of the run

    Raise InputError if the options contradict each other.

    >>> import atlas
    >>> atlas.RunOptions(workers=2, on_progress=print).workers
    2
    """

    workers: int | None = None
    scheduler: str | None = None
    tls: Tls | None = None
    tile: tuple[int, ...] | None = None
    on_progress: Callable[[Progress], None] | None = None
    dashboard: bool = True
    performance_report: str | os.PathLike[str] | None = None
    storage_options: Mapping[str, Any] | None = field(default=None, repr=False)
    patience: float = LONG_PATIENCE
    wait: float = math.inf
    timing: Timing = TIMING

    __repr__ = short_repr

    def __post_init__(self) -> None:
        self._check_kinds()
        if self.workers is not None and not 1 <= self.workers <= MAX_WORKERS:
            raise InputError(f"workers: found {brief_repr(self.workers)}, must be 1 to {MAX_WORKERS}")
        if self.workers is not None and self.scheduler is not None:
            raise InputError(f"workers: found {self.workers} on this host, and a scheduler, too; give only one")
        is_index = isinstance(self.tile, Sequence) and all(is_integer(n, Integral) for n in self.tile)
        if self.tile is not None and not is_index:
            raise InputError(f"tile: found {brief_repr(self.tile)}, must be the index of a tile, whole numbers")
        if self.tls is not None and self.scheduler is None:
            raise InputError("tls: found files for a connection to a scheduler, but no scheduler; give its address")
        if self.tile is not None and self.scheduler is not None:
            raise InputError("tile: is solved in this process, found a scheduler, too; give only one")
        if self.performance_report is not None:
            if self.tile is not None:
                raise InputError(
                    "performance_report: is about workers, found a tile to solve in this process; give only one"
                )
            path = validate_path(self.performance_report)
            if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
                raise InputError(f"performance_report {path}: cannot be written; give a file in an existing folder")
        for name, seconds in (("patience", self.patience), ("wait", self.wait)):
            if not seconds >= 0:
                raise InputError(f"{name}: found {brief_repr(seconds)}, must be 0 s or more")

    def _check_kinds(self) -> None:
        for name, kind, right in (
            ("workers", int, "a whole number"),
            ("scheduler", str, "an address such as tcp://host:8786"),
            ("tls", Tls, "an atlas.service.cluster.Tls"),
            ("on_progress", Callable, "a function of a Progress"),
            ("performance_report", str | os.PathLike, "the path of a file"),
            ("storage_options", Mapping, "settings by name, such as {'anon': True}"),
        ):
            if (value := getattr(self, name)) is not None:
                validate_type(name, value, kind, right)
        for name in ("patience", "wait"):
            validate_type(name, getattr(self, name), Real, "a number of seconds")
        validate_type("dashboard", self.dashboard, bool, "true or false")
        validate_type("timing", self.timing, Timing, "an atlas.service.timing.Timing")

    def report(self, progress: Progress) -> None:
        """Call ``on_progress``, if there is such a function, with a Progress."""
        if self.on_progress is not None:
            self.on_progress(progress)

    def wait_for_first(self, seconds: float) -> None:
        """Report that no worker has joined the cluster yet, after ``seconds`` of waiting."""
        self.report(Progress("waiting for the cluster's first worker", seconds=seconds))


def with_fields(function: F) -> F:
    """Return the function with a signature for ``help`` that lists the fields of ``RunOptions`` in place of
    ``**fields``.
    """
    signature = inspect.signature(function)
    named_parameters = [
        parameter for parameter in signature.parameters.values() if parameter.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    named = [
        inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=option.default)
        for option in fields(RunOptions)
    ]
    function.__signature__ = signature.replace(parameters=[*named_parameters, *named])  # type: ignore[attr-defined]
    return function


DEFAULTS = RunOptions()
