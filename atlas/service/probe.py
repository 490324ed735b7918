"""The probe: the expected cost of a spec, measured by solving cells that are spread over the plane."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.service.plan import Plan, ProbeResult
from atlas.service.progress import Progress, prepare_kernels
from atlas.spec.spec import Spec
from atlas.task.compile import kernels_for, warm_up
from atlas.task.solve_block import kernels_of, solve_independent
from workers import Settings
from workers.results import APERIODIC, CHAOTIC, REGIME, UNDETERMINED

STEPS = (4, 16, 64, 256)
"""Total number of cells solved by the end of each step of the probe.

A step begins only if all steps together should stay within the budget of processor seconds.
"""
CELLS = STEPS[-1]
BUDGET, LONG_BUDGET = 2.0, 10.0
"""Budget of the probe in processor seconds, and the larger budget that applies to its first FEW cells.

A result from fewer than FEW cells would be worth little.
"""
FEW = STEPS[1]
MAX_PROBE_PERIODS, MAX_SURVIVAL = 20_000, 48_000
"""Maximum number of forcing periods of a probed cell, and maximum number for which its chaos is watched.

The settings of a spec are no larger by default.
"""
SEGMENT = 8
"""Number of cells of a probed segment of a line of continued cells, each of which starts from the cell before it.

The first cell does not count, since it alone has no cell before it.
"""
STANDARD_ERRORS = 2.0
"""Number of standard errors by which the given range of costs extends beyond the measured cost."""

Array = NDArray[np.float64]


def with_time(report: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """Return a function that reports progress by ``report``, and adds the probed time to the first plan that it gets.

    Nothing is probed for a complete atlas, or for an atlas so small that the probe would solve all of it.
    """
    planned = False

    def reported(progress: Progress) -> None:
        nonlocal planned
        if progress.plan is not None and not planned:
            planned = True
            if progress.tiles_done < progress.tiles and progress.plan.tiling.cells > CELLS:
                progress = replace(progress, plan=add_probe(progress.plan, report))
        report(progress)

    return reported


def add_probe(plan: Plan, report: Callable[[Progress], None]) -> Plan:
    """Measure the cost of the plan's spec by a probe, and return the plan with it. ``report`` is called with the
    progress.
    """
    prepare_kernels(report, *kernels_of(plan.spec))
    report(Progress("probing a few cells"))
    return replace(plan, probe=probe(plan.spec, plan.tiling.tile))


def probe(spec: Spec, tile: tuple[int, ...], clock: Callable[[], float] = time.thread_time) -> ProbeResult:
    """Return the cost of a cell of the spec, measured on 256 cells, or on fewer if they cost much.

    spec   spec of the atlas
    tile   shape of its tiles
    clock  function that returns seconds, by default the processor time of this thread, since a kernel runs on one
           thread

    A first solution, which loads the kernels, does not count. Cells are solved in batches, as in a tile. Continued
    cells are measured in short segments of lines. With all attractors, the cost above the probed budget is unknown and
    left out.
    """
    warm_up(*kernels_for(spec.system_def, settings=spec.settings))
    starts, length = spread_cells(spec)
    together = max(1, math.prod(tile) // (tile[spec.continuation[0]] if spec.continuation else 1))
    _solve(spec, starts[:1], length)
    costs, n_solved, spent, rate = list[Array](), 0, 0.0, 0.0
    for cells in STEPS:
        step_starts = starts[n_solved : max(1, cells // length)]
        budget = BUDGET if n_solved * length >= FEW else LONG_BUDGET
        if not step_starts or spent * (1 + len(step_starts) / max(n_solved, 1)) > budget:
            break
        begin = clock()
        solved = [_solve(spec, step_starts[k : k + together], length) for k in range(0, len(step_starts), together)]
        seconds = clock() - begin
        used, least, most = (np.concatenate(arrays) for arrays in zip(*solved, strict=True))
        costs.append(np.stack([least.mean(axis=1), most.mean(axis=1)]))
        rate = seconds / (used.sum() + least.size)  # a cell costs something even without a period
        n_solved, spent = n_solved + len(step_starts), spent + seconds
    least, most = np.concatenate(costs, axis=1)
    middle = 0.5 * (least + most)
    spread = np.std(middle, ddof=1) / math.sqrt(n_solved) if n_solved > 1 else middle.mean()
    doubt = STANDARD_ERRORS * float(spread) * math.sqrt(max(0.0, 1.0 - n_solved * length / math.prod(spec.shape)))
    return ProbeResult(
        cells=n_solved * length,
        periods_per_cell=float(middle.mean()),
        seconds_per_cell=rate * (float(middle.mean()) + 1.0),
        low=rate * (max(float(least.mean()) - doubt, 0.0) + 1.0),
        high=rate * (float(most.mean()) + doubt + 1.0),
    )


def spread_cells(spec: Spec) -> tuple[list[tuple[int, ...]], int]:
    """Return the indices of distinct cells that are spread evenly over the plane, and the number of cells of a segment.

    The more of the cells are used, in their order, the more evenly they fill the plane. In a continued sweep each cell
    begins a segment, a part of a line in which each cell starts from the cell before it. Otherwise a segment has one
    cell.
    """
    from scipy.stats import qmc

    room, length = list(spec.shape), 1
    if spec.continuation is not None:
        axis, _ = spec.continuation
        length = min(SEGMENT, room[axis])
        room[axis] -= length - 1
    points = qmc.Halton(len(room), scramble=False)
    points.fast_forward(1)  # the first is a corner
    cells = dict.fromkeys(map(tuple, (points.random(8 * CELLS) * room).astype(int).tolist()))
    if math.prod(room) <= CELLS:
        cells |= dict.fromkeys(np.ndindex(*room))
    return list(cells)[: CELLS // length], length


def brief(settings: Settings) -> Settings:
    """Return settings for the probe, with at most MAX_PROBE_PERIODS periods.

    The survival, the number of periods for which chaos is watched, is at most MAX_SURVIVAL.
    """
    if settings.method == "adaptive":
        survival = min(MAX_SURVIVAL, settings.survival)
        return replace(settings, max_periods=min(MAX_PROBE_PERIODS, settings.max_periods), survival=survival)
    share = min(1.0, MAX_PROBE_PERIODS / (settings.transient_periods + settings.periods))
    transient, periods = int(settings.transient_periods * share), max(1, int(settings.periods * share))
    return replace(settings, transient_periods=transient, periods=periods)


def _solve(spec: Spec, starts: list[tuple[int, ...]], length: int) -> tuple[Array, Array, Array]:
    """Solve the probed cells with the settings of the probe, see ``brief``.

    spec    spec of the atlas
    starts  first cells of the segments
    length  number of cells of a segment of a line of continued cells; 1 otherwise

    Return arrays (starts, cells): the periods used, and the least and the most periods expected with the full settings.
    """
    from workers.sweep import solve_lines

    along, backward = (-1, False) if spec.continuation is None else spec.continuation
    slices = [tuple(slice(i, i + (length if k == along else 1)) for k, i in enumerate(start)) for start in starts]
    blocks = [spec.cell_params(block) for block in slices]
    params = {name: np.stack([np.broadcast_to(np.ravel(b[name]), length) for b in blocks]) for name in blocks[0]}
    few = brief(spec.settings)
    if along < 0:
        arrays = solve_independent(spec, params, few)
    else:
        arrays = solve_lines(spec.system_def, params, few, backward=backward)
    used = arrays["periods_used"].astype(np.float64)
    least, most = (used, used) if spec.attractors is not None else full_periods(spec.settings, few, arrays)
    counted = slice(None) if length == 1 else slice(None, -1) if backward else slice(1, None)
    return used, least[:, counted], most[:, counted]


def full_periods(settings: Settings, few: Settings, arrays: dict[str, NDArray[Any]]) -> tuple[Array, Array]:
    """Return the least and the most forcing periods that cells would cost with the full ``settings``, as two arrays.

    ``arrays`` are the results of the cells with the settings ``few`` of the probe. The square of a chaotic cell's error
    falls as one over its periods. Nothing is known of an undetermined cell, nor for how long chaos is watched.
    """
    used, regime = arrays["periods_used"].astype(np.float64), arrays[REGIME.name]
    if settings.method == "fixed":
        periods = used * (settings.transient_periods + settings.periods) / (few.transient_periods + few.periods)
        return periods, periods
    least, scale = used.copy(), settings.max_periods / few.max_periods
    if "error" in arrays:
        with np.errstate(over="ignore"):  # if the tolerance is tiny
            extra_intervals = np.clip((arrays["error"] / settings.tolerance) ** 2, 1.0, scale) - 1.0
        least += np.where(regime == CHAOTIC, np.minimum(used, few.deciding_periods) * extra_intervals, 0.0)
    watched = np.isin(regime, (CHAOTIC, APERIODIC, UNDETERMINED)) * float(settings.survival - few.survival)
    return least, np.where(regime == UNDETERMINED, used * scale, least) + watched
