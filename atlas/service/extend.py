"""Extend an atlas: compute a larger or finer atlas into a new store, which takes over the cells of an old store."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import validate_type
from atlas.errors import InputError
from atlas.formatting import plural
from atlas.service.options import DEFAULTS, RunOptions, with_fields
from atlas.service.progress import Progress
from atlas.service.run import complete
from atlas.service.store_call import store_call
from atlas.service.summary import RunSummary
from atlas.spec.extension import extend_spec, refine_spec
from atlas.spec.spec import Spec
from atlas.store.object_backend import Given, StoreBackend, is_url, sibling_backend, sibling_name
from atlas.store.origin import Origin, RetryRequest
from atlas.store.store import AtlasStore, done_tiles, open_store
from atlas.task.reuse import count_shared
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client


@with_fields
def extend(
    store: Given,
    into: Given,
    spec: Spec | None = None,
    refine: int | Mapping[str, int] | None = None,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Any,
) -> RunSummary:
    """Compute a larger or finer atlas into a new store, reusing the finished cells of ``store`` to the bit.

    ``spec`` is the spec of the new atlas; only the values on its axes may differ. Alternatively ``refine`` is the
    factor by which all axes, or the named axes, become finer. ``store`` does not change, and must stay in place until
    the new store is complete; at URLs ``storage_options`` are for both stores. The same call resumes an extension that
    was stopped. ``client``, ``options`` and ``fields`` are those of ``run``. Raise InputError, before anything is
    written, if the two atlases do not fit together; see also ``run``.

    Of 7 x 5 cells, each axis twice as fine:

    >>> import atlas
    >>> summary = atlas.extend("plane.zarr", "finer.zarr", refine=2, client=client)
    >>> atlas.open("finer.zarr").largest.shape
    (9, 13)
    """
    if spec is not None:
        validate_type("spec", spec, Spec, "an atlas.Spec")
    with store_call(into, client, options, fields) as call:
        old = handle_from(store, call.options.storage_options)
        if old.spec.points or (spec is not None and spec.points):
            raise InputError(
                f"{old.backend}: a table of points cannot be extended: run the new table into a store of its own"
            )
        if old.spec.attractors is not None or (spec is not None and spec.attractors is not None):
            raise InputError(
                f"{old.backend}: an atlas of all attractors cannot be extended: run the new one into a store of its own"
            )
        if (spec is None) == (refine is None):
            raise InputError("extend: give either spec or refine")
        if spec is None:
            grown = refine_spec(old.spec, refine, old.tile)
        else:
            grown = extend_spec(old.spec, spec, str(old.backend))
        origin = origin_for(call.backend, old)
        n_reused = count_shared(old, grown, done_tiles(old))
        if not n_reused:
            raise InputError(
                f"{old.backend}: no finished cell lies on the new grid; compute the new atlas with atlas run"
            )
        reused = f"reusing {n_reused} of {plural(math.prod(grown.shape), 'cell')} from {old.backend}"
        call.options.report(Progress(reused))
        return complete(grown, call, origin)


def handle_from(store: Given, storage_options: Mapping[str, Any] | None) -> AtlasStore:
    """Return the handle of the old store, whose cells are reused.

    If it is at a URL, the access options ``storage_options`` of the new store apply to it, too.
    """
    return open_store(store, storage_options if is_url(store) else None)


def origin_for(backend: StoreBackend, old: AtlasStore, request: RetryRequest | None = None) -> Origin:
    """Check that a new store can take over cells of an old store, and return the old store as its origin.

    backend  backend of the new store
    old      handle of the old store
    request  cells that are to be solved again, for a retry; None for an extension

    Raise InputError if the new store cannot take over cells, for example because the solver versions differ.
    """
    if backend == old.backend:
        raise InputError(f"{backend}: found the store to take cells from, must be another path")
    if sibling_backend(backend, str(old.backend)) != old.backend:
        raise InputError(
            f"{old.backend}: workers reach it in the same way as {backend}; give both as paths or both as URLs"
        )
    if old.solver_version != SOLVER_VERSION:
        raise InputError(
            f"{old.backend}: computed by solver version {old.solver_version}, installed is {SOLVER_VERSION}; "
            "a store cannot mix solver versions, compute the new atlas with atlas run"
        )
    return Origin(sibling_name(backend, old.backend), old.run_id, request)
