"""Verification of a store: find its faults, and repair them on request."""

import random
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from atlas.argument_checks import is_integer, validate_flag, validate_type
from atlas.check.find_faults import find_faults
from atlas.check.metadata import open_damaged_store
from atlas.check.repair import repair as drop_faulty
from atlas.check.report import VerifyReport
from atlas.errors import InputError, brief_repr
from atlas.service.lease import hold_lease
from atlas.service.notebook import progress_reporter
from atlas.service.progress import Progress
from atlas.store.object_backend import Given, open_backend, os_errors_as_input_errors
from atlas.store.sidecar import sidecar_of
from atlas.store.zarr_backend import check_not_packed

SAMPLE = 32


def verify(
    store: Given,
    sample: int = SAMPLE,
    repair: bool = False,
    seed: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    storage_options: Mapping[str, Any] | None = None,
) -> VerifyReport:
    """Read a whole store, while no run holds its lease, and report all its faults.

    Metadata and coordinates are compared with the spec. Every chunk of every finished tile is read, which checks its
    checksum, and every tile is compared with its record. Every cell is checked by ``rules``, the sum law among them.
    Every chunk of an overview is compared with the cells below it. ``sample`` cells, drawn by ``seed``, are solved
    again. On the kind of host that solved them the results must be the same to the bit, elsewhere within the errors.
    Tables, curves and records of hosts are checked, too.

    ``repair`` holds the store's lease throughout and drops faulty parts, so that the next run computes them again. A
    tile with a fault becomes unfinished. Faulty overviews, tables, curves and foreign names among the chunks are
    removed. Damaged metadata and coordinates, which the spec determines, and records of tiles are written again. Files
    that killed writes have left are removed. A tile that is only in doubt stays; without a fault nothing is written.

    ``storage_options`` are those of ``open``. Raise InputError if there is no store to verify, OSError if it cannot be
    read or repaired.

    >>> import atlas
    >>> atlas.verify("plane.zarr", sample=2).is_sound
    True
    """
    if not is_integer(sample) or sample < 0:
        raise InputError(f"sample: found {brief_repr(sample)}, must be a whole number, 0 or more")
    if seed is not None:
        validate_type("seed", seed, int, "a whole number")
    validate_flag("repair", repair)
    backend = open_backend(store, storage_options=storage_options)
    if repair:
        check_not_packed(backend)
    with os_errors_as_input_errors(backend, "read"):
        open_damaged_store(backend)  # raises without a store, before its lease is taken
    drawn = random.SystemRandom().randrange(2**32) if seed is None else seed
    with progress_reporter(on_progress) as report, ExitStack() as stack:
        if repair:
            backend = stack.enter_context(hold_lease(sidecar_of(backend), str(backend))).bind(backend)
        findings = find_faults(backend, sample, drawn, report or (lambda _: None))
        return drop_faulty(findings) if repair else findings.report
