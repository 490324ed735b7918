"""Repair of a store: faulty objects are dropped, so that the next run, search or explorer computes them again.

Objects that no run computes are written again: metadata, coordinates and records of tiles, which the spec and the cells
determine.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from atlas.check.find_faults import VerifyFindings
from atlas.check.report import CHUNK, FOREIGN, GROUP, MACHINE, METADATA, PART, VerifyReport
from atlas.errors import REBUILD_COMMANDS
from atlas.formatting import plural
from atlas.overview.pyramid import Pyramid
from atlas.store.groups import drop_group
from atlas.store.host_records import mend_record, read_host
from atlas.store.metadata import ROOT
from atlas.store.record_format import RECORDS, WIDTH
from atlas.store.schema import PARTS
from atlas.store.tile_records import forget_records, write_records
from atlas.store.tiles import drop_tile

Names = Sequence[tuple[Any, ...]]
"""The names of faulty objects of one kind."""


def repair(findings: VerifyFindings) -> VerifyReport:
    """Drop or restore the faulty objects of a leased store; return the report of the verification with the repairs.

    Overviews are dropped before the tiles below them. Without a fault nothing is written.
    """
    handle, faults = findings.handle, findings.report.faults
    handle.backend.confirm_lease()
    tiles = sorted({fault.tile for fault in faults if fault.tile is not None})
    parts = list(dict.fromkeys(fault.part for fault in faults if fault.part))

    def names(kind: str) -> Names:
        return [part[1:] for part in parts if part[0] == kind]

    pyramid = Pyramid(handle)
    dropped = pyramid.drop_chunks({*names(CHUNK), *((1, pyramid.levels.chunk_over(tile)) for tile in tiles)})
    if tiles:
        forget_records(handle, tiles)
    for index in tiles:
        drop_tile(handle, index)
    removed = (*(str(key) for (key,) in names(FOREIGN)), *findings.report.leftovers)
    for key in removed:
        handle.backend.remove(key)
    restored = [line for kind, mend in MENDERS.items() if names(kind) for line in mend(findings, names(kind))]
    return replace(findings.report, repaired=tuple(tiles), dropped=dropped, removed=removed, restored=tuple(restored))


def _write_metadata(findings: VerifyFindings, names: Names) -> Iterator[str]:
    """Write the metadata and coordinates that the store should have, those of the root at the end.

    Yield a line of text for each.
    """
    for (key,) in sorted(names, key=lambda name: name == (ROOT,)):
        findings.handle.backend.put(key, findings.right[key])
        yield f"{key} written again"


def _drop_groups(findings: VerifyFindings, names: Names) -> Iterator[str]:
    handle = findings.handle
    for (group,) in names:
        drop_group(handle, group)
        handle.backend.remove_all(list(handle.backend.list_keys(f"{group}/")))
        command = f"{REBUILD_COMMANDS[group]} {handle.backend}" if group in REBUILD_COMMANDS else "the next run"
        yield f"{group} dropped: {command} makes them anew"


def _drop_parts(findings: VerifyFindings, names: Names) -> Iterator[str]:
    backend = findings.handle.backend
    for (key,) in names:
        backend.remove(key)
        yield f"{key} dropped: {REBUILD_COMMANDS[key.removeprefix(PARTS).split('/')[1]]} {backend} finds it again"


def _mend_machines(findings: VerifyFindings, names: Names) -> Iterator[str]:
    handle = findings.handle
    for (key,) in names:
        if read_host(handle.backend, key) is None:
            is_restored = mend_record(handle, key)
            yield f"{key} written again" if is_restored else f"{key} replaced by the record of an unknown host"


def _write_records(findings: VerifyFindings, _: Names) -> Iterator[str]:
    """Write the records of the tiles without faults, computed from their cells; yield a line of text."""
    rows = np.zeros((*findings.handle.tiling.grid, WIDTH))
    for index, row in findings.rows.items():
        rows[index] = row
    write_records(findings.handle, rows)
    yield f"records of {plural(len(findings.rows), 'tile')} written again"


MENDERS: dict[str, Callable[[VerifyFindings, Names], Iterator[str]]] = {
    METADATA: _write_metadata,
    GROUP: _drop_groups,
    PART: _drop_parts,
    MACHINE: _mend_machines,
    RECORDS: _write_records,
}
"""For each kind of faulty object, the function that drops or restores such objects and yields lines of text.

They are called in this order.
"""
