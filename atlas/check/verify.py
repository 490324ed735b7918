"""Verification: faults are found, and dropped on request."""

import random
from collections.abc import Callable
from contextlib import ExitStack

from atlas.arguments import checked_flag, checked_kind, is_whole
from atlas.check.find import Findings, find
from atlas.check.repair import repair as drop_faulty
from atlas.check.report import Report
from atlas.errors import InputError, shown
from atlas.service.lease import claimed
from atlas.service.notebook import reporting
from atlas.service.progress import Progress
from atlas.store.archive import refuse_packed
from atlas.store.location import Given, place_of, refused
from atlas.store.sidecar import notes_of
from atlas.store.spare import read_spare
from atlas.store.store import open_handle

SAMPLE = 32


def verify(
    store: Given,
    sample: int = SAMPLE,
    repair: bool = False,
    seed: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Report:
    """Read a whole store, while no run is at work on it, and report all its faults.

    Metadata and coordinates are compared with the spec. Every chunk of every finished tile is read, which checks its
    checksum, and every tile is compared with its record. Every cell is checked by ``rules``, the sum law among them.
    Every chunk of an overview is compared with the cells below it. ``sample`` cells, drawn by ``seed``, are solved
    again: on the kind of machine that solved them the results must be the same to the bit, elsewhere within the
    errors. Tables, curves, records of machines and zoom levels are checked too.
    ``repair`` holds the store's claim throughout and drops faulty parts, so that the next run makes them again: a tile
    with a fault becomes unfinished; faulty overviews, tables, curves, zoom levels and foreign names among the chunks
    are removed. Damaged metadata and coordinates, which the spec determines, and records of tiles are written again.
    Files that killed writes have left are removed. A tile that is only in doubt stays; without a fault nothing is
    written.
    Raises InputError without a store to verify, OSError if it cannot be read or repaired.

    >>> import atlas
    >>> atlas.verify("plane.zarr", sample=2).fine
    True
    """
    if not is_whole(sample) or sample < 0:
        raise InputError(f"sample: found {shown(sample)}, must be a whole number, 0 or more")
    if seed is not None:
        checked_kind("seed", seed, int, "a whole number")
    checked_flag("repair", repair)
    place = place_of(store)
    if repair:
        refuse_packed(place)
    with refused(place, "read"):
        if read_spare(place) is None:
            open_handle(place)  # raises without a store, before its claim is taken
    drawn = random.SystemRandom().randrange(2**32) if seed is None else seed
    with reporting(on_progress) as report, ExitStack() as stack:
        if repair:
            place = stack.enter_context(claimed(notes_of(place), str(place))).guard(place)

        def read() -> Findings:
            return find(place, sample, drawn, report or (lambda _: None))

        return drop_faulty(read(), read) if repair else read().report
