"""The spec of a larger or finer atlas, which contains the cells of a stored atlas to the bit."""

from collections.abc import Mapping

import numpy as np

from atlas.argument_checks import is_integer
from atlas.errors import InputError, brief_repr, check_names
from atlas.spec.axis import Axis, check_count
from atlas.spec.differences import differences
from atlas.spec.spec import Spec

SAME_VALUE_ULPS = 64
"""Maximum difference, in units in the last place, between a new and a stored value of an axis that count as equal.

Two ways to compute evenly spaced points differ by that much.
"""


def extend_spec(stored: Spec, spec: Spec, name: str) -> Spec:
    """Return ``spec``, of a larger or finer atlas, with the values of the stored axes to the bit where they occur.

    stored  spec of the stored atlas
    spec    spec of the new atlas
    name    name of the store, for messages

    Raise InputError if the specs differ in more than the values on the axes.
    """
    if stored.continuation is not None or spec.continuation is not None:
        raise InputError(f"{name}: a continued sweep cannot be extended: each cell depends on the cells before it")
    names = [axis.name for axis in stored.axes]
    with_old_axes = spec.to_resolved() | ({"axes": stored.to_resolved()["axes"]} if names == _names(spec) else {})
    reasons = differences(stored, Spec.from_resolved(with_old_axes))
    if reasons:
        raise InputError(f"{name}: cannot be extended by this spec: {'; '.join(reasons)}")
    axes = {new.name: keep_values(before, new) for before, new in zip(stored.axes, spec.axes, strict=True)}
    return _spec_of(stored, axes, spec.tile)


def refine_spec(stored: Spec, refine: int | Mapping[str, int] | None, tile: tuple[int, ...] | None = None) -> Spec:
    """Return the spec with each axis refined by a factor: new values between the old ones, which stay to the bit.

    ``refine`` is one factor for all axes with more than one value, or factors by name. New values divide the step
    between two old ones evenly, on a log axis their ratio. n values become (n - 1) factor + 1.
    """
    names = _names(stored)
    if stored.continuation is not None:
        raise InputError("refine: a continued sweep cannot be refined: each cell depends on the cells before it")
    if isinstance(refine, Mapping):
        check_names("axis", refine, names)
        factors = {name: refine.get(name, 1) for name in names}
    else:
        factors = {axis.name: refine if len(axis) > 1 else 1 for axis in stored.axes}  # type: ignore[misc]
    for name, factor in factors.items():
        if not is_integer(factor) or factor < 1:
            raise InputError(f"refine {name}: found {brief_repr(factor)}, must be a whole number, 1 or more")
    for axis in stored.axes:
        check_count(f"refine {axis.name}", (len(axis) - 1) * factors[axis.name] + 1)
        if len(axis) == 1 and factors[axis.name] > 1:
            raise InputError(f"refine {axis.name}: an axis with one value has nothing in between; extend it by a spec")
    if all(factor == 1 for factor in factors.values()):
        raise InputError("refine: no axis would become finer; give a factor of 2 or more")
    return _spec_of(stored, {axis.name: _finer(axis, factors[axis.name]) for axis in stored.axes}, tile)


def _finer(axis: Axis, factor: int) -> Axis:
    old = np.array(axis.values)
    values = np.empty((len(old) - 1) * factor + 1)
    values[::factor] = old
    for k in range(1, factor):
        share = k / factor
        between = old[:-1] * (old[1:] / old[:-1]) ** share if axis.scale == "log" else old[:-1] + np.diff(old) * share
        values[k::factor] = between
    return Axis(axis.name, tuple(values.tolist()), axis.scale)


def keep_values(stored: Axis, axis: Axis) -> Axis:
    """Return an axis in which values that differ from a stored value only by rounding are replaced by the stored
    value.
    """
    old, new = np.array(stored.values), np.array(axis.values)
    after = np.searchsorted(old, new)
    below, above = old[np.maximum(after - 1, 0)], old[np.minimum(after, len(old) - 1)]
    near = np.where(np.abs(new - below) <= np.abs(new - above), below, above)
    scale = np.abs(new) if axis.scale == "log" else np.max(np.abs(np.concatenate([old, new])))
    meant = np.abs(new - near) <= SAME_VALUE_ULPS * np.spacing(scale)
    return Axis(axis.name, tuple(np.where(meant, near, new).tolist()), axis.scale)


def _spec_of(stored: Spec, axes: Mapping[str, Axis], tile: tuple[int, ...] | None) -> Spec:
    store = {"tile": list(tile)} if tile else None
    return Spec(stored.system_def, axes, stored.parameters, stored.settings, store)


def _names(spec: Spec) -> list[str]:
    return [axis.name for axis in spec.axes]
