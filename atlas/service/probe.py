"""The probe: the expected cost of a spec, measured on cells that are spread over the plane."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.service.plan import Plan, ProbeResult
from atlas.service.progress import Progress, prepare_kernels
from atlas.spec.spec import Spec
from atlas.task.compile import kernels_for, warm_up
from atlas.task.solve_block import kernels_of, solve_independent
from workers import Settings
from workers.results import APERIODIC, CHAOTIC, REGIME, UNDETERMINED

CELLS = 256
STEPS = (4, 16, 64, CELLS)
"""Number of cells solved in all after each step.

A step begins only if it should keep the processor seconds of the whole within BUDGET.
"""
BUDGET, LONG_BUDGET = 2.0, 10.0
"""Budget of the probe, in processor seconds, and its budget for the first FEW cells.

Fewer cells say next to nothing.
"""
FEW = 16
MAX_PROBE_PERIODS, MAX_SURVIVAL = 20_000, 48_000
"""Largest budget and largest survival of a probed cell, in forcing periods.

The error of the cell shows the cost with a larger budget, its ``survived`` the cost of a longer survival.
"""
SEGMENT = 8
"""Number of cells of a probed segment of a continued line.

The first cell does not count, since it alone has no cell before it.
"""
STANDARD_ERRORS = 2.0
"""Number of standard errors by which the range extends beyond the measurement."""

Array = NDArray[np.float64]
_Solved = tuple[dict[str, Array], dict[str, NDArray[Any]]]
"""Parameters and results of cells, as arrays (starts, cells)."""


class _ProbeStep(NamedTuple):
    """The measurement of one step.

    seconds      processor seconds
    simulated    forcing periods simulated
    least, most  (starts, cells) limits of the forcing periods that the cells will take
    """

    seconds: float
    simulated: float
    least: Array
    most: Array


def with_time(report: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """Return a reporter of a run's progress that adds the measured time to the first plan it gets.

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
    """Return the plan with the time that a probe of its spec measures."""
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
    settings, share = brief(spec.settings)
    if spec.attractors is not None:
        _solve(spec, settings, starts[:1], length)  # the search has kernels of its own
    together = max(1, math.prod(tile) // (tile[spec.continuation[0]] if spec.continuation else 1))
    steps: list[_ProbeStep] = []
    spent, done = 0.0, 0

    def timed(chosen: list[tuple[int, ...]], few: int) -> _ProbeStep:
        begin = clock()
        solved = [_solve(spec, settings, part, length) for part in _parts(chosen, few)]
        return _measured(spec, solved, clock() - begin, share, length)

    for cells in STEPS:
        chosen = starts[done : max(1, cells // length)]
        budget = BUDGET if done * length >= FEW else LONG_BUDGET
        if not chosen or spent * (1 + len(chosen) / max(done, 1)) > budget:
            break
        few = math.ceil(together / _evenness(steps))
        step = timed(chosen, few)
        if not steps and step.seconds > BUDGET / len(STEPS):  # it may have loaded kernels that other cells do not need
            step = min(step, timed(chosen, few), key=lambda one: one.seconds)
        steps.append(step)
        done, spent = done + len(chosen), spent + step.seconds
    return _estimate(steps, done * length, math.prod(spec.shape))


def spread_cells(spec: Spec) -> tuple[list[tuple[int, ...]], int]:
    """Return distinct cells that fill the plane ever more evenly, and the length of the segments that they begin."""
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


def brief(settings: Settings) -> tuple[Settings, float]:
    """Return the settings with limited periods and survival, and the share of the full budget that they have.

    The limits are MAX_PROBE_PERIODS and MAX_SURVIVAL.
    """
    if settings.method == "adaptive":
        share = min(1.0, MAX_PROBE_PERIODS / settings.max_periods)
        survival = min(MAX_SURVIVAL, settings.survival)
        return replace(settings, max_periods=min(MAX_PROBE_PERIODS, settings.max_periods), survival=survival), share
    whole = settings.transient_periods + settings.periods
    transient = settings.transient_periods * min(whole, MAX_PROBE_PERIODS) // whole
    periods = max(1, settings.periods * min(whole, MAX_PROBE_PERIODS) // whole)
    return replace(settings, transient_periods=transient, periods=periods), (transient + periods) / whole


def _evenness(steps: list[_ProbeStep]) -> float:
    """Return the fraction of the starts that would do all the work if it were shared equally; 1 before the first step.

    The cells of a tile cost about the same. A batch of cells from all over the plane must be larger by this factor.
    """
    work = np.concatenate([step.most.sum(axis=1) for step in steps]) + 1.0 if steps else np.ones(1)
    return float(work.sum() ** 2 / (work.size * (work**2).sum()))


def _measured(spec: Spec, solved: list[_Solved], seconds: float, share: float, length: int) -> _ProbeStep:
    given, arrays = ({name: np.concatenate([one[k][name] for one in solved]) for name in solved[0][k]} for k in (0, 1))
    if spec.attractors is None:
        least, most = _full_periods(spec, given, arrays, share)
    else:
        least = most = arrays["periods_used"].astype(np.float64)
    counted = slice(None)
    if length > 1 and spec.continuation is not None:
        counted = slice(None, -1) if spec.continuation[1] else slice(1, None)
    return _ProbeStep(seconds, float(arrays["periods_used"].sum(dtype=np.float64)), least[:, counted], most[:, counted])


def _parts(starts: list[tuple[int, ...]], together: int) -> Iterator[list[tuple[int, ...]]]:
    for first in range(0, len(starts), together):
        yield starts[first : first + together]


def _solve(spec: Spec, settings: Settings, starts: list[tuple[int, ...]], length: int) -> _Solved:
    """Solve the cells, or the segments of lines, that begin at these starts; return their parameters and results."""
    from workers.sweep import solve_lines

    along = -1 if spec.continuation is None else spec.continuation[0]
    slices = [tuple(slice(i, i + (length if k == along else 1)) for k, i in enumerate(start)) for start in starts]
    blocks = [spec.cell_params(block) for block in slices]
    params = {name: np.stack([np.broadcast_to(np.ravel(b[name]), length) for b in blocks]) for name in blocks[0]}
    if spec.continuation is None:
        return params, solve_independent(spec, params, settings)
    return params, solve_lines(spec.system_def, params, settings, backward=spec.continuation[1])


def _full_periods(spec: Spec, params: dict[str, Array], arrays: dict[str, Any], share: float) -> tuple[Array, Array]:
    """Return the least and the most periods that cells cost with their full budget, when solved with a share of it.

    The square of a chaotic cell's error falls as one over its periods. Nothing is known of an undetermined cell.
    """
    settings = spec.settings
    used = arrays["periods_used"].astype(np.float64)
    if settings.method == "fixed":
        return used / share, used / share
    regime, few = arrays[REGIME.name], brief(settings)[0]
    least = used.copy()
    if settings.survival > few.survival:
        watched = np.isin(regime, (CHAOTIC, APERIODIC))
        least[watched] += _unwatched(spec, params, arrays, few.survival)[watched]
    if "error" in arrays:
        with np.errstate(over="ignore"):  # if the tolerance is tiny
            wanted = np.minimum((arrays["error"] / settings.tolerance) ** 2, 1.0 / share)
        spent = np.minimum(used, few.deciding_periods)
        least += np.where((regime == CHAOTIC) & (wanted > 1.0), spent * (wanted - 1.0), 0.0)
    return least, np.where(regime == UNDETERMINED, used / share, least)


def _unwatched(spec: Spec, params: dict[str, Array], arrays: dict[str, Any], few: int) -> Array:
    """Return the remaining periods of watching chaotic cells that were watched with a survival of ``few`` periods."""
    from workers.cell.schedule import relaxation_periods, survival_share

    survived, hits = arrays["survived"], np.nan_to_num(arrays["impacts_per_period"].ravel())
    flat = {p.name: np.resize(params.get(p.name, np.array(p.default)), hits.shape) for p in spec.system_def.parameters}
    oscillators, _ = spec.system_def.build_many(flat)
    with np.errstate(divide="ignore", invalid="ignore"):  # cells without an oscillator are not chaotic
        part = survival_share(relaxation_periods(oscillators, np.arange(hits.size), hits)).reshape(survived.shape)
    required = np.where(survived >= few, 1.0, part) * spec.settings.survival
    return np.maximum(required - survived, 0.0)


def _estimate(steps: list[_ProbeStep], cells: int, of: int) -> ProbeResult:
    """Return the estimate: periods from all steps, the time of a period from the last.

    The cells of the last step fill the processor best.
    """
    last = steps[-1]
    rate = last.seconds / (last.simulated + last.least.size)  # a cell costs something even without a period
    least, most = (np.concatenate([getattr(step, name).mean(axis=1) for step in steps]) for name in ("least", "most"))
    middle = 0.5 * (least + most)
    spread = np.std(middle, ddof=1) / math.sqrt(middle.size) if middle.size > 1 else middle.mean()
    doubt = STANDARD_ERRORS * float(spread) * math.sqrt(max(0.0, 1.0 - cells / of))
    periods = float(middle.mean())
    return ProbeResult(
        cells=cells,
        periods_per_cell=periods,
        seconds_per_cell=rate * (periods + 1.0),
        low=rate * (max(float(least.mean()) - doubt, 0.0) + 1.0),
        high=rate * (float(most.mean()) + doubt + 1.0),
    )
