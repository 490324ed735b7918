"""The Dask cluster of a run: a local one on this host, or the cluster of a scheduler at an address."""

import logging
import math
import multiprocessing
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from atlas.argument_checks import validate_path
from atlas.errors import InputError, RunError
from atlas.platform import interrupts_blocked
from atlas.service.timing import TIMING, Timing

if TYPE_CHECKING:
    from distributed import Client, Security

DASHBOARD = "127.0.0.1:8787"
"""Address of the dashboard: Dask's default port, so that a browser or a tunnel may stay open from run to run."""
LOST_WORKER_TIMEOUT = "10 minutes"
"""Time within which a worker process that died must be restarted. On a busy host this may exceed Dask's default of 15
s.
"""
LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application")
"""Loggers whose level and handler Dask sets when it is imported; all other loggers inherit those of a parent."""
CLUSTER_LOST_MESSAGE = "the cluster was lost; rerun the same command to resume from the stored tiles"


@dataclass(frozen=True)
class Tls:
    """Files for an encrypted connection to a scheduler; None leaves the file to Dask's own configuration.

    ca_file  file of the certificate authority
    cert     file of the client's certificate
    key      file of the client's private key

    Raise InputError if a file cannot be read.
    """

    ca_file: str | None = None
    cert: str | None = None
    key: str | None = None

    def __post_init__(self) -> None:
        for kind, file in (("CA file", self.ca_file), ("certificate", self.cert), ("key", self.key)):
            if file is not None and not os.access(file, os.R_OK):
                raise InputError(f"TLS {kind} {file}: no such file, or it cannot be read")


def _security(tls: Tls | None) -> "Security":
    """Return Dask's TLS settings, from its configuration ``distributed.comm.tls`` and the given files, which take
    precedence.
    """
    from distributed import Security

    files = {"tls_ca_file": tls.ca_file, "tls_client_cert": tls.cert, "tls_client_key": tls.key} if tls else {}
    files = {name: file for name, file in files.items() if file is not None}
    return Security(**files, **({"require_encryption": True} if files else {}))


@contextmanager
def connect_to_scheduler(scheduler: str, tls: Tls | None = None, timing: Timing = TIMING) -> Iterator["Client"]:
    """Yield a client of the scheduler at an address.

    Raise InputError if no scheduler answers within ``timing.connect`` seconds.
    """
    import asyncio  # here, since most commands need none

    from distributed import Client

    with _quiet():
        try:
            security = _security(tls)
            # A Client that fails to start is closed only when it is collected, which may block the next one's start.
            with ThreadPoolExecutor(1) as thread:  # a notebook's own thread has a loop running
                thread.submit(asyncio.run, _knock(scheduler, security, timing.connect)).result()
            client = Client(scheduler, timeout=timing.connect, set_as_default=False, security=security)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            detail = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"{scheduler}: no scheduler answers ({detail})") from None
        with client:
            yield client


async def _knock(scheduler: str, security: "Security", seconds: float) -> None:
    """Check that a scheduler answers: connect to it within ``seconds``, and close the connection.

    Raise an exception if nothing answers.
    """
    from distributed import connect

    comm = await connect(scheduler, timeout=seconds, **security.get_connection_args("client"))
    await comm.close()


def check_startable(count: int) -> None:
    """Raise InputError if this process cannot start worker processes."""
    if multiprocessing.current_process().daemon:
        raise InputError(
            f"workers: found {count}, cannot be started by a daemonic process, such as a Dask worker; leave the option "
            "out to run on the cluster of the task"
        )


@contextmanager
def local_cluster(count: int, dashboard: bool = False) -> Iterator["Client"]:
    """Start worker processes of one thread each, and yield their client.

    Only this process can reach them, and only from this host. A scheduler runs any code that it receives, and other
    users of this host reach its port. Connections therefore need a certificate that is created here and lies in the
    memory of these processes. The ``dashboard`` is read-only and needs Bokeh. Its address is DASHBOARD, or another port
    if that port is in use. Dask's profiler is off: its output is not used, and Python 3.11 can crash when the frames of
    a running thread are read.
    """
    import dask
    from distributed import Client, LocalCluster, Security

    check_startable(count)
    dashboard = dashboard and has_dashboard()
    patient = {"distributed.deploy.lost-worker-timeout": LOST_WORKER_TIMEOUT}
    with dask.config.set(patient), _quiet(*["bokeh"] * dashboard), ExitStack() as stack:
        try:
            with (
                interrupts_blocked(),
                dask.config.set({"distributed.worker.profile.enabled": False}),
                warnings.catch_warnings(),
            ):
                warnings.filterwarnings("ignore", message="Port .* is already in use")
                cluster = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=DASHBOARD if dashboard else "127.0.0.1:0",
                    scheduler_kwargs={"dashboard": dashboard, "allowed_failures": 1},
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    security=Security.temporary(),
                )
        except RuntimeError as error:
            raise RunError(
                f"the worker processes did not start ({error}); a script that calls atlas.run must do so under "
                'if __name__ == "__main__": or pass client=distributed.Client(processes=False)'
            ) from error
        stack.enter_context(cluster)
        yield stack.enter_context(Client(cluster, set_as_default=False))


def has_dashboard() -> bool:
    """Return True if Dask can draw its dashboard and its reports, which need Bokeh."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of a Bokeh that is too old
        try:
            import distributed.dashboard.scheduler  # noqa: F401
        except ImportError:
            return False
    return True


def dashboard_link(client: "Client") -> str:
    """Return the address of a cluster's dashboard, built by Dask's setting ``distributed.dashboard.link``; empty if
    unknown.
    """
    try:
        return client.dashboard_link or ""
    except (KeyError, ValueError):  # the user's template names a variable that this environment does not have
        return ""


@contextmanager
def performance_reported(
    client: "Client", path: str | os.PathLike[str], failed: Callable[[str], None]
) -> Iterator[None]:
    """Record Dask's performance report of the block, and write it as an HTML file that needs no network.

    If the report cannot be written at the end, the run is unaffected, and ``failed`` is
    called with the reason.
    """
    from distributed import performance_report

    report = performance_report(str(validate_path(path)), mode="inline")
    with loss_reported(client), client.as_current():
        report.__enter__()
    try:
        yield
    finally:
        try:
            with client.as_current():
                report.__exit__(None, None, None)
        except Exception as error:
            failed(f"{type(error).__name__}: {error}".rstrip(": "))


@contextmanager
def loss_reported(client: "Client") -> Iterator[None]:
    """Convert Dask's errors about a lost cluster, raised within the block, into a RunError."""
    from distributed import CancelledError
    from distributed.comm import CommClosedError  # type: ignore[attr-defined]  # exported without __all__

    try:
        yield
    except (InputError, RunError):
        raise
    except Exception as error:
        if client.status == "running" and not isinstance(error, CancelledError | CommClosedError):
            raise
        raise RunError(CLUSTER_LOST_MESSAGE) from error


def worker_threads(client: "Client") -> dict[str, int]:
    """Return the number of threads of each worker by its address; raise RunError if the cluster is lost."""
    if client.status != "running":
        raise RunError(CLUSTER_LOST_MESSAGE)
    with loss_reported(client):
        return dict(client.nthreads())


def worker_memory(client: "Client") -> dict[str, tuple[int, bool]]:
    """Return, by worker address, the memory limit in bytes (0 for none) and True if Dask has paused the worker."""
    with loss_reported(client):
        infos = client.scheduler_info(n_workers=-1)["workers"]  # all: releases from 2025.4 on list five by default
    return {name: (int(info.get("memory_limit") or 0), info.get("status") == "paused") for name, info in infos.items()}


def active_client() -> "Client | None":
    """Return Dask's default client, the client that the caller has open; None if there is none."""
    if "distributed" not in sys.modules:
        return None
    from distributed import default_client

    try:
        return default_client()
    except ValueError:
        return None


def task_client() -> "AbstractContextManager[Client] | None":
    """Return the client of the Dask task in which this function is called; None outside a task.

    While the client is in use, the task leaves its thread to other tasks.
    """
    if "distributed" not in sys.modules:
        return None
    from distributed import get_worker, worker_client

    try:
        get_worker()
    except ValueError:
        return None
    return worker_client()


def count_threads(
    client: "Client", waiting: Callable[[float], None], limit: float = math.inf, poll: float = 0.5
) -> int:
    """Return the number of threads of a cluster, once its first worker is there.

    Until then ``waiting`` is called with the seconds passed, every ``poll`` seconds. A cluster that grows with its work
    has no worker before it has work, so a Dask task is submitted and waited for. Raise InputError if no worker has
    joined within ``limit`` seconds.
    """
    if client.asynchronous:
        raise InputError("client: found an asynchronous one, must be synchronous")
    if not worker_threads(client):
        begin = time.monotonic()
        with loss_reported(client):
            work = client.submit(int, pure=False)
            try:
                while not work.done():
                    seconds = time.monotonic() - begin
                    if seconds >= limit:
                        raise InputError(
                            f"the scheduler has no worker after {limit:g} s; start one: dask worker ADDRESS"
                        )
                    waiting(seconds)
                    time.sleep(min(poll, limit - seconds))
            finally:
                work.cancel()
    return max(1, sum(worker_threads(client).values()))


def leave_if_bootstrapping() -> None:
    """End a worker process that runs its parent's script again because the script has no ``__main__`` guard.

    The parent then explains the guard; an exception here would print a traceback for every worker.
    """
    imported = sys.modules.get("__mp_main__")  # the module __main__, too, once its import has ended
    if imported is not None and imported is not sys.modules["__main__"]:
        raise SystemExit(1)


@contextmanager
def _quiet(*more: str) -> Iterator[None]:
    """Keep log messages of Dask, and of the packages ``more``, off the terminal within the block.

    Outcomes and errors are returned or raised, so the messages would only repeat them.
    """
    before = {logger: logger.level for logger in map(logging.getLogger, (*LOGGERS, *more))}
    for logger in before:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in before.items():
            logger.setLevel(level)
