"""The rules that the results of every cell obey, checked over the arrays of a tile."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.query.plane import determined
from atlas.spec.spec import Slices, Spec
from workers.model.machines import feeds
from workers.results import (
    APERIODIC,
    ATTRACTOR,
    BEYOND_TABLE,
    CHAOTIC,
    FAILED,
    INVALID,
    LABEL,
    LOCKING,
    NO_IMPACT,
    NO_REASON,
    NOT_STATIONARY,
    PENDING,
    PERIODIC,
    QUASIPERIODIC,
    REASON,
    REASONS,
    REGIME,
    REGULAR,
    UNDETERMINED,
    UNKNOWN_LABEL,
)

Arrays = Mapping[str, NDArray[Any]]
Mask = NDArray[np.bool_]

STANDARD_ERRORS = 4.0
"""Number of standard errors by which the largest exponent of a chaotic cell must exceed 0.

Cells whose average is not stationary are exempt.
"""
SUM_LAW = 1e-8
"""Maximum error of the sum of the exponents, relative to its exact value, or absolute if the exact value is below 1."""
TORUS = 1e-3
"""Additional error that is admitted of the sum of a quasiperiodic cell's exponents.

Its first exponent is a weighted average, the others are plain averages.
"""
ENERGY_ROUNDING = 1e-6
"""Largest change of the energy of a machine that loses nothing, as a share of it."""
AVERAGE_TOLERANCE = 1e-6
"""Maximum difference, in addition to five standard errors, between two kinds of averages of the largest exponent."""


def broken_rules(spec: Spec, slices: Slices, arrays: Arrays) -> dict[str, Mask]:
    """Return the rules that results of a tile break: the mask of the cells that break a rule, by the text of the rule.

    spec    spec of the atlas
    slices  cells of the tile
    arrays  result variables over these cells; rules about other variables are left out

    If the spectrum is stored, its sum is compared with the exact law of ``workers.cell.exponents``.
    """
    if spec.coexistence:
        return _broken_of_many(spec, slices, arrays)
    return _broken(spec, slices, arrays)


def _broken_of_many(spec: Spec, slices: Slices, arrays: Arrays) -> dict[str, Mask]:
    """Do the work of ``broken_rules`` for an atlas of all attractors.

    The rules about one attractor are checked for each attractor of a cell. The rules about all attractors of a cell,
    such as the sum and the order of their shares, are checked once.
    """
    many = {variable.name for variable in spec.variables if ATTRACTOR in variable.extra_dims}
    shape = tuple(part.stop - part.start for part in slices)
    count, tried = arrays["attractors"], arrays["starts"]
    broken: dict[str, Any] = {}
    assert spec.attractors is not None
    for k in range(spec.attractors.keep):
        index = (slice(None),) * len(shape) + (k,)
        one = {name: values[index] if name in many else values for name, values in arrays.items()}
        exists = k < np.maximum(count, 1)
        broken |= {f"attractor {k}: {text}": mask & exists for text, mask in _broken(spec, slices, one).items()}
        broken[f"attractor {k} has a regime but does not exist"] = ~exists & (one[REGIME.name] != PENDING)
        broken[f"attractor {k} is undetermined"] = (k < count) & (one[REGIME.name] == UNDETERMINED)
    share = np.nan_to_num(arrays["share"])
    with np.errstate(invalid="ignore", divide="ignore"):
        total = share.sum(axis=-1) + (arrays["undecided"] + arrays["starts_unstored"]) / tried
        unlike = ~(np.abs(total - 1.0) < AVERAGE_TOLERANCE)
        broken["shares, undecided and starts_unstored do not add up to 1"] = np.logical_and(tried > 0, unlike)
    mirror = arrays["mirror"]
    back = np.take_along_axis(mirror, np.maximum(mirror, 0), axis=-1)
    broken["mirror of a mirror image is another one"] = ((mirror >= 0) & (back != np.arange(spec.attractors.keep))).any(
        axis=-1
    )
    broken["shares are not descending"] = (np.diff(share, axis=-1) > 0).any(axis=-1)
    broken["own_attractor is not one of the attractors"] = (arrays["own_attractor"] < -1) | (
        arrays["own_attractor"] >= np.maximum(count, 0)
    )
    broken["more starts than the spec has"] = tried > spec.attractors.count
    return {text: mask for text, mask in broken.items() if mask.any()}


def _broken(spec: Spec, slices: Slices, arrays: Arrays) -> dict[str, Mask]:
    with np.errstate(invalid="ignore"):  # comparisons with NaN are false, and the rules rely on that
        broken = {text: mask for text, mask in _rules(spec, arrays) if mask.any()}
        broken |= {text: mask for text, mask in _energy(spec, slices, arrays) if mask.any()}
        if {"spectrum", "sum_law_defect", "impacts_per_period", "sticks"} <= arrays.keys():
            broken |= {text: mask for text, mask in _sum_law(spec, slices, arrays) if mask.any()}
    return broken


def _rules(spec: Spec, arrays: Arrays) -> Iterator[tuple[str, Mask]]:
    """Yield every rule that the results must obey, as pairs of its text and the mask of the cells that break it."""
    regime = arrays[REGIME.name]
    yield f"regime is not one of {NO_IMPACT} to {REGULAR}", ~((regime >= NO_IMPACT) & (regime <= REGULAR))
    if spec.settings.exponents != "none":
        yield "aperiodic although the spec has exponents", regime == APERIODIC
    still, periodic, blank = regime == NO_IMPACT, regime == PERIODIC, (regime == INVALID) | (regime == FAILED)
    known = determined(regime)
    attracted = known & (regime != REGULAR)

    for variable in spec.system_def.variables(spec.settings):
        if variable.name in (REGIME.name, REASON.name, "periods_used") or variable.name not in arrays:
            continue
        values = arrays[variable.name].reshape(*regime.shape, -1)
        empty = np.isnan(values) if variable.fill != variable.fill else values == variable.fill
        yield f"{variable.name} has a value in an invalid or failed cell", blank & ~empty.all(axis=-1)

    reason, unknown = arrays[REASON.name], blank | (regime == UNDETERMINED)
    yield "reason is missing in an undetermined, invalid or failed cell", unknown & (reason == NO_REASON)
    yield "reason is not one for this regime", (reason != NO_REASON) & ~_goes_with(reason, regime)

    for rules, needed in (
        (_exponent_rules, {"largest", "error"}),
        (_period_rules, {"period"}),
        (_impact_rules, {"period", "sticks", "impacts_upper", "impacts_lower", "impacts_per_period"}),
        (_rest_rules, {"sticks", "stuck_fraction"}),
    ):
        if needed <= arrays.keys():
            yield from rules(arrays, known)
    if "symmetric" in arrays:
        yield "symmetric outside orbits", ~(still | periodic | (regime == REGULAR)) & arrays["symmetric"]
    if "min_impact_speed" in arrays:
        speed = arrays["min_impact_speed"]
        yield "min_impact_speed is negative", speed < 0
        yield "min_impact_speed without impact", still & ~np.isnan(speed)
    for name in ("mean_impact_speed", "max_impact_speed"):
        if name in arrays:
            yield f"{name} is not positive", arrays[name] <= 0
            yield f"{name} without impact", still & ~np.isnan(arrays[name])
    yield from _speed_rules(arrays)
    if "impact_energy" in arrays:
        yield "impact_energy is not 0 without impact", still & (arrays["impact_energy"] != 0)
    if "peak_to_peak" in arrays:
        yield "peak_to_peak is negative", arrays["peak_to_peak"] < 0
    if "kaplan_yorke" in arrays:
        most = len(spec.system_def.states)
        yield f"kaplan_yorke is outside 0 to {most}", (arrays["kaplan_yorke"] < 0) | (arrays["kaplan_yorke"] > most)
    if "energy_error" in arrays:
        yield f"energy_error is above {ENERGY_ROUNDING:g}", arrays["energy_error"] > ENERGY_ROUNDING
    if "periods_used" in arrays:
        yield "periods_used is negative", arrays["periods_used"] < 0
    if LABEL.name in arrays:
        yield "label is not one of an attractor", arrays[LABEL.name] < BEYOND_TABLE
        yield "label without an attractor", ~attracted & (arrays[LABEL.name] != UNKNOWN_LABEL)
        yield "no label on an attractor", attracted & (arrays[LABEL.name] == UNKNOWN_LABEL)
        yield "settled is negative", arrays["settled"] < 0
    if "survived" in arrays:
        yield from _survival_rules(spec, arrays)
    if "state" in arrays:
        yield "state is not finite", known & ~np.isfinite(arrays["state"]).all(axis=-1)


def _energy(spec: Spec, slices: Slices, arrays: Arrays) -> Iterator[tuple[str, Mask]]:
    """Yield (rule as text, mask of cells that break it): only contacts that feed in energy have a negative loss."""
    negative = arrays.get("impact_energy", np.zeros(())) < 0
    if negative.any():
        params = spec.system_def.complete(spec.cell_params(slices))
        machines = spec.system_def.definition.machines({name: grid.ravel() for name, grid in params.items()})
        yield "impact_energy is negative", negative & ~feeds(machines).reshape(negative.shape)


def _speed_rules(arrays: Arrays) -> Iterator[tuple[str, Mask]]:
    """Yield the rules about impact speeds, slowest <= mean <= fastest, as pairs of text and mask of the cells that
    break it.
    """
    names = [name for name in ("min_impact_speed", "mean_impact_speed", "max_impact_speed") if name in arrays]
    for slower, faster in pairwise(names):
        yield f"{slower} is above {faster}", arrays[slower] > arrays[faster] * (1 + 1e-9)


def _goes_with(reason: NDArray[Any], regime: NDArray[Any]) -> Mask:
    """Return the mask of the cells whose reason for an uncertain result is possible in their regime."""
    fits = np.zeros(regime.shape, dtype=bool)
    for known in REASONS:
        fits |= (reason == known.code) & (regime == known.regime)
    return fits


def _exponent_rules(arrays: Arrays, known: Mask) -> Iterator[tuple[str, Mask]]:
    regime, largest, error = arrays[REGIME.name], arrays["largest"], arrays["error"]
    averaged = (regime == CHAOTIC) | (regime == QUASIPERIODIC)
    yield "largest is NaN", known & np.isnan(largest)
    yield "largest is not finite in an averaged cell", averaged & ~np.isfinite(largest)
    yield "error is NaN", known & np.isnan(error)
    yield "error is negative", error < 0
    clear = largest >= STANDARD_ERRORS * error
    clear |= arrays[REASON.name] == NOT_STATIONARY
    yield (
        f"chaotic, but largest is not positive by {STANDARD_ERRORS:g} errors",
        (regime == CHAOTIC) & ~(clear & (largest > 0)),
    )
    stays = (
        arrays.get("stuck_fraction", np.zeros(regime.shape)) > 1 - AVERAGE_TOLERANCE
    )  # the motion could stick elsewhere as well
    neutral = (largest == 0) & stays
    yield "largest is not below zero in a periodic cell", (regime == PERIODIC) & ~((largest < 0) | neutral)
    yield "largest is not zero in a regular cell", (regime == REGULAR) & (largest != 0)
    yield "largest is above zero without impact", (regime == NO_IMPACT) & (largest > 0)
    if "average" in arrays:
        mean = arrays["average"].reshape(*regime.shape, -1)[..., 0]
        yield "average is NaN", known & np.isnan(mean)
        unlike = ~(np.abs(mean - largest) <= AVERAGE_TOLERANCE + 5.0 * error)
        yield "average is not the largest exponent of a chaotic cell", (regime == CHAOTIC) & unlike
    if "spectrum" not in arrays:
        return
    spectrum = arrays["spectrum"]
    yield "spectrum is NaN", known & np.isnan(spectrum).any(axis=-1)
    # The first of a quasiperiodic cell is a weighted average, the others are plain ones.
    rises = spectrum[..., :-1] < spectrum[..., 1:]
    yield "spectrum is not descending", rises[..., 1:].any(axis=-1) | (rises[..., 0] & (regime != QUASIPERIODIC))
    first = np.where(np.isfinite(_cycles(arrays)), spectrum[..., 1], spectrum[..., 0])  # of a cycle the 0 along it
    same = (first == largest) | (np.abs(first - largest) <= AVERAGE_TOLERANCE + 5.0 * error)
    yield "largest is not the first of the spectrum", known & ~same


def _cycles(arrays: Arrays) -> NDArray[np.float64]:
    """Return the periods of limit cycles of a machine without a force, from the results; NaN for other cells."""
    return arrays.get("cycle_period", np.full(arrays[REGIME.name].shape, np.nan))


def _orbits(arrays: Arrays) -> Mask:
    """Return the mask of periodic cells, and of regular ones whose motion repeats."""
    regime = arrays[REGIME.name]
    return np.asarray((regime == PERIODIC) | ((regime == REGULAR) & np.isfinite(_cycles(arrays))))


def _period_rules(arrays: Arrays, known: Mask) -> Iterator[tuple[str, Mask]]:
    still, periodic, period = arrays[REGIME.name] == NO_IMPACT, _orbits(arrays), arrays["period"]
    yield "period is not 1 without impact", still & (period != 1)
    yield "period is not positive in a periodic cell", periodic & (period < 1)
    yield "period is not 0 outside orbits", ~(still | periodic) & (period != 0)
    if "cycle_period" in arrays:
        yield "cycle_period is not there in a periodic cell alone", periodic != (arrays["cycle_period"] > 0.0)


def _survival_rules(spec: Spec, arrays: Arrays) -> Iterator[tuple[str, Mask]]:
    regime, survived = arrays[REGIME.name], arrays["survived"]
    watched = (regime == CHAOTIC) | (regime == APERIODIC)
    yield "survived is negative", survived < 0
    yield "survived is 0 in a chaotic or aperiodic cell", watched & (survived == 0)
    yield "survived is not 0 outside chaos", ~watched & (regime != LOCKING) & (survived != 0)
    if "periods_used" in arrays and LABEL.name not in arrays:  # with labels, periods_used is that of the table
        yield "survived exceeds the simulated periods", survived > arrays["periods_used"]
    if spec.settings.method == "fixed":
        yield "survived is not the periods averaged", watched & (survived != spec.settings.periods)


def _impact_rules(arrays: Arrays, known: Mask) -> Iterator[tuple[str, Mask]]:
    still, periodic, sticks = arrays[REGIME.name] == NO_IMPACT, _orbits(arrays), arrays["sticks"]
    hits, mean = arrays["impacts_upper"] + arrays["impacts_lower"], arrays["impacts_per_period"]
    countless = np.isnan(mean)  # of a mass sticking on a stop; sticking friction does not make impacts countless
    for name in ("impacts_upper", "impacts_lower"):
        yield f"{name} is not 0 outside orbits", ~periodic & (arrays[name] != 0)
        yield f"{name} is not -1 in an orbit that rests on a stop", periodic & countless & (arrays[name] != -1)
        yield f"{name} is negative", periodic & ~countless & (arrays[name] < 0)
    yield "impacts_per_period is NaN where nothing sticks", known & countless & ~sticks
    yield "impacts_per_period is negative", mean < 0
    yield "impacts_per_period is not 0 without impact", still & (mean != 0)
    cycle = _cycles(arrays)
    counted = np.isclose(mean * np.where(np.isfinite(cycle), cycle, arrays["period"]), hits, rtol=1e-9, atol=0)
    yield "impacts_per_period is not the orbit's impacts over its period", periodic & ~countless & ~counted


def _rest_rules(arrays: Arrays, known: Mask) -> Iterator[tuple[str, Mask]]:
    share = arrays["stuck_fraction"]
    yield "stuck_fraction is outside 0 to 1", (share < 0) | (share > 1 + 1e-9)
    yield "stuck_fraction contradicts sticks", (share > 0) != arrays["sticks"]


def _sum_law(spec: Spec, slices: Slices, arrays: Arrays) -> Iterator[tuple[str, Mask]]:
    """Yield (rule as text, mask of cells that break it): the sum of the exponents obeys its exact law.

    The rule applies to cells for which the solver stored ``sum_law_defect``, since there the law holds.
    """
    regime, defect, mean = arrays[REGIME.name], arrays["sum_law_defect"], arrays["impacts_per_period"]
    total = arrays["spectrum"].sum(axis=-1)
    free, per_impact = law_of(spec, slices)
    law = free + np.where(mean == 0.0, 0.0, per_impact * mean)
    applies = np.isfinite(defect)
    room = SUM_LAW * np.maximum(1.0, np.nan_to_num(np.abs(law)))
    yield "sum_law_defect is too large, or of no spectrum", applies & ~(np.abs(defect) <= room)
    applies &= np.isfinite(law)  # machines with modes have no law of impacts alone: their own defect must do
    applies &= ~arrays["sticks"]  # a schedule's defect may be that of a transient, before the motion came to stick
    room = room + np.where(regime == QUASIPERIODIC, TORUS, 0.0)
    yield "spectrum breaks the sum law", applies & ~(np.abs(total - law) <= room)


def law_of(spec: Spec, slices: Slices) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the exact sum of the exponents without impact, and its change by one impact per period.

    Both are arrays that broadcast to the cells in ``slices``. Both are NaN for parameters that admit no machine, the
    second also if R = 0.
    """
    params = spec.cell_params(slices)
    axes = {name: tuple(sorted(set(values))) for name, values in spec.points.items()}
    axes = axes or {axis.name: axis.values for axis in spec.axes}
    middle = {name: _middle(params[name]) for name in params}
    # An oscillator takes long to build, and many axes do not change the sum, such as the clearance.
    varying = {name: params[name] for name, values in axes.items() if _law_varies(spec, middle, name, values)}
    grids = np.broadcast_arrays(*varying.values()) if varying else [np.zeros((1,) * len(spec.shape))]
    free, per_impact = np.empty(grids[0].shape), np.empty(grids[0].shape)
    for cell in np.ndindex(free.shape):
        cell_values = {name: float(grid[cell]) for name, grid in zip(varying, grids, strict=False)}
        free[cell], per_impact[cell] = _law(spec, middle | cell_values)
    return free, per_impact


def _law_varies(spec: Spec, middle: Mapping[str, float], name: str, values: tuple[float, ...]) -> bool:
    laws = [_law(spec, {**middle, name: value}) for value in (values[0], values[len(values) // 2], values[-1])]
    return any(law != laws[0] or np.isnan(law[0]) for law in laws)


def _law(spec: Spec, values: Mapping[str, float]) -> tuple[float, float]:
    from workers.cell.exponents import sum_of_exponents

    try:
        oscillator = spec.system_def.build(values)
        free = sum_of_exponents(oscillator, 0.0)
    except ValueError:
        return np.nan, np.nan
    try:
        return free, sum_of_exponents(oscillator, 1.0) - free
    except ValueError:  # log(0)
        return free, np.nan


def _middle(values: float | NDArray[np.float64]) -> float:
    flat = np.ravel(values)
    return float(flat[flat.size // 2])
