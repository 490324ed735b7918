"""Hybrid machines as numbers: contacts, friction and phases at given parameters."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.free import finite
from workers.model.kept import kept
from workers.model.modes import resists, stacked, symmetric
from workers.model.oscillator import Array, Machines, Mask, Rows, at_rows
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

INDEPENDENT = 1e-12
"""Least singular value of independent rows of length 1."""

PARALLEL = 1e-12
"""Relative deviation up to which a row counts as a multiple of another."""

HALFWAY = 1e-12
"""Deviation from half a forcing period, as a share of it, up to which two phases count as half a period apart."""

MIDWAY = 1e-13
"""Deviation, as a share of its terms, up to which a place counts as midway between stops and as balancing a load."""


class HybridMachines(NamedTuple):
    """N machines of n coordinates with P phases, C contacts, F frictions and H harmonics.

    mass         (N, n, n)
    damping, stiffness (N, P, n, n), load (N, P, n), force_sin and force_cos (N, P, H, n): of each phase
    omega, tau   (N,)             forcing frequency, forcing phase at a section
    starts       (N, P + 1)       of phases, shares of the forcing period; the last one is 1
    row          (N, C, n)        of each contact, stops (N, C, 2) the lower one and the upper one, infinite for none
    R            (N, C)           coefficient of restitution of rigid contacts, 1 of soft ones
    soft         (N, C)           1 for soft contacts, by_force (N, C) 1 if released by force; equal in all N
    pad          (N, P, C, 3)     stiffness, damping and preload of soft contacts, 0 of rigid ones
    slide        (N, F, n)        row of each friction, belt (N, F) the velocity of what it rubs on
    rub          (N, P, F, 3)     kinetic and static level, slope
    law          (N, C, 2, S, 3)  further force of the lower and upper stop of a soft contact: start of
                                  each segment in depth, slope, and force extrapolated to depth 0; see laws.py
    grip         (N, F, S', 3)    further resistance of friction, likewise over |v|
    counted      (N, C)           1 for contacts, 0 for springs, whose stops are the ends of the segment at rest
    drift        (N,)             the coordinate that may drift, -1 for none; equal in all N

    All are in the units of the definition: pad in force per displacement, force per velocity and force along the row,
    rub in force, force, and force per velocity.
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
    pad: Array
    slide: Array
    belt: Array
    rub: Array
    law: Array
    grip: Array
    counted: Array
    drift: Array

    @property
    def dimension(self) -> int:
        """Number of components of a state, 2n."""
        return 2 * self.load.shape[2]

    @property
    def mirrored(self) -> Mask:
        """Mask (N,) of machines that are their own mirror images half a period later: see ``mirrors``."""
        return mirrors(self) & (self.sizes[0] == 1)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of phases, contacts and frictions."""
        return self.load.shape[1], self.row.shape[1], self.slide.shape[1]

    @property
    def segments(self) -> tuple[int, int]:
        """Most segments in laws of contacts and in laws of friction."""
        return self.law.shape[3], self.grip.shape[2]

    @property
    def signals(self) -> Rows:
        """Numbers (U,) of the signals that end a mode of any machine, see hybrid_modes.pieces_of; at least one."""
        F = self.sizes[2]
        ends = np.stack([np.isfinite(self.stops).any(axis=(0, 2)), self.by_force.any(axis=0)], axis=1)  # (C, 2)
        numbers = np.flatnonzero(np.concatenate([ends.ravel(), np.ones(F, dtype=np.bool_)]))
        return numbers if len(numbers) else np.zeros(1, dtype=np.int64)

    @property
    def drifting(self) -> int:
        """The coordinate that may drift, -1 for none."""
        return int(self.drift[0]) if len(self.drift) else -1


def with_one_contact(machines: Machines, load: Array, stops: Array) -> HybridMachines:
    """Machines with a rigid contact as machines with modes, with this load (N, n) and these stops (N, 2)."""
    (N, n), nothing, none = machines.gap_row.shape, np.zeros((len(load), 0)), np.zeros((len(load), 1))
    return HybridMachines(
        machines.mass, machines.damping[:, None], machines.stiffness[:, None], load[:, None],
        machines.force_sin[:, None], machines.force_cos[:, None], machines.omega, machines.tau,
        starts=np.tile([0.0, 1.0], (N, 1)), row=machines.gap_row[:, None], stops=stops[:, None], R=machines.R[:, None],
        soft=none, by_force=none, pad=np.zeros((N, 1, 1, 3)), slide=np.zeros((N, 0, n)), belt=nothing,
        rub=np.zeros((N, 1, 0, 3)), law=np.zeros((N, 1, 2, 1, 3)), grip=np.zeros((N, 0, 1, 3)), counted=none + 1.0,
        drift=np.full(N, -1.0),
    )  # fmt: skip


@np.errstate(all="ignore")
def hybrid_faults(machines: HybridMachines) -> NDArray[np.int8]:
    """The reason against each of N machines, or NO_REASON, as far as its numbers alone show it.

    Conditions: lower stops below upper ones, 0 <= R <= 1; no negative stiffness, damping or preload of a contact, nor
    slope of its law; segments in order; 0 <= kinetic <= static; starts rising from 0 and below 1; rows that can be held
    together independent, see ``held_rows``, and moved in the direction of a force along them, see ``yields``. Nothing
    ties down a drifting coordinate.
    """
    own = machines
    lower, upper = own.stops[..., 0], own.stops[..., 1]
    reasons = np.full(len(own.omega), NO_REASON, dtype=np.int8)
    reasons[~yields(machines)] = NO_OSCILLATOR
    fine = (
        (lower < upper) & (own.R >= 0.0) & (own.R <= 1.0),
        own.pad >= 0.0,
        (own.rub[..., 0] >= 0.0) & (own.rub[..., 1] >= own.rub[..., 0]),
        ~np.isnan(own.law[..., 0]),
        ~np.isnan(own.grip[..., 0]),
        own.starts[:, :1] == 0.0,
        np.diff(own.starts, axis=1) > 0.0,
    )
    for sound in fine:
        reasons[_any(~sound)] = OUT_OF_RANGE
    reasons[dependent(held_rows(machines)) | dependent(own.slide)] = OUT_OF_RANGE
    if own.drifting >= 0:
        ties = own.stiffness[..., own.drifting], own.row[..., own.drifting]
        reasons[_any(ties[0] != 0.0) | _any(ties[1] != 0.0)] = NO_OSCILLATOR
    bounded = own._replace(stops=own.R, law=own.law[..., 1:], grip=own.grip[..., 1:])
    reasons[_any(np.isnan(own.stops)) | ~finite(bounded)] = OUT_OF_DOUBLES
    return reasons


def mirrors(machines: HybridMachines) -> Mask:
    """Mask of machines in which z(t) -> -z(t + T/2) takes motions to motions.

    Stops lie at equal distances from 0, belts rest, and half a period later the law is the same, with the load and the
    even harmonics of the force negated.
    """
    own, phases = machines, machines.sizes[0]
    half, ahead = phases // 2, np.mod(np.roll(own.starts[:, :-1], -(phases // 2), axis=1) - own.starts[:, :-1], 1.0)
    sign = np.where(np.arange(own.force_sin.shape[2]) % 2 == 0, 1.0, -1.0)[:, None]
    same = [own.damping, own.stiffness, own.pad, own.rub]
    later = [(field, field) for field in same] + [(own.load, -own.load)]
    later += [(field, sign * field) for field in (own.force_sin, own.force_cos)]
    uneven = [_any(np.roll(field, -half, axis=1) != image) for field, image in later]
    uneven += [_any(own.stops[..., 0] != -own.stops[..., 1]), _any(own.belt != 0.0)]
    uneven.append(_any(own.law[:, :, 0] != own.law[:, :, 1]))
    if phases > 1:
        uneven.append(_any(np.abs(ahead - 0.5) > HALFWAY))
    return ~np.any(uneven, axis=0)


def loses_nothing(machines: HybridMachines) -> Mask:
    """Mask of machines without any loss: no damping, R = 1, no friction. M and K are symmetric."""
    own = machines
    lossy = [_any(own.damping != -own.damping.swapaxes(-1, -2)), _any(own.R != 1.0), _any(own.pad[..., 1] != 0.0)]
    return np.asarray(~np.any(lossy, axis=0) & (own.sizes[2] == 0) & _has_energy(own))


def is_undriven(machines: HybridMachines) -> Mask:
    """Mask of machines whose energy never rises: no force, phases or moving belts; nor does damping or K feed them."""
    own = machines
    driven = [_any(own.force_sin != 0.0), _any(own.force_cos != 0.0), _any(own.belt != 0.0)]
    fields = (own.damping, own.stiffness, own.load, own.pad, own.rub)
    driven += [_any(field != field[:, :1]) for field in fields if own.sizes[0] > 1]
    even = 0.5 * (own.damping[:, 0] + own.damping[:, 0].swapaxes(-1, -2))
    return np.asarray(~np.any(driven, axis=0) & resists(even) & _has_energy(own))


def _has_energy(machines: HybridMachines) -> Mask:
    """Mask of machines whose M and K are symmetric in all phases."""
    return definite(machines.mass) & np.all(machines.stiffness == machines.stiffness.swapaxes(-1, -2), axis=(1, 2, 3))


@np.errstate(all="ignore")
def about_centre(machines: HybridMachines) -> tuple[HybridMachines, Array]:
    """Machines counted from the centre of their mirror symmetry, see ``mirrors``, and the centres (N, n).

    The centre lies midway between all stops and balances the mean load. Others stay as they are, with a centre of 0.
    """
    own, half, ends = machines, machines.sizes[0] // 2, np.isfinite(machines.stops)
    (N, P, n), between = own.load.shape, np.asarray(ends.all(axis=2))

    def ahead(field: Array) -> Array:
        return np.roll(field, -half, axis=1)

    middle = np.where(between, 0.5 * np.sum(np.where(ends, own.stops, 0.0), axis=2), 0.0)
    balance = 0.5 * (own.stiffness + ahead(own.stiffness)).reshape(N, P * n, n)
    matrix = np.concatenate([balance, np.where(between[..., None], own.row, 0.0)], axis=1)
    right = np.concatenate([0.5 * (own.load + ahead(own.load)).reshape(N, P * n), middle], axis=1)
    off_centre = np.asarray(np.any(right != 0.0, axis=1) & np.all(ends[..., 0] == ends[..., 1], axis=1))
    centre = np.zeros((N, n))
    off_centre &= np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    for r in np.flatnonzero(off_centre).tolist():
        centre[r] = np.linalg.lstsq(matrix[r], right[r])[0]
    size = (np.abs(matrix) @ np.abs(centre)[..., None])[..., 0] + np.abs(right)
    off_centre &= np.all(np.abs((matrix @ centre[..., None])[..., 0] - right) <= MIDWAY * size, axis=1)
    wide = 0.5 * np.where(between, own.stops[..., 1] - own.stops[..., 0], np.inf)
    pull = own.load - (own.stiffness @ centre[:, None, :, None])[..., 0]
    centred = own._replace(load=0.5 * (pull - ahead(pull)), stops=np.stack([-wide, wide], axis=2))
    off_centre &= mirrors(centred)
    load = np.where(off_centre[:, None, None], centred.load, own.load)
    stops = np.where(off_centre[:, None, None], centred.stops, own.stops)
    return own._replace(load=load, stops=stops), np.where(off_centre[:, None], centre, 0.0)


def held_rows(machines: HybridMachines) -> Array:
    """The rows (N, C + F, n) that rigid contacts and friction can hold, zeros for other elements.

    Friction on the row of a rigid contact, or a multiple of it, is left out: a held contact does not slide.
    """
    rigid = machines.row * (1.0 - machines.soft)[..., None]
    same = np.any((along_contacts(machines) != 0.0) & (machines.soft == 0.0)[:, None], axis=-1)  # (N, F)
    return np.concatenate([rigid, np.where(same[..., None], 0.0, machines.slide)], axis=1)


def along_contacts(machines: HybridMachines) -> Array:
    """(N, F, C): the factor a if the row of a friction is a times the row of a contact to rounding, else 0."""
    (slide, wide), (row, high) = _scaled(machines.slide), _scaled(machines.row)
    share = np.vecdot(slide[:, :, None], row[:, None]) / np.vecdot(row, row)[:, None]
    apart = np.max(np.abs(slide[:, :, None] - share[..., None] * row[:, None]), axis=-1)
    return np.where(apart <= PARALLEL, share * wide[..., None] / high[:, None], 0.0)


def _scaled(rows: Array) -> tuple[Array, Array]:
    """Rows (N, R, n) scaled to largest entries +-1, and the scale factors (N, R)."""
    size = np.max(np.abs(rows), axis=-1)
    size = np.where(size > 0.0, size, 1.0)
    return rows / size[..., None], size


def yields(machines: HybridMachines) -> Mask:
    """Mask of machines in which a force along any row moves it that way, g.M^-1 g > 0, also while others are held.

    All principal minors of G M^-1 G' are positive, with G the rows of contacts and all rows that can be held; true for
    symmetric, positive definite M.
    """
    all_yield = definite(machines.mass).copy()
    (others,) = np.nonzero(~all_yield)
    if len(others):
        all_yield[others] = _yield_along(at_rows(machines, others))
    return all_yield


@kept
def definite(mass: Array) -> Mask:
    """Mask of symmetric, positive definite matrices (N, n, n)."""
    return symmetric(mass) & (np.min(stacked(np.linalg.eigvalsh, mass.shape[:2], mass), axis=1) > 0.0)


def _yield_along(machines: HybridMachines) -> Mask:
    """``yields`` computed by the principal minors."""
    own, held = machines, held_rows(machines)
    inverse = stacked(np.linalg.inv, own.mass.shape, own.mass)
    singles = np.concatenate([own.row, own.slide], axis=1)
    along = np.vecdot(singles, (inverse[:, None] @ singles[..., None])[..., 0])
    all_yield = np.asarray(np.all(along > 0.0, axis=1))
    between = held @ inverse @ np.ascontiguousarray(held.swapaxes(1, 2))
    absent = ~np.any(held != 0.0, axis=-1)
    between = between + absent[:, :, None] * np.eye(held.shape[1])
    for size in range(2, held.shape[1] + 1):
        for chosen in combinations(range(held.shape[1]), size):
            all_yield &= np.linalg.det(between[:, chosen][:, :, chosen]) > 0.0
    return all_yield


@kept
def dependent(rows: Array) -> Mask:
    """Mask of machines (N,) in which the nonzero ones of rows (N, R, n) depend on each other."""
    largest = np.abs(rows).max(axis=-1, initial=0.0)
    scaled = rows / np.where(largest > 0.0, largest, 1.0)[..., None]  # keeps their squares in range
    length = np.sqrt(np.vecdot(scaled, scaled))
    unit = scaled / np.where(length > 0.0, length, 1.0)[..., None]
    values = stacked(_singular_values, (len(rows), min(rows.shape[1:])), unit)
    return np.asarray(np.sum(values > INDEPENDENT, axis=1) < np.sum(length != 0.0, axis=1))


def _singular_values(rows: Array) -> Array:
    return np.asarray(np.linalg.svd(rows, compute_uv=False))


def _any(wrong: Mask) -> Mask:
    """Machines with any true entry."""
    return np.asarray(np.any(wrong, axis=tuple(range(1, wrong.ndim))))
