"""Piecewise linear laws of springs, contacts and friction, as numbers of their segments.

    law = [[x_0, F_0], [x_1, F_1], ...]

The last segment has no end; the first segment of a spring has none either. The law of a contact is a function of its
depth, that of friction of |v|, from 0 on. The value at 0 is the preload or the kinetic level; Machines holds the
increment of the law from that value on. The law of a spring is a function of y. Its segment at y = 0 goes into the
stiffness and load of the machine. The ends of that segment are stops of a contact that adds the rest of the law.

An expression becomes a table of the fewest segments, see piecewise_fit.py. The segments of an invalid law start at NaN.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from workers.model.elements import Contact, Friction, Spring
from workers.model.expression import Expression, evaluate_entries
from workers.model.machines import Machines
from workers.model.oscillator import Array
from workers.model.parameter import OMEGA
from workers.model.piecewise_fit import POINTS, fewest

EVEN = 8.0 * float(np.finfo(np.float64).eps)
"""Relative difference of slopes up to which adjacent segments count as one: the rounding of a table of an odd law."""


class SpringTables(NamedTuple):
    """N springs of piecewise linear laws, split into the segment with y = 0 and the rest.

    stiffness, force  (N,) stiffness, and force at y = 0, of the segment with y = 0
    stops             (N, 2) ends of that segment
    law               (N, 2, S, 3) further force beyond these ends, as in Machines.contact_laws
    """

    stiffness: Array
    force: Array
    stops: Array
    law: Array


SEGMENTS = 64
"""Maximum number of segments of a law."""

SAMPLES = 256
"""Number of intervals of an argument's range in which the greatest force of a law is searched for."""

ARGUMENTS: dict[type, str] = {Contact: "d", Spring: "y", Friction: "v"}
"""Argument of a law in an expression: depth of a contact, coordinate of a spring, |v| of friction."""


@np.errstate(all="ignore")
def vertices(element: Contact | Friction | Spring, named: Mapping[str, Array], limit: float = SEGMENTS) -> Array:
    """Return the vertices (N, V, 2), argument and force, of an element's law.

    element  contact, friction or spring with a law
    named    values (N,) by name
    limit    maximum number of segments of an expression

    Machines with fewer vertices have infinite arguments at the end. The vertices are NaN if an expression takes more
    segments than ``limit``, or has no value.
    """
    if not isinstance(element.law, Expression):
        return evaluate_entries(element.law, named)
    law, count = element.law, named[OMEGA].size
    names = sorted(law.names & named.keys())
    bounds = np.concatenate([evaluate_entries((element.within,), named), _ranges(element, named)], axis=1)
    every = np.concatenate([*(named[name][:, None] for name in names), bounds], axis=1)
    kinds, kind = np.unique(every, axis=0, return_inverse=True)
    tables = [_fitted(element, dict(zip(names, values, strict=False)), *values[-3:].tolist()) for values in kinds]
    tables = [table if len(table) - 1 <= limit else np.full((2, 2), np.nan) for table in tables]
    padded = np.full((len(kinds), max(map(len, tables), default=2), 2), [np.inf, 0.0])
    for k, table in enumerate(tables):
        padded[k, : len(table)] = table
    return padded[kind.reshape(count)]


@np.errstate(all="ignore")
def law_use(
    element: Contact | Friction | Spring, named: Mapping[str, Array], low: Array, high: Array
) -> tuple[Array, Array]:
    """Return how far motions used an element's law that is an expression, and the error bound there.

    element    contact, friction or spring with the law
    named      values (N,) by name
    low, high  (N,) least and greatest argument of the law during the motions

    The first result (N,) is the largest argument as a share of the range. The second (N,) is the error bound as a share
    of the greatest force at these arguments, NaN if there was no force.
    """
    law = element.law
    assert isinstance(law, Expression)
    wide, within = _ranges(element, named), evaluate_entries((element.within,), named)[:, 0]
    share = np.maximum(high / wide[:, 1], np.where(wide[:, 0] < 0.0, low / wide[:, 0], 0.0))

    def greatest(low: Array, high: Array) -> Array:
        x = np.linspace(low, high, SAMPLES + 1, axis=1)
        forces = law({name: value[:, None] for name, value in named.items()} | {ARGUMENTS[type(element)]: x})
        return np.max(np.abs(np.broadcast_to(forces, x.shape)), axis=1)

    met = greatest(np.maximum(low, wide[:, 0]), np.minimum(high, wide[:, 1]))
    return share, np.where(met > 0.0, within * greatest(*wide.T) / met, np.nan)


def _ranges(element: Contact | Friction | Spring, named: Mapping[str, Array]) -> Array:
    """Return the least and greatest argument (N, 2) for which an element's law, an expression, is to be accurate."""
    if isinstance(element.range, tuple):
        return evaluate_entries(element.range, named)
    (reach,) = evaluate_entries((element.range,), named).T
    return np.stack([-reach if isinstance(element, Spring) else 0.0 * reach, reach], axis=1)


def _fitted(
    element: Contact | Friction | Spring, numbers: Mapping[str, float], within: float, low: float, high: float
) -> Array:
    """Return the vertices (V, 2) of the fewest straight segments that approximate an element's law.

    element    contact, friction or spring whose law is an expression
    numbers    values by name
    within     error bound, as a share of the largest force
    low, high  range of the argument
    """
    law, argument = element.law, ARGUMENTS[type(element)]
    assert isinstance(law, Expression)

    def force(x: Array) -> Array:
        values = {name: np.full_like(x, number) for name, number in {OMEGA: 1.0, **numbers}.items()}
        return law(values | {argument: x})

    if not (low <= 0.0 <= high and low < high and high - low < np.inf):
        return np.full((2, 2), np.nan)
    forces = [force(np.linspace(0.0, end, POINTS + 1)) for end in (low, high)]
    bound = within * float(np.max(np.abs(forces)))
    rises = isinstance(element, Contact) and bool(np.all(np.diff(forces[1]) >= 0.0))
    least, reach = 0.0 if rises else -np.inf, max(-low, high)
    sides = [fewest(force, end, bound, least, reach) for end in (low, high) if end != 0.0]
    points = sides[-1] if high != 0.0 else sides[0][::-1]
    if len(sides) == 2:
        points = np.concatenate([sides[0][:0:-1], points])
    if isinstance(element, Friction) and len(points) > 1 and points[-1, 1] < points[-2, 1]:
        points = np.concatenate([points, [[2.0 * high, points[-1, 1]]]])  # beyond the range it falls no further
    return points


@np.errstate(all="ignore")
def segments_of(element: Contact | Friction | Spring, table: Array) -> int:
    """Return the number of segments of a law with these vertices (V, 2)."""
    if not isinstance(element, Spring):
        return len(table) - 1
    spring = two_sided(table[None])
    return 1 + int(np.sum(np.isfinite(spring.law[0, :, :, 0]) & np.isfinite(spring.stops[0])[:, None]))


def one_sided(table: Array, falls: bool) -> tuple[Array, Array]:
    """Return the force at 0 (N,) and the segments (N, S, 3) of laws whose argument begins at 0, such as a depth.

    table  (N, V, 2) vertices, argument and force
    falls  True if the law may fall, as that of friction may

    Segments are those of Machines.contact_laws. If the law may fall, no force may be negative and the last
    segment may not fall. Otherwise no segment may fall. The segments of any other law start at NaN.
    """
    x, slope, rises = _chords(table)
    first = table[:, 0, 1]
    segments = _segments(x[:, :-1], np.where(np.isfinite(x[:, 1:]), slope, np.nan))
    end = np.maximum(np.sum(np.isfinite(x), axis=1) - 2, 0)
    last = np.take_along_axis(slope, end[:, None], axis=1)[:, 0]
    sound = rises & (x[:, 0] == 0.0) & (last >= 0.0)
    above = np.where(np.isfinite(x), table[..., 1] >= 0.0, True)
    sound &= np.all(above if falls else slope >= 0.0, axis=1)
    segments[np.logical_not(sound), :, 0] = np.nan
    return first, segments


def two_sided(table: Array) -> SpringTables:
    """Return N springs whose force laws have these vertices (N, V, 2), argument and force."""
    x, slope, rises = _chords(table)
    N, S = slope.shape
    count = np.sum(np.isfinite(x), axis=1)
    rest = np.clip(np.sum(x <= 0.0, axis=1) - 1, 0, count - 2)  # the segment with y = 0

    def at(field: Array, i: Any) -> Array:
        return np.take_along_axis(field, np.clip(i, 0, field.shape[1] - 1)[:, None], axis=1)[:, 0]

    before, after = at(slope, rest - 1), at(slope, rest)
    alike = np.abs(after - before) <= EVEN * (np.abs(after) + np.abs(before))
    low = rest - ((rest > 0) & (at(x, rest) == 0.0) & alike)
    ends = np.stack([low, rest + 1], axis=1)
    (x0, x1), (F0, F1) = (np.take_along_axis(of, ends, axis=1).T for of in (x, table[..., 1]))
    stiffness, force = (F1 - F0) / (x1 - x0), (F0 * x1 - F1 * x0) / (x1 - x0)
    law = np.empty((N, 2, S, 3))
    for side, sign in ((0, -1), (1, 1)):
        first = low - 1 if sign < 0 else rest + 1
        places = first[:, None] + sign * np.arange(S)
        exists = (places >= 0) & (places < count[:, None] - 1)
        inside = np.clip(places, 0, S - 1)
        begins = np.take_along_axis(x, inside + (sign < 0), axis=1)
        more = np.take_along_axis(slope, inside, axis=1) - stiffness[:, None]
        starts = sign * (begins - (x0 if sign < 0 else x1)[:, None])
        law[:, side] = _segments(np.where(exists, starts, np.inf), np.where(exists, more, np.nan))
    stops = np.where(np.isfinite(law[:, :, 0, 0]), np.stack([x0, x1], axis=1), [-np.inf, np.inf])
    law[:, :, 0, 0] = 0.0
    law[np.logical_not(rises), ..., 0] = np.nan
    return SpringTables(stiffness, force, stops, law)


def sprung(machines: Machines, row: Array, spring: SpringTables) -> Machines:
    """Return machines with one more spring on y = row . x, for rows (N, n).

    Its segment with y = 0 is added to stiffness and load; the rest of its law becomes a soft contact.
    """
    N, C = len(row), machines.sizes[1]

    def and_one(field: Array, value: Any, axis: int = 1) -> Array:
        shape = field.shape[:axis] + field.shape[axis + 1 :]
        return np.concatenate([field, np.expand_dims(np.broadcast_to(value, shape), axis)], axis=axis)

    pull = spring.stiffness[:, None, None] * (row[:, :, None] * row[:, None, :])
    parts = [machines.contact_laws[:, c] for c in range(C)]
    return machines._replace(
        stiffness=machines.stiffness + pull[:, None],
        load=machines.load - (spring.force[:, None] * row)[:, None],
        row=and_one(machines.row, row), stops=and_one(machines.stops, spring.stops), R=and_one(machines.R, 1.0),
        soft=and_one(machines.soft, 1.0), by_force=and_one(machines.by_force, 0.0),
        contact_constants=and_one(machines.contact_constants, 0.0, axis=2), contact_laws=widened([*parts, spring.law],
        (N, 2)),
        counted=and_one(machines.counted, 0.0),
    )  # fmt: skip


def widened(laws: list[Array], shape: tuple[int, ...]) -> Array:
    """Return laws (N, ..., S, 3) of several elements as one array (N, elements, ..., S, 3) with room for the longest.

    ``shape`` is (N, ...).
    """
    most = max([1, *(law.shape[-2] for law in laws)])
    wide = np.zeros((shape[0], len(laws), *shape[1:], most, 3))
    wide[..., 1:, 0] = np.inf
    for i, law in enumerate(laws):
        wide[:, i, ..., : law.shape[-2], :] = law
    return wide


def none(*shape: int) -> Array:
    """Return the segments (..., 1, 3), zeros, of elements without a force law; ``shape`` is their shape (...)."""
    return np.zeros((*shape, 1, 3))


def _chords(table: Array) -> tuple[Array, Array, Array]:
    """Return arguments (N, V), slopes (N, V - 1) and a mask (N,) of laws with vertices ``table`` (N, V, 2).

    The slopes are 0 beyond the last vertex. The mask is True if all arguments rise.
    """
    x, F = table[..., 0], table[..., 1]
    exists = np.isfinite(x[:, 1:]) | np.isnan(x[:, 1:])
    run = np.where(exists, np.diff(np.where(x == np.inf, 0.0, x), axis=1), 1.0)
    slope = np.where(exists, np.diff(F, axis=1) / run, 0.0)
    return x, slope, np.all((run > 0.0) & np.isfinite(slope), axis=1)


def _segments(starts: Array, slope: Array) -> Array:
    """Return segments (N, S, 3): start, slope, and force extrapolated to 0; the force is zero at the first start.

    starts  (N, S) arguments at which the segments begin
    slope   (N, S) slopes; NaN if there is no segment
    """
    exists = np.isfinite(slope)
    slope = np.where(exists, slope, 0.0)
    safe = np.where(exists, starts, 0.0)
    rise = np.where(exists[:, 1:], slope[:, :-1] * np.diff(safe, axis=1), 0.0)
    level = np.concatenate([np.zeros((len(safe), 1)), np.cumsum(rise, axis=1)], axis=1)
    return np.stack([np.where(exists, starts, np.inf), slope, np.where(exists, level - slope * safe, 0.0)], axis=-1)
