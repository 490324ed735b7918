"""Grazing lines: parameters at which motion without impacts just touches a stop.

There an extreme of the motion over a period equals the distance to the stop.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from contourpy import contour_generator
from numpy.typing import NDArray
from scipy import ndimage

from atlas.errors import InputError
from atlas.query import machine
from atlas.query.plane import PlaneAxis
from atlas.spec.system import system_of
from workers.model.elements import STOP, Contact
from workers.model.expression import Expression
from workers.model.oscillator import GuardedFlow, Oscillator
from workers.model.system import System

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

POINTS = 1000
"""Number of points along an axis at which the grazing line is computed, if the axes can be computed separately."""
POINTS_OF_PAIRS = 60
"""Maximum number of points along an axis if every pair of points has to be computed."""

FINER = 4
"""Number of fine steps for each coarse step of the grid near the grazing line."""
_REACH = 3.0
"""Absolute value of the logarithm in ``grazing_ratio`` up to which an extreme between grid points may cross zero."""
_NEGLIGIBLE = 1e-15
"""Amplitude, relative to the sum over all harmonics, below which a harmonic is ignored."""


def grazing_lines(ds: "xr.Dataset", x: PlaneAxis, y: PlaneAxis) -> list[Array]:
    """Return the lines (N, 2) of a plane, x first, along which the impact-free motion grazes a stop.

    ds     dataset of an atlas, which gives the system and the fixed parameters
    x, y   axes of the plane

    Raise InputError if the system is unknown, or its impact-free motion is not linear. Raise InputError also if a mode
    of vibration has no stiffness at all corners of the plane.
    """
    system = system_of(ds.attrs, "overlay 'grazing'")
    alone = with_one_stop(system)[0]
    same, ends = machine.fixed(ds, system), machine.corners({x.name: x.values, y.name: y.values})
    if all(np.all(drifts(osc) | ~exists) for _, osc, exists in machine.oscillators(alone, same, ends)):
        raise InputError(
            f"overlay 'grazing': no line exists, because a mode of {system.name} has no stiffness and its "
            "impact-free motion may drift anywhere"
        )
    xs, ys, ratio = grazing_grid(system, same, x, y)
    if not (np.any(ratio < 0.0) and np.any(ratio > 0.0)):
        return []
    return [np.asarray(line) for line in contour_generator(xs, ys, ratio).lines(0.0)]


def grazing_ratio(system: System, fixed: dict[str, float], x: tuple[str, Array], y: tuple[str, Array]) -> Array:
    """Return the log of the largest of max Y / b_upper and max -Y / b_lower over all contacts.

    system   the system
    fixed    parameters that are not axes, by name
    x, y     name of an axis, and its values

    Y is the impact-free motion of the contact's gap coordinate about its rest position; b_upper and b_lower are the
    distances from there to the stops. The result (y, x) is zero on the grazing line, and infinite where the rest
    position lies beyond a stop. It is NaN where no such motion exists, and where the motion may drift because a mode of
    vibration has no stiffness.
    """
    xs, ys = np.meshgrid(x[1], y[1])
    points = {x[0]: xs.ravel(), y[0]: ys.ravel()}
    return _ratios(system, fixed, points).reshape(xs.shape)


def _ratios(system: System, fixed: dict[str, float], points: dict[str, Array]) -> Array:
    """Return the logarithm that ``grazing_ratio`` computes, at N points given by values (N,) of both parameters."""
    return np.maximum.reduce([_ratios_of_one(alone, fixed, points) for alone in with_one_stop(system)])


def with_one_stop(system: System) -> tuple[System, ...]:
    """Return, for each contact of a system, the system with this contact alone, made rigid.

    The force law of a contact changes no motion that does not reach the contact. Raise InputError if friction, phases
    or springs with a law make the impact-free motion nonlinear.
    """
    definition = system.definition
    if definition.friction or definition.phases or definition.within or definition.springs:
        what = (
            "friction"
            if definition.friction
            else "phases of the forcing period"
            if definition.phases or definition.within
            else "springs with a law"
        )
        raise InputError(
            f"overlay 'grazing': {system.name} has {what}, so its motion without impacts is not a linear response; "
            "atlas find curves finds the grazes of its orbits"
        )
    if not system.has_modes:
        return (system,)
    rigid = [
        Contact(STOP, contact.gap, Expression("1.0"), contact.upper, contact.lower) for contact in definition.contacts
    ]
    return tuple(replace(system, definition=replace(definition, contacts=(contact,), measures=())) for contact in rigid)


def _ratios_of_one(system: System, fixed: dict[str, float], points: dict[str, Array]) -> Array:
    """Return the logarithm that ``grazing_ratio`` computes, at N points, for a system with one rigid contact."""
    ratios = np.full(len(next(iter(points.values()))), np.nan)
    for part, osc, exists in machine.oscillators(system, fixed, points):
        highest, lowest = extremes(osc.gap)
        exists = exists & (osc.gap.amplitude > 0.0) & ~drifts(osc)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.maximum(highest / osc.b_upper, -lowest / osc.b_lower)
            ratios[part] = np.where(exists, np.log(ratio), np.nan)
        ratios[part][exists & (np.minimum(osc.b_upper, osc.b_lower) <= 0.0)] = np.inf
    return ratios


def drifts(osc: Oscillator) -> NDArray[np.bool_]:
    """Return the mask (N,) of the machines that may drift, since a mode of vibration has no stiffness."""
    return np.asarray(np.any(osc.gap.lam == 0.0, axis=1))


def extremes(signal: GuardedFlow) -> tuple[Array, Array]:
    """Return the largest and the smallest value, over a forcing period, of the forced response of many signals.

    The response is a sum over H harmonics. With z = exp(i phi), the derivative of sum_k s_k sin(k phi) + c_k cos(k phi)
    is half of sum_k k ((s_k + i c_k) z^k + (s_k - i c_k) z^-k). Both extremes therefore lie at the angles of roots of a
    polynomial of degree 2 H. Values at the angles of all other roots lie between the extremes.
    """
    s, c = np.nan_to_num(signal.sin_part), np.nan_to_num(signal.cos_part)
    sizes = np.hypot(s, c)
    counts = sizes > _NEGLIGIBLE * np.sum(sizes, axis=1, keepdims=True)
    order = np.max(np.where(counts, np.arange(1, s.shape[1] + 1), 0), axis=1)
    highest, lowest = np.sum(sizes, axis=1), -np.sum(sizes, axis=1)  # exact for a single harmonic
    for H in range(1, s.shape[1] + 1):
        mixed = np.flatnonzero((order == H) & (np.sum(counts, axis=1) > 1))
        if mixed.size:
            k = np.arange(1, H + 1)
            up = k * (s[mixed, :H] + 1j * c[mixed, :H])
            ascending = np.concatenate([up[:, ::-1].conj(), np.zeros((mixed.size, 1)), up], axis=1)
            phi = np.angle(_roots(ascending))[..., None]
            values = np.sum(s[mixed, None, :H] * np.sin(k * phi) + c[mixed, None, :H] * np.cos(k * phi), axis=-1)
            highest[mixed], lowest[mixed] = values.max(axis=1), values.min(axis=1)
    return highest, lowest


def _roots(ascending: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the roots (N, m) of polynomials with coefficients (N, m + 1), the constant first.

    They are the eigenvalues of companion matrices, which numpy.roots computes for one polynomial.
    """
    N, m = ascending.shape[0], ascending.shape[1] - 1
    companion = np.zeros((N, m, m), dtype=np.complex128)
    companion[:, np.arange(1, m), np.arange(m - 1)] = 1.0
    companion[:, :, -1] = -ascending[:, :-1] / ascending[:, -1:]
    return np.asarray(np.linalg.eigvals(companion))


def grazing_grid(
    system: System, fixed: dict[str, float], x: PlaneAxis, y: PlaneAxis, points: int = POINTS
) -> tuple[Array, Array, Array]:
    """Return points along x, points along y and ``grazing_ratio`` over them (y, x), from edge to edge of the map.

    system   the system
    fixed    parameters that are not axes, by name
    x, y     axes of the map
    points   number of points along each axis

    If the logarithm is a sum of a function of x and one of y, it is computed along each axis alone, at ``points``
    points. Otherwise there are at most POINTS_OF_PAIRS points, and FINER times as many near the line.
    """
    xs, ys = _points(system, x, points), _points(system, y, points)
    few = [values[[0, points // 3, points // 2, -1]] for values in (xs, ys)]
    probe = grazing_ratio(system, fixed, (x.name, few[0]), (y.name, few[1]))
    separable = np.isfinite(probe).all() and np.allclose(
        probe, probe[:1] + probe[:, :1] - probe[0, 0], rtol=0, atol=1e-9
    )
    if separable:
        # One axis is often the clearance. The logarithm is then a sum of a term in x and a term in y.
        row = grazing_ratio(system, fixed, (x.name, xs), (y.name, ys[:1]))
        column = grazing_ratio(system, fixed, (x.name, xs[:1]), (y.name, ys))
        return xs, ys, row + column - row[0, 0]
    few_points = min(points, POINTS_OF_PAIRS)
    xs, ys = _points(system, x, few_points), _points(system, y, few_points)
    coarse = _bounded(grazing_ratio(system, fixed, (x.name, xs), (y.name, ys)))
    if points < 2 * POINTS_OF_PAIRS:
        return xs, ys, coarse
    # A resonance can be narrower than the spacing. The grid is FINER times as dense where the ratio may cross zero.
    fine_xs, fine_ys = _between(xs), _between(ys)
    fine = np.stack([np.interp(fine_ys, ys, column) for column in coarse.T], axis=1)
    fine = np.stack([np.interp(fine_xs, xs, row) for row in fine])
    rows, columns = np.nonzero(np.repeat(np.repeat(_near_zero(coarse), FINER, 0), FINER, 1))
    if rows.size:
        fine[rows, columns] = _bounded(_ratios(system, fixed, {x.name: fine_xs[columns], y.name: fine_ys[rows]}))
    return fine_xs, fine_ys, fine


def _bounded(ratio: Array) -> Array:
    """Return values of ``grazing_ratio`` with _REACH in place of infinities; contour lines stay away from it."""
    return np.where(np.isposinf(ratio), _REACH, ratio)


def _between(points: Array) -> Array:
    """Return sorted points (N,) with FINER - 1 evenly spaced points inserted between any two neighbours."""
    at = np.arange(FINER * (points.size - 1) + 1) / FINER
    return np.interp(at, np.arange(points.size), points)


def _near_zero(ratio: Array) -> NDArray[np.bool_]:
    """Return which meshes of a grid, one fewer each way than its points (y, x), lie near a zero of ``ratio``.

    Meshes at a maximum or minimum that may cross zero between the points are included.
    """
    crosses = np.zeros(ratio.shape, dtype=bool)
    for axis in (0, 1):
        before, after = (np.moveaxis(ratio, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        changes = np.moveaxis(crosses, axis, 0)
        changes[:-1] |= before * after <= 0.0
        low, middle, high = np.moveaxis(ratio, axis, 0)[:-2], before[1:], after[1:]
        crest = (middle >= low) & (middle >= high) & (middle < 0.0) & (middle > -_REACH)
        trough = (middle <= low) & (middle <= high) & (middle > 0.0) & (middle < _REACH)
        changes[1:-1] |= crest | trough
    return np.asarray(ndimage.binary_dilation(crosses, np.ones((3, 3)))[:-1, :-1])


def _points(system: System, axis: PlaneAxis, count: int) -> Array:
    # From edge to edge; from the centre of the outermost cell if its edge lies outside the parameter's range.
    admits = system.parameter(axis.name).admits
    first, last = axis.edges[0], axis.edges[-1]
    first, last = first if admits(first) else axis.values[0], last if admits(last) else axis.values[-1]
    return np.asarray((np.geomspace if axis.log else np.linspace)(first, last, count))
