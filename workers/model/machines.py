"""Machines as arrays of numbers: matrices, force, contacts, friction and phases at given parameters."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.block_decomposition import apply_stacked, resists, symmetric
from workers.model.memoize import memoize_arrays
from workers.model.oscillator import Array, Mask, Rows, at_rows, finite
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

GREATEST_R = 2.0
"""Maximum coefficient of restitution; above 1 a stop feeds in energy."""

INDEPENDENT = 1e-12
"""Minimum singular value of independent rows, the weights of the coordinates scaled to length 1."""

PARALLEL = 1e-12
"""Relative deviation up to which a row, the weights of the coordinates, counts as a multiple of another row."""

HALFWAY = 1e-12
"""Deviation from half a forcing period, as a share of a period, up to which two phases count as half a period apart."""

MIDWAY = 1e-13
"""Deviation, as a share of its terms, up to which a position counts as midway between stops and as balancing a load."""


class Machines(NamedTuple):
    """N machines of n coordinates with P phases, C contacts, F frictions and H harmonics.

    mass                  (N, n, n) mass matrix
    damping, stiffness    (N, P, n, n) matrices of each phase
    load                  (N, P, n) load of each phase
    force_sin, force_cos  (N, P, H, n) amplitudes of the force of each phase
    omega, tau            (N,) forcing frequency, and forcing phase at the sections t = k T
    starts                (N, P + 1) starts of the phases, shares of the forcing period; the last one is 1
    row                   (N, C, n) weights of the coordinates in the displacement at each contact
    stops                 (N, C, 2) lower and upper stop of each contact, infinite if missing
    R                     (N, C) coefficient of restitution of rigid contacts, 1 for soft ones
    soft                  (N, C) 1 for soft contacts, else 0; equal in all N
    by_force              (N, C) 1 for contacts released by force, else 0; equal in all N
    contact_constants     (N, P, C, 3) stiffness, damping and preload of soft contacts, 0 for rigid ones; in force per
                          displacement, force per velocity and force along the row
    friction_rows         (N, F, n) weights of the velocities in the sliding velocity of each friction
    belt                  (N, F) velocity of the surface that each friction rubs on
    friction_constants    (N, P, F, 2, 3) kinetic level, static level and slope for v < 0 and v > 0; in force, force,
                          and force per velocity
    contact_laws          (N, C, 2, S, 3) further force of the lower and upper stop of a soft contact: start of each
                          segment in depth, slope, and force extrapolated to depth 0; see laws.py
    friction_laws         (N, F, 2, S', 3) further resistance of friction for v < 0 and v > 0, likewise over |v|
    counted               (N, C) 1 for contacts, 0 for springs, whose stops are ends of the segment with y = 0
    drift                 (N,) the coordinate that may drift, -1 if there is none; equal in all N

    All fields are in the units of the definition.
    """

    mass: Array
    damping: Array
    stiffness: Array
    load: Array
    force_sin: Array
    force_cos: Array
    omega: Array
    tau: Array
    starts: Array
    row: Array
    stops: Array
    R: Array
    soft: Array
    by_force: Array
    contact_constants: Array
    friction_rows: Array
    belt: Array
    friction_constants: Array
    contact_laws: Array
    friction_laws: Array
    counted: Array
    drift: Array

    @property
    def dimension(self) -> int:
        """Number of components of a state, 2n."""
        return 2 * self.load.shape[2]

    @property
    def mirrored(self) -> Mask:
        """Mask (N,) of machines that are their own mirror images half a period later, see ``is_mirror_symmetric``."""
        return is_mirror_symmetric(self) & (self.sizes[0] == 1)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of phases, contacts and frictions."""
        return self.load.shape[1], self.row.shape[1], self.friction_rows.shape[1]

    @property
    def segments(self) -> tuple[int, int]:
        """Largest numbers of segments in laws of contacts and in laws of friction."""
        return self.contact_laws.shape[3], self.friction_laws.shape[3]

    @property
    def signals(self) -> Rows:
        """Indices (U,) of the signals, displacements or forces, at whose ends a mode of any machine ends; at least one.

        A mode is a set of linear equations. The indices of a contact's signals are explained at
        ``hybrid_modes.SIGNALS``.
        """
        F = self.sizes[2]
        ends = np.stack([np.isfinite(self.stops).any(axis=(0, 2)), self.by_force.any(axis=0)], axis=1)  # (C, 2)
        numbers = np.flatnonzero(np.concatenate([ends.ravel(), np.ones(F, dtype=np.bool_)]))
        return numbers if len(numbers) else np.zeros(1, dtype=np.int64)

    @property
    def of_flight(self) -> tuple[Array, ...]:
        """All that decides the flight of machines with one rigid contact, apart from the forcing frequency.

        These are mass, damping and stiffness (N, n, n), gap row (N, n), sines and cosines of the force (N, H, n), and
        load (N, n).
        """
        of_phases = self.damping, self.stiffness, self.row, self.force_sin, self.force_cos, self.load
        return self.mass, *(np.ascontiguousarray(field[:, 0]) for field in of_phases)

    @property
    def drifting(self) -> int:
        """The coordinate that may drift, -1 if there is none."""
        return int(self.drift[0]) if len(self.drift) else -1


@np.errstate(all="ignore")
def faults(machines: Machines) -> NDArray[np.int8]:
    """Return the code (N,) of why a machine is invalid, as far as its numbers alone show; NO_REASON if it is valid.

    Lower stops must be below upper ones, and 0 <= R <= GREATEST_R. Stiffness and preload of a contact, its damping if
    it is released by force, and the slope of its law, must not be negative. Segments must be in order, 0 <= kinetic <=
    static, and starts must rise from 0 and stay below 1. Rows, weights of coordinates, that can stick together must be
    independent, see ``held_rows``. A force along a row must move it that way, see ``yields``. Nothing may tie down a
    drifting coordinate.
    """
    lower, upper = machines.stops[..., 0], machines.stops[..., 1]
    reasons = np.full(len(machines.omega), NO_REASON, dtype=np.int8)
    reasons[~yields(machines)] = NO_OSCILLATOR
    fine = (
        (lower < upper) & (machines.R >= 0.0) & (machines.R <= GREATEST_R),
        machines.contact_constants[..., ::2] >= 0.0,
        (machines.contact_constants[..., 1] >= 0.0) | (machines.by_force == 0.0)[:, None],
        (machines.friction_constants[..., 0] >= 0.0)
        & (machines.friction_constants[..., 1] >= machines.friction_constants[..., 0]),
        ~np.isnan(machines.contact_laws[..., 0]),
        ~np.isnan(machines.friction_laws[..., 0]),
        machines.starts[:, :1] == 0.0,
        np.diff(machines.starts, axis=1) > 0.0,
    )
    for sound in fine:
        reasons[_any(~sound)] = OUT_OF_RANGE
    reasons[dependent(held_rows(machines)) | dependent(machines.friction_rows)] = OUT_OF_RANGE
    if machines.drifting >= 0:
        ties = machines.stiffness[..., machines.drifting], machines.row[..., machines.drifting]
        reasons[_any(ties[0] != 0.0) | _any(ties[1] != 0.0)] = NO_OSCILLATOR
    bounded = machines._replace(
        stops=machines.R, contact_laws=machines.contact_laws[..., 1:], friction_laws=machines.friction_laws[..., 1:]
    )
    reasons[_any(np.isnan(machines.stops)) | ~finite(bounded)] = OUT_OF_DOUBLES
    return reasons


def is_mirror_symmetric(machines: Machines) -> Mask:
    """Return the mask (N,) of machines in which z(t) -> -z(t + T/2) takes motions to motions.

    Stops lie at equal distances from 0, and belts rest. Half a period later the law is the same, with the load and the
    even harmonics of the force negated.
    """
    phases = machines.sizes[0]
    half, ahead = (
        phases // 2,
        np.mod(np.roll(machines.starts[:, :-1], -(phases // 2), axis=1) - machines.starts[:, :-1], 1.0),
    )
    sign = np.where(np.arange(machines.force_sin.shape[2]) % 2 == 0, 1.0, -1.0)[:, None]
    same = [machines.damping, machines.stiffness, machines.contact_constants, machines.friction_constants]
    later = [(field, field) for field in same] + [(machines.load, -machines.load)]
    later += [(field, sign * field) for field in (machines.force_sin, machines.force_cos)]
    uneven = [_any(np.roll(field, -half, axis=1) != image) for field, image in later]
    uneven += [_any(machines.stops[..., 0] != -machines.stops[..., 1]), _any(machines.belt != 0.0)]
    uneven += [_any(law[:, :, 0] != law[:, :, 1]) for law in (machines.contact_laws, machines.friction_laws)]
    uneven.append(_any(machines.friction_constants[..., 0, :] != machines.friction_constants[..., 1, :]))
    if phases > 1:
        uneven.append(_any(np.abs(ahead - 0.5) > HALFWAY))
    return ~np.any(uneven, axis=0)


def loses_nothing(machines: Machines) -> Mask:
    """Return the mask (N,) of machines without any loss: no damping, R = 1, no friction, M and K symmetric."""
    lossy = [
        _any(machines.damping != -machines.damping.swapaxes(-1, -2)),
        _any(machines.R != 1.0),
        _any(machines.contact_constants[..., 1] != 0.0),
    ]
    return np.asarray(~np.any(lossy, axis=0) & (machines.sizes[2] == 0) & _has_energy(machines))


def is_undriven(machines: Machines) -> Mask:
    """Return the mask (N,) of machines whose energy never rises.

    They have no force, phases or moving belts, and neither damping nor stiffness nor contacts feed in energy.
    """
    driven = [_any(machines.force_sin != 0.0), _any(machines.force_cos != 0.0), _any(machines.belt != 0.0)]
    fields = (
        machines.damping,
        machines.stiffness,
        machines.load,
        machines.contact_constants,
        machines.friction_constants,
    )
    driven += [_any(field != field[:, :1]) for field in fields if machines.sizes[0] > 1]
    even = 0.5 * (machines.damping[:, 0] + machines.damping[:, 0].swapaxes(-1, -2))
    return np.asarray(~np.any(driven, axis=0) & resists(even) & _has_energy(machines) & ~feeds(machines))


def feeds(machines: Machines) -> Mask:
    """Return the mask (N,) of machines with a contact that feeds in energy: R above 1, or negative damping."""
    return np.asarray(_any(machines.R > 1.0) | _any(machines.contact_constants[..., 1] < 0.0))


def _has_energy(machines: Machines) -> Mask:
    """Return the mask (N,) of machines with an energy: M symmetric and positive definite, K symmetric in all phases."""
    return definite(machines.mass) & np.all(machines.stiffness == machines.stiffness.swapaxes(-1, -2), axis=(1, 2, 3))


@np.errstate(all="ignore")
def about_centre(machines: Machines) -> tuple[Machines, Array]:
    """Return machines counted from the centre of their mirror symmetry, and the centres (N, n).

    The centre lies midway between all stops and balances the mean load, see ``is_mirror_symmetric``. Machines without
    the symmetry stay as they are, with a centre of 0.
    """
    half, ends = machines.sizes[0] // 2, np.isfinite(machines.stops)
    (N, P, n), between = machines.load.shape, np.asarray(ends.all(axis=2))

    def ahead(field: Array) -> Array:
        return np.roll(field, -half, axis=1)

    middle = np.where(between, 0.5 * np.sum(np.where(ends, machines.stops, 0.0), axis=2), 0.0)
    balance = 0.5 * (machines.stiffness + ahead(machines.stiffness)).reshape(N, P * n, n)
    matrix = np.concatenate([balance, np.where(between[..., None], machines.row, 0.0)], axis=1)
    right = np.concatenate([0.5 * (machines.load + ahead(machines.load)).reshape(N, P * n), middle], axis=1)
    off_centre = np.asarray(np.any(right != 0.0, axis=1) & np.all(ends[..., 0] == ends[..., 1], axis=1))
    centre = np.zeros((N, n))
    off_centre &= np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    for r in np.flatnonzero(off_centre).tolist():
        centre[r] = np.linalg.lstsq(matrix[r], right[r])[0]
    size = (np.abs(matrix) @ np.abs(centre)[..., None])[..., 0] + np.abs(right)
    off_centre &= np.all(np.abs((matrix @ centre[..., None])[..., 0] - right) <= MIDWAY * size, axis=1)
    wide = 0.5 * np.where(between, machines.stops[..., 1] - machines.stops[..., 0], np.inf)
    pull = machines.load - (machines.stiffness @ centre[:, None, :, None])[..., 0]
    centred = machines._replace(load=0.5 * (pull - ahead(pull)), stops=np.stack([-wide, wide], axis=2))
    off_centre &= is_mirror_symmetric(centred)
    load = np.where(off_centre[:, None, None], centred.load, machines.load)
    stops = np.where(off_centre[:, None, None], centred.stops, machines.stops)
    return machines._replace(load=load, stops=stops), np.where(off_centre[:, None], centre, 0.0)


def held_rows(machines: Machines) -> Array:
    """Return the rows (N, C + F, n) along which rigid contacts and friction can stick, zeros for other elements.

    A row has the weights of the coordinates. Friction on the row of a rigid contact, or on a multiple of this row, is
    left out, since a sticking contact does not slide.
    """
    rigid = machines.row * (1.0 - machines.soft)[..., None]
    same = np.any((along_contacts(machines) != 0.0) & (machines.soft == 0.0)[:, None], axis=-1)  # (N, F)
    return np.concatenate([rigid, np.where(same[..., None], 0.0, machines.friction_rows)], axis=1)


def along_contacts(machines: Machines) -> Array:
    """Return (N, F, C): the factor a if a friction's row is a times a contact's row to rounding, else 0.

    A row has the weights of the coordinates in the displacement at a contact, or of the velocities in a sliding
    velocity.
    """
    (slide, wide), (row, high) = _scaled(machines.friction_rows), _scaled(machines.row)
    share = np.vecdot(slide[:, :, None], row[:, None]) / np.vecdot(row, row)[:, None]
    apart = np.max(np.abs(slide[:, :, None] - share[..., None] * row[:, None]), axis=-1)
    return np.where(apart <= PARALLEL, share * wide[..., None] / high[:, None], 0.0)


def _scaled(rows: Array) -> tuple[Array, Array]:
    """Return rows (N, R, n) scaled to largest entries +-1, and the scale factors (N, R)."""
    size = np.max(np.abs(rows), axis=-1)
    size = np.where(size > 0.0, size, 1.0)
    return rows / size[..., None], size


def yields(machines: Machines) -> Mask:
    """Return the mask (N,) of machines in which a force along any row moves the row that way, g.M^-1 g > 0.

    A row g has the weights of the coordinates at a contact or friction. The condition must also hold while other rows
    stick. All principal minors of G M^-1 G' are then positive, with G the rows of contacts and all rows that can stick.
    It holds for every symmetric, positive definite M.
    """
    all_yield = definite(machines.mass).copy()
    (others,) = np.nonzero(~all_yield)
    if len(others):
        all_yield[others] = _yield_along(at_rows(machines, others))
    return all_yield


@memoize_arrays
def definite(mass: Array) -> Mask:
    """Return the mask (N,) of symmetric, positive definite matrices (N, n, n)."""
    return symmetric(mass) & (np.min(apply_stacked(np.linalg.eigvalsh, mass.shape[:2], mass), axis=1) > 0.0)


def _yield_along(machines: Machines) -> Mask:
    """Return the mask (N,) of machines in which a force along any row moves the row that way, see ``yields``.

    It is computed by the principal minors of G M^-1 G', with G the rows of contacts and friction.
    """
    closed = held_rows(machines)
    inverse = apply_stacked(np.linalg.inv, machines.mass.shape, machines.mass)
    singles = np.concatenate([machines.row, machines.friction_rows], axis=1)
    along = np.vecdot(singles, (inverse[:, None] @ singles[..., None])[..., 0])
    all_yield = np.asarray(np.all(along > 0.0, axis=1))
    between = closed @ inverse @ np.ascontiguousarray(closed.swapaxes(1, 2))
    absent = ~np.any(closed != 0.0, axis=-1)
    between = between + absent[:, :, None] * np.eye(closed.shape[1])
    for size in range(2, closed.shape[1] + 1):
        for subset in combinations(range(closed.shape[1]), size):
            all_yield &= np.linalg.det(between[:, subset][:, :, subset]) > 0.0
    return all_yield


@memoize_arrays
def dependent(rows: Array) -> Mask:
    """Return the mask (N,) of machines in which the nonzero rows among rows (N, R, n) depend on each other."""
    largest = np.abs(rows).max(axis=-1, initial=0.0)
    scaled = rows / np.where(largest > 0.0, largest, 1.0)[..., None]  # keeps their squares in range
    length = np.sqrt(np.vecdot(scaled, scaled))
    unit = scaled / np.where(length > 0.0, length, 1.0)[..., None]
    values = apply_stacked(_singular_values, (len(rows), min(rows.shape[1:])), unit)
    return np.asarray(np.sum(values > INDEPENDENT, axis=1) < np.sum(length != 0.0, axis=1))


def _singular_values(rows: Array) -> Array:
    return np.asarray(np.linalg.svd(rows, compute_uv=False))


def _any(wrong: Mask) -> Mask:
    """Return the mask (N,) of machines for which any entry of ``wrong`` (N, ...) is True."""
    return np.asarray(np.any(wrong, axis=tuple(range(1, wrong.ndim))))
