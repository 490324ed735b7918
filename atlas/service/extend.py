"""Extending an atlas: a new store of more cells, which reuses the cells of an old one."""

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from atlas.errors import InputError, check_names, shown
from atlas.service.notebook import reporting
from atlas.service.options import DEFAULTS, RunFields, RunOptions
from atlas.service.progress import Progress
from atlas.service.run import complete
from atlas.service.summary import Summary
from atlas.spec.axis import Axis, check_count
from atlas.spec.differences import differences
from atlas.spec.spec import Spec
from atlas.store.location import place_of
from atlas.store.schema import Origin
from atlas.store.store import Header, done_tiles, read_header
from atlas.task.reuse import absent_results, count_shared
from atlas.text import plural
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client

SAME_VALUE_ULPS = 64
"""Units in the last place within which a new value means an old one: by so much do two ways to space points differ."""


def extend(
    store: str | os.PathLike[str],
    into: str | os.PathLike[str],
    spec: Spec | None = None,
    refine: int | Mapping[str, int] | None = None,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Unpack[RunFields],
) -> Summary:
    """Compute a larger or finer atlas into a new store, reusing the finished cells of ``store`` to the bit.

    ``spec`` is the spec of the new atlas; only the values on its axes may differ. Or ``refine`` is the factor by which
    all axes, or the axes by name, become finer. ``store`` does not change, and has to stay where it is until the new
    one is complete. The same call resumes an extension that was stopped. ``client``, ``options`` and
    ``fields``: as for ``run``.
    Raises InputError, before anything is written, where the two atlases do not fit together; see also ``run``.

    Of 7 x 5 cells, each axis twice as fine:

    >>> import atlas
    >>> summary = atlas.extend("plane.zarr", "finer.zarr", refine=2, client=client)
    >>> atlas.open("finer.zarr").largest.shape
    (9, 13)
    """
    old = read_header(store)
    if old.spec.points or (spec is not None and spec.points):
        raise InputError(f"{old.place}: a table of points is not extended: run the new table into a store of its own")
    if old.spec.attractors is not None or (spec is not None and spec.attractors is not None):
        raise InputError(f"{old.place}: an atlas of all attractors is not extended: run the new one into its own store")
    if (spec is None) == (refine is None):
        raise InputError("give either a spec or by how much to refine")
    grown = refined(old.spec, refine, old.tile) if spec is None else extended(old, spec)
    place = place_of(into)
    if place == old.place:
        raise InputError(f"{place}: is the store to be extended; the new one needs another path")
    if old.solver_version != SOLVER_VERSION:
        raise InputError(
            f"{old.place}: made by solver version {old.solver_version}, this is version {SOLVER_VERSION}; "
            "their numbers do not mix: compute the new atlas by atlas run"
        )
    if absent := absent_results(old):
        names = ", ".join(absent)
        raise InputError(f"{old.place}: too old, it has no {names}: compute the new atlas by atlas run")
    kept = count_shared(old, grown, done_tiles(old))
    if not kept:
        raise InputError(f"{old.place}: no finished cell of it lies on the new grid; compute that by atlas run")
    options = options.updated(**fields)
    with reporting(options.on_progress) as report:
        options = replace(options, on_progress=report)
        options.report(Progress(f"reusing {kept} of {plural(math.prod(grown.shape), 'cell')} from {old.place}"))
        return complete(grown, place, client, options, Origin(str(old.place), old.run_id))


def extended(old: Header, given: Spec) -> Spec:
    """The given spec with the old store's own values, see ``keep_values``; InputError where more than values differ."""
    stored = old.spec
    if stored.continuation is not None or given.continuation is not None:
        raise InputError(f"{old.place}: a continued sweep cannot be extended: each cell depends on those before it")
    names = [axis.name for axis in stored.axes]
    with_old_axes = given.resolved() | ({"axes": stored.resolved()["axes"]} if names == _names(given) else {})
    found = differences(stored, Spec.from_resolved(with_old_axes))
    if found:
        raise InputError(f"{old.place}: cannot be extended by this spec: {'; '.join(found)}")
    axes = {new.name: keep_values(before, new) for before, new in zip(stored.axes, given.axes, strict=True)}
    return _spec_of(stored, axes, given.tile)


def refined(stored: Spec, refine: int | Mapping[str, int] | None, tile: tuple[int, ...] | None = None) -> Spec:
    """The spec with each axis finer by a factor: new values between the old ones, which stay to the bit.

    ``refine`` is one factor for all axes with more than one value, or factors by name. New values divide the step
    between two old ones evenly, on a log axis their ratio. n values become (n - 1) factor + 1.
    """
    names = _names(stored)
    if stored.continuation is not None:
        raise InputError("refine: a continued sweep cannot be refined: each cell of it depends on those before it")
    if isinstance(refine, Mapping):
        check_names("axis", refine, names)
        factors = {name: refine.get(name, 1) for name in names}
    else:
        factors = {axis.name: refine if len(axis) > 1 else 1 for axis in stored.axes}  # type: ignore[misc]
    for name, factor in factors.items():
        if isinstance(factor, bool) or not isinstance(factor, int) or factor < 1:
            raise InputError(f"refine {name}: found {shown(factor)}, must be a whole number, 1 or more")
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


def keep_values(stored: Axis, given: Axis) -> Axis:
    """The given axis, with the stored value in place of each that differs from it by rounding only."""
    old, new = np.array(stored.values), np.array(given.values)
    after = np.searchsorted(old, new)
    below, above = old[np.maximum(after - 1, 0)], old[np.minimum(after, len(old) - 1)]
    near = np.where(np.abs(new - below) <= np.abs(new - above), below, above)
    scale = np.abs(new) if given.scale == "log" else np.max(np.abs(np.concatenate([old, new])))
    meant = np.abs(new - near) <= SAME_VALUE_ULPS * np.spacing(scale)
    return Axis(given.name, tuple(np.where(meant, near, new).tolist()), given.scale)


def _spec_of(stored: Spec, axes: Mapping[str, Axis], tile: tuple[int, ...] | None) -> Spec:
    store = {"tile": list(tile)} if tile else None
    return Spec(stored.record, axes, stored.parameters, stored.settings, store)


def _names(spec: Spec) -> list[str]:
    return [axis.name for axis in spec.axes]
