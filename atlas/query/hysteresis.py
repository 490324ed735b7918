"""Comparison of two sweeps cell by cell: the same motion, mirror images x(t) and -x(t + T/2), or different motions."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query import machine
from atlas.query.window import axis_names
from atlas.spec.system import stored_system
from workers.results import (
    APERIODIC,
    CHAOTIC,
    ERROR,
    LARGEST,
    LOCKING,
    NO_IMPACT,
    PERIODIC,
    QUASIPERIODIC,
    REGIME,
    SECTION,
)

if TYPE_CHECKING:
    import xarray as xr

SAME, MIRRORED, DIFFERENT = range(3)
"""Relations between the motions of two cells."""

COUNTS = ("period", "impacts_upper", "impacts_lower")
INVARIANT = ("symmetric", "impacts_per_period", "min_impact_speed", "stuck_fraction")
"""Results that two mirror images of one orbit share, besides their exponents."""
COMPARED = (ERROR.name, LARGEST.name, SECTION.name, "state", *COUNTS, *INVARIANT)
"""All variables that a comparison uses if both atlases have them."""

_DETERMINED = (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, APERIODIC, LOCKING)
_ORBIT_TOLERANCE = 1e-6
"""Maximum distance between section states of one orbit, relative to the extent of all; exact orbits agree to 1e-12."""
_APART = 0.5
"""Kolmogorov-Smirnov distance of section values above which two motions that do not close are different."""
_LEAST_SAMPLES = 16


def compare(first: "xr.Dataset", second: "xr.Dataset") -> NDArray[np.int8]:
    """Return the relation of the motions of two sweeps, cell by cell: SAME, MIRRORED or DIFFERENT.

    A cell is SAME unless its motion is known in both sweeps. Motions of different regimes are DIFFERENT. So are motions
    whose largest exponents differ by more than four times their combined error.

    Closed orbits are SAME if their section states agree. They are MIRRORED, x(t) and -x(t + T/2), if three conditions
    hold. Neither orbit is symmetric itself; the impacts at the upper stop of one are those at the lower stop of the
    other; and the exponents, the slowest impact and the time at rest agree. Without section samples, orbits of several
    periods are compared by these numbers alone.

    Motions that do not close are compared as samples. They are MIRRORED if their exponents agree but the distributions
    of their section values differ. Distributions differ at a Kolmogorov-Smirnov distance above 1/2 in any component,
    with at least 16 samples. If the machine is not symmetric, or not known, MIRRORED becomes DIFFERENT.
    """
    one, two = first[REGIME.name].values, second[REGIME.name].values
    known = np.isin(one, _DETERMINED) & np.isin(two, _DETERMINED)
    unlike = (one != two) | _exponents_differ(first, second)
    closed = (one == PERIODIC) & (two == PERIODIC)
    straight, swapped, shared = (np.ones(one.shape, bool) for _ in range(3))
    for name, other in zip(COUNTS, (COUNTS[0], COUNTS[2], COUNTS[1]), strict=True):
        if name in first and other in second:
            straight &= first[name].values == second[name].values
            swapped &= first[name].values == second[other].values
    for name in INVARIANT:
        if name in first:
            shared &= np.isclose(first[name].values, second[name].values, rtol=1e-6, atol=1e-9, equal_nan=True)
    broken = ~first["symmetric"].values if "symmetric" in first else np.ones(one.shape, bool)
    apart = _sections_apart(first, second, closed)
    same = ~unlike & ~apart & (straight | ~closed)
    mirrored = ~unlike & ~same & np.where(closed, swapped & shared & broken, one != NO_IMPACT) & _has_twins(first)
    return np.where(~known | same, SAME, np.where(mirrored, MIRRORED, DIFFERENT)).astype(np.int8)


def check_same_axis(ds: "xr.Dataset", against: "xr.Dataset") -> None:
    """Raise InputError unless two sweeps have the same points on one axis and equal fixed parameters."""
    (name,), others = axis_names(ds), axis_names(against)
    if others != (name,):
        raise InputError(f"the atlases have different axes: {name} and {', '.join(others)}")
    one, two = np.sort(ds[name].values), np.sort(against[name].values)
    if one.shape != two.shape or np.any(one != two):
        raise InputError(
            f"the atlases have different points on {name}: {one.size} from {one[0]:g} to {one[-1]:g}, "
            f"and {two.size} from {two[0]:g} to {two[-1]:g}"
        )
    for key in ds.coords:
        fixed = ds[key].ndim == 0 and ds[key].dtype.kind == "f" and key in against.coords
        if fixed and float(ds[key]) != float(against[key]):
            raise InputError(f"the atlases differ in {key}: {float(ds[key]):g} and {float(against[key]):g}")


def _has_twins(ds: "xr.Dataset") -> NDArray[np.bool_]:
    """Return the mask of cells of a sweep in which motions have mirror images."""
    system, (name,) = stored_system(ds.attrs), axis_names(ds)
    if system is None:
        return np.zeros(ds[REGIME.name].shape, bool)
    values = np.asarray(ds[name].values, dtype=np.float64)
    return machine.has_twins(system, machine.fixed(ds, system), {name: values})


def _exponents_differ(first: "xr.Dataset", second: "xr.Dataset") -> NDArray[np.bool_]:
    if LARGEST.name not in first or ERROR.name not in first:
        return np.zeros(first[REGIME.name].shape, bool)
    one, two = first[LARGEST.name].values, second[LARGEST.name].values
    errors = np.hypot(first[ERROR.name].values, second[ERROR.name].values)
    with np.errstate(invalid="ignore"):  # two exponents of -inf are equal
        return np.asarray((one != two) & (np.abs(one - two) > 4.0 * errors + 1e-9))


def _sections_apart(first: "xr.Dataset", second: "xr.Dataset", closed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of cells whose stored section states belong to two different motions."""
    apart = np.zeros(closed.shape, bool)
    both = (first, second)
    if all(SECTION.name in ds and ds[SECTION.name].size for ds in both):
        samples = [ds[SECTION.name].values for ds in both]
    elif "state" in first:
        samples = [ds["state"].values[:, None] for ds in both]
    else:
        return apart
    periods = first["period"].values if "period" in first else np.full(closed.shape, samples[0].shape[1])
    everything = np.concatenate([cells.reshape(-1, cells.shape[-1]) for cells in samples])
    finite = everything[np.isfinite(everything).all(axis=1)]
    scale = np.ptp(finite, axis=0).max() if finite.size else 1.0
    for i in range(closed.size):
        one, two = (cells[i][np.isfinite(cells[i]).all(axis=-1)] for cells in samples)
        if closed[i] and min(len(one), len(two)) >= periods[i] > 0:
            distance = np.abs(one[-periods[i] :, None] - two[-periods[i] :][None]).max(axis=-1)
            nearest = max(distance.min(axis=0).max(), distance.min(axis=1).max())
            apart[i] = nearest > _ORBIT_TOLERANCE * max(scale, 1e-12)
        elif not closed[i] and min(len(one), len(two)) >= _LEAST_SAMPLES:
            apart[i] = any(_distance(a, b) > _APART for a, b in zip(one.T, two.T, strict=True))
    return apart


def _distance(one: NDArray[np.float64], two: NDArray[np.float64]) -> float:
    """Return the Kolmogorov-Smirnov distance of two samples."""
    from scipy.stats import ks_2samp  # takes a second to import; only chaos needs it

    return float(ks_2samp(one, two, method="asymp").statistic)
