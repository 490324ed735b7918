"""The command ``atlas`` for tests that run it a hundred times, without a hundred times the imports.

A server has imported the libraries and the solver and nothing else: no thread, no loop, no kernel. Each command is a
child forked from it, with folder, environment and output of who called. What a command needs beyond it imports itself.
Where a command would start a local cluster it has one in the test's process, which all of them share.
"""

import atexit
import gc
import json
import os
import select
import shlex
import signal
import socket
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from distributed import LocalCluster

from tests.paths import ROOT

LIBRARIES = (
    "numpy", "scipy.linalg", "scipy.ndimage", "scipy.spatial", "scipy.stats", "numba.np.arraymath", "numba.typed",
    "pandas", "xarray", "zarr.storage", "dask.array", "distributed", "matplotlib.figure", "contourpy",
    "matplotlib.backends.backend_agg", "rich.progress", "atlas.cli.main", "workers.tile",
)  # fmt: skip
SERVE = [sys.executable, "-c", "import sys; from tests.cli_runner import serve; serve(sys.argv[1])"]
"""The main module has no file, which workers of a cluster would run."""
CLIENT = """
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect(sys.argv[1])
    call = {"arguments": sys.argv[2:], "folder": os.getcwd(), "environment": dict(os.environ)}
    socket.send_fds(server, [b"+"], [0, 1, 2])
    server.sendall(json.dumps(call).encode())
    server.shutdown(socket.SHUT_WR)
    sys.exit(int(server.recv(10)))
"""
LOOK = 0.02
"""Seconds between looks whether a child has ended."""


@contextmanager
def commands(folder: Path) -> Iterator[Path]:
    """A command ``atlas`` in a folder, forked from a server that lives as long as this does.

    Given a file of Python instead of a command, it runs that, and a warning is an error.
    """
    address, command = folder / "server", folder / "atlas"
    command.write_text(f'#!/bin/sh\nexec {shlex.join([sys.executable, "-I", "-S", "-c", CLIENT, str(address)])} "$@"\n')
    command.chmod(0o755)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}  # BLAS starts them when imported
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1", memory_limit=0,
        dashboard_address="127.0.0.1:0",
    ) as cluster:  # fmt: skip
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(address))
            listener.listen()
            serving = [*SERVE, cluster.scheduler_address]
            server = subprocess.Popen(serving, env=environment, stdin=listener, start_new_session=True)
        try:
            yield command
        finally:
            os.killpg(server.pid, signal.SIGKILL)
            server.wait()


def serve(scheduler: str) -> None:
    """Fork a child for each call that comes to the socket which is this process's input."""
    code = [1]  # what an exception ends with that nothing catches
    atexit.register(leave, code)  # before all others, so that it is called last
    for name in LIBRARIES:
        import_module(name)
    clients, cluster = (import_module(f"atlas.service.{name}") for name in ("clients", "cluster"))
    clients.local_cluster = lambda *_: cluster.connect_to_scheduler(scheduler)
    assert len(os.listdir("/proc/self/task")) == 1, "a library started a thread: a fork would lose it"
    gc.freeze()
    running: dict[int, socket.socket] = {}
    with socket.socket(fileno=os.dup(0)) as listener:
        while True:
            if select.select([listener], [], [], LOOK if running else None)[0]:
                caller, _ = listener.accept()
                files = socket.recv_fds(caller, 1, 3)[1]
                child = os.fork()
                if not child:
                    break
                running[child] = caller
                for file in files:
                    os.close(file)
            for child in list(running):
                ended, status = os.waitpid(child, os.WNOHANG)
                if ended:
                    with running.pop(child) as caller:
                        caller.sendall(str(os.waitstatus_to_exitcode(status)).encode())
    for other in running.values():
        other.close()
    run(caller, files, code)


def run(caller: socket.socket, files: list[int], code: list[int]) -> None:
    """The command of a call, as the main program of this process; ``code`` gets its exit code."""
    with caller, caller.makefile() as text:
        call = json.load(text)
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(call["folder"])
    os.environ.clear()
    os.environ.update(call["environment"])
    sys.argv = ["atlas", *call["arguments"]]
    try:
        if sys.argv[1].endswith(".py"):
            warnings.simplefilter("error")
            exec(compile(Path(sys.argv[1]).read_text(), sys.argv[1], "exec"), vars(sys.modules["__main__"]))
            code[0] = 0
        else:
            import_module("atlas.cli.main").main()
    except SystemExit as ended:
        code[0] = int(ended.code or 0)


def leave(code: list[int]) -> None:
    """End this process without taking apart what it shares with the server, which would copy all of it."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code[0])
