"""Compilation of the numerical kernels into a cache on disk, once per host, by the first process that needs them."""

import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from atlas.platform import file_lock
from atlas.store.host import compiled_for
from workers.model.system import DEFAULT, System, find_system
from workers.settings import Settings

CELLS, ATTRACTORS, ORBITS, PATHS, MEASURES, OBSERVED = "", "attractors", "orbits", "paths", "measures", "observed"
MODES = "modes"
"""Names of the parts of the compiled kernels.

CELLS        solve cells of machines with one rigid contact
ATTRACTORS   compare motions with known attractors
ORBITS       orbits as equations of their events, for branches, curves and labels
PATHS        motion between events, for portraits
MEASURES     measure motions
OBSERVED     observe motions
MODES        solve cells of machines with modes: laws of motion that change at events

All other parts need CELLS or MODES.
"""

ONE_ORBIT = {"omega": 1.643, "b": 0.52}
"""Parameters of a cell of the default system in which all initial states soon reach the same orbit."""
AN_ORBIT = {"omega": 3.5, "b": 0.15}
"""Parameters of a cell of the default system whose orbit has impacts."""

_ONE_MASS: dict[str, Any] = {
    "name": "warm-up",
    "coordinates": ["x"],
    "mass": [[1.0]],
    "damping": [[0.1]],
    "stiffness": [[1.0]],
    "force": [1.0],
}

WITH_MODES: dict[str, Any] = _ONE_MASS | {
    "contacts": [{"name": "stop", "gap": [1.0], "upper": 1.0, "stiffness": 10.0}],
    "friction": [{"name": "ground", "row": [1.0], "kinetic": 0.1}],
    "phases": [{"start": 0.0}, {"start": 0.5, "stiffness": [[2.0]]}],
    "parameters": {"omega": {"default": 1.0}},
}
"""Definition of a machine with every kind of change of its law of motion: contact, friction, phases of the period."""

WITH_MEASURES: dict[str, Any] = _ONE_MASS | {
    "gap": [1.0],
    "upper": 1000.0,
    "restitution": 0.5,
    "measures": {"all": {"displacement": [1.0], "report": ["peak"]}},
}
"""Definition of a machine with measured outputs, and with one rigid contact that it never reaches."""

YOUNG_OBJECTS = 50_000
"""Number of new objects after which Python's garbage collector runs. Objects of a compiler live until its end, so
frequent runs would only take time.
"""
TICK = 1.0
"""Interval, in seconds, between two progress reports."""

Report = Callable[[int | None, float], None]
"""Function that is called with the progress of a compilation.

Its arguments are the number of functions compiled, None while another process compiles, and the seconds since the
compilation or the wait began.
"""


def kernels_for(record: System, *more: str, settings: Settings | None = None) -> tuple[str, ...]:
    """Return the names of the parts of the kernels that cells of a system need besides CELLS, and ``more``.

    They are arguments of ``compile_once`` and ``compile_notice``. The part that observes motions is the same for every
    system.
    """
    more = (*more, OBSERVED) if settings is not None and settings.observe else more
    if record.has_modes:
        return (MODES, *more)
    return (MEASURES, *more) if record.definition.measures else more


def compile_notice(*more: str) -> str:
    """Return a line of text about what ``compile_once`` is going to do, for a user who waits."""
    if not _missing(more):
        return "loading the kernels"
    return "compiling the kernels, once for this version" if _cache() else "compiling the kernels"


def compile_once(*more: str, report: Report | None = None) -> None:
    """Compile the kernels of cells, and the parts ``more``, into the cache on disk unless it has them.

    Other processes read the cache. The kernels serve every system, see ``kernels_for``, and all settings. Processes of
    one host, or with one cache folder, wait for the first of them. A child process compiles, since compiling takes
    twice the memory of solving. ``report`` is called about every second. Nothing is done without a cache folder.
    """
    folder = _cache()
    if folder is None or not _missing(more):
        return
    lock = file_lock(folder / "compiling.lock")
    try:
        _wait_for(lock, report)
        missing = _missing(more)
        if missing and warm_up_in_child(missing, report):
            for part in missing:
                _marker(folder, part).touch()
    finally:
        lock.release()


def warm_up_in_child(parts: tuple[str, ...], report: Report | None = None) -> bool:
    """Call ``warm_up`` in a child process that sees the same modules; return True if it completed.

    After a failure each process compiles the kernels that it needs.
    """
    begin, path = time.monotonic(), os.pathsep.join(filter(None, sys.path))
    with subprocess.Popen(
        [sys.executable, "-c", "from atlas.task.compile import main; main()", *parts],
        env=os.environ | {"PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as child:
        try:
            for line in child.stdout or ():
                if report is not None:
                    report(int(line), time.monotonic() - begin)
        except BaseException:
            child.kill()
            raise
        return child.wait() == 0


def main() -> None:
    """Compile the parts named in the arguments; write the number of compiled functions to stdout about every second."""
    from numba.core import event

    class CompileCounter(event.Listener):
        n_compiled, reported = 0, time.monotonic()

        def on_start(self, event: object) -> None:
            """Do nothing: a function is counted at the end of its compilation."""

        def on_end(self, event: object) -> None:
            self.n_compiled += 1
            if time.monotonic() - self.reported >= TICK:
                self.reported = time.monotonic()
                print(self.n_compiled, flush=True)  # an error ends this process: the parent has ended

    gc.set_threshold(YOUNG_OBJECTS)
    event.register("numba:compile", CompileCounter())
    warm_up(*sys.argv[1:])


def _a_batch(record: System) -> tuple[Any, Any]:
    """Return a batch of one cell, the default cell of a system, with no periods to simulate, and an empty array of
    rows.
    """
    from workers.cell.interval import batch_of
    from workers.kernel.motion import motions_at

    oscillators, _ = record.build_many({p.name: np.array([p.default]) for p in record.parameters})
    n = oscillators.gap_row.shape[1]
    return batch_of(oscillators, motions_at(np.zeros((1, n, 2))), 1), np.zeros(0, dtype=np.int64)


def warm_up(*parts: str) -> None:
    """Compile the kernels of cells, and the named parts, or load them from the cache, by calling every kernel once.

    One period of a cell is solved. Kernels of attractors need all attractors of a cell, kernels of orbits a short
    branch. The compiled types depend neither on the system nor on the settings, which only change the lengths of
    arrays.
    """
    from workers.tile import solve_tile

    if OBSERVED in parts:
        _observe_a_period()
    modes = MODES in parts
    system, an_orbit = (System.from_mapping(WITH_MODES), {}) if modes else (find_system(DEFAULT), AN_ORBIT)
    solve_tile(system, {}, Settings(max_periods=1))
    _end_no_cells(system)
    if ATTRACTORS in parts:
        _reach_attractors(system, {} if modes else ONE_ORBIT)
    if ORBITS in parts:
        _follow_an_orbit(system, an_orbit)
    if PATHS in parts:
        _move_within_a_period(system)
    if MEASURES in parts:
        solve_tile(System.from_mapping(WITH_MEASURES), {}, Settings(max_periods=1))


def _reach_attractors(record: System, values: dict[str, float]) -> None:
    """Call the kernels of ATTRACTORS: find all attractors of a cell, and the scale for comparing states."""
    from workers.attractors.coexistence import solve_attractors
    from workers.attractors.initial_states import AttractorSettings
    from workers.kernel.cell_loops import scale_of
    from workers.model.oscillator import COLUMN

    solve_attractors(record, values, Settings(exponents="none", survival=0), AttractorSettings(4))
    scale_of(np.zeros((1, len(COLUMN))), np.zeros((1, 2)))


def _end_no_cells(record: System) -> None:
    """Call the kernels that the default cell does not reach: those of rest, of flight without a contact, of growth.

    They get an empty list of cells.
    """
    from workers.kernel.lanes.run import run_alone
    from workers.orbit.escape import escaping
    from workers.orbit.linear import contact_free, linear_orbits
    from workers.orbit.newton import no_orbits
    from workers.orbit.rest import rest_to_rest

    batch, none = _a_batch(record)
    oscillators, motions = batch.oscillators, batch.motions
    rest_to_rest(oscillators, motions, none, batch.sections, none)
    escaping(oscillators, motions, none)
    if record.has_modes:
        contact_free(oscillators, motions, none)
        linear_orbits(oscillators, motions, none, no_orbits(1, oscillators.gap_row.shape[1]), none)
    else:
        run_alone(batch, none)


def _observe_a_period() -> None:
    """Call the kernels of OBSERVED for a period of a machine with modes; they are the same for all other machines."""
    from workers.cell.observables import observe_orbits

    record = System.from_mapping(WITH_MODES)
    values = {p.name: np.array([p.default]) for p in record.parameters}
    observe_orbits(record.definition, values, np.zeros((1, 2)), np.ones(1, dtype=np.int64), "energy_loss", 1)


def _follow_an_orbit(record: System, values: dict[str, float]) -> None:
    """Call the kernels of ORBITS: follow a short branch of a cell's orbit, and compute its state at a section."""
    from workers.continuation import branch, family_of, orbit_from_state, section_state
    from workers.tile import solve_tile

    values = {p.name: p.default for p in record.parameters} | values
    cell = solve_tile(record, values, Settings(exponents="none", survival=0))
    orbit, omega = orbit_from_state(record, values, cell["state"], int(cell["period"])), values["omega"]
    branch(family_of(record, values, ("omega",)), orbit, omega, (0.999 * omega, 1.001 * omega))
    section_state(record, values, orbit)


def _move_within_a_period(record: System) -> None:
    """Call the kernels of PATHS: compute a motion from its initial state, with states between the events."""
    from atlas.cell.trajectory import path_of

    path_of(record, {p.name: p.default for p in record.parameters}, 1, None)


def _wait_for(lock: FileLock, report: Report | None) -> None:
    """Acquire the lock of the cache, and report the wait while another process holds it."""
    begin = time.monotonic()
    while True:
        try:
            lock.acquire(timeout=TICK)
        except Timeout:
            if report is not None:
                report(None, time.monotonic() - begin)
            continue
        except OSError:  # a file system without locks: each process compiles
            pass
        return


def _missing(more: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of the parts CELLS (or MODES) and ``more`` that the cache lacks; all of them without a cache."""
    folder, parts = _cache(), more if MODES in more else (CELLS, *more)
    return tuple(part for part in parts if folder is None or not _marker(folder, part).exists())


def _marker(folder: Path, part: str) -> Path:
    """Return the path of the file that marks a part as compiled for this kind of processor and these settings of
    Numba.
    """
    name = f"compiled-{part}-" if part else "compiled-"
    return folder / f"{name}{compiled_for()}"


def _cache() -> Path | None:
    """Return the folder of the compiled kernels; None if there is no cache."""
    from workers.kernel.cache import CACHE

    return CACHE
