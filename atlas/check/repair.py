"""Repair of a store: faulty parts are dropped, so that the next run, search or explorer computes them again.

Parts that no run computes are written again: metadata, coordinates and records of tiles, which the spec and the cells
determine.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from atlas.check.find_faults import VerifyFindings
from atlas.check.metadata import copy_faults
from atlas.check.report import CHUNK, COORDINATES, COPIES, COPY, FOREIGN, GROUP, MACHINE, PART, VerifyReport
from atlas.errors import REBUILD_COMMANDS
from atlas.formatting import plural
from atlas.overview.pyramid import Pyramid, drop_overviews
from atlas.store.backend import StoreBackend
from atlas.store.groups import ARRAYS, drop_group, group_attributes
from atlas.store.host_records import mend_record, read_host
from atlas.store.metadata_backup import (
    SPARE,
    copy_members,
    copy_metadata,
    encode_backup,
    find_backup_faults,
    read_backup,
    restore_from_backup,
    without_consolidated,
)
from atlas.store.record_format import RECORDS, WIDTH
from atlas.store.schema import OVERVIEWS
from atlas.store.store import ROOT, open_arrays
from atlas.store.tile_records import write_compaction
from atlas.store.tiles import drop_tile, encode_chunks

Names = Sequence[tuple[Any, ...]]
"""The names of faulty parts of one kind, without the kind itself."""


def repair(findings: VerifyFindings, again: Callable[[], VerifyFindings]) -> VerifyReport:
    """Drop the faulty parts of a leased store, and return the report of the repair; without a fault nothing is written.

    Damaged metadata are written again, and then the store is read ``again``, since no cell was read through them.
    """
    if not findings.is_unreadable:
        return _repaired(findings)
    written, first = _write_metadata(findings.handle.backend), findings.report.faults
    findings = again()
    if findings.is_unreadable:
        faults = tuple(dict.fromkeys((*first, *findings.report.faults)))
        return replace(findings.report, faults=faults, repaired=())
    report = _repaired(findings)
    return replace(report, faults=(*first, *report.faults), restored=(*written, *report.restored))


def _write_metadata(place: StoreBackend) -> list[str]:
    """Write metadata from their backup, else the root's copies from the arrays; return a line for each."""
    spare = read_backup(place)
    if spare is not None and (lost := find_backup_faults(place, spare)):
        restore_from_backup(place, spare, lost)
        return [f"{key} written again" for key in lost]
    copy_metadata(place, json.loads(place.get(ROOT) or b"{}"))
    return [f"{ROOT}: its consolidated metadata written again"]


def _repaired(findings: VerifyFindings) -> VerifyReport:
    """Drop or restore the faulty parts, overviews before the tiles below them; return the report with the repairs."""
    handle, faults = findings.handle, findings.report.faults
    tiles = sorted({fault.tile for fault in faults if fault.tile is not None})
    parts = list(dict.fromkeys(fault.part for fault in faults if fault.part))

    def names(kind: str) -> Names:
        return [part[1:] for part in parts if part[0] == kind]

    pyramid = Pyramid(handle)
    dropped = pyramid.drop_chunks({*names(CHUNK), *((1, pyramid.levels.chunk_over(tile)) for tile in tiles)})
    for index in tiles:
        drop_tile(handle, index)
    removed = (*(str(key) for (key,) in names(FOREIGN)), *findings.report.leftovers)
    for key in removed:
        handle.backend.remove(key)
    restored = [line for kind, mend in MENDERS.items() if names(kind) for line in mend(findings, names(kind))]
    return replace(findings.report, repaired=tuple(tiles), dropped=dropped, removed=removed, restored=tuple(restored))


def _mend_spare(findings: VerifyFindings, _: Names) -> Iterator[str]:
    place = findings.handle.backend
    place.put(SPARE, encode_backup(place.get(ROOT) or b""))
    yield f"{SPARE} written again"


def _mend_coordinates(findings: VerifyFindings, _: Names) -> Iterator[str]:
    """Write the coordinates and their copies again, from the spec."""
    handle = findings.handle
    arrays, objects = open_arrays(handle), handle.copies
    for name, coordinate in handle.coordinates.items():
        objects |= encode_chunks(arrays[name], tuple(map(slice, coordinate.values.shape)), coordinate.values)
    handle.backend.put_all(objects)
    yield "coordinates written again"


def _drop_groups(findings: VerifyFindings, names: Names) -> Iterator[str]:
    handle = findings.handle
    for (group,) in names:
        if group == OVERVIEWS:
            drop_overviews(handle)
        else:
            drop_group(handle, group)
            handle.backend.remove_all(list(handle.backend.list_keys(f"{group}/")))
        command = f"{REBUILD_COMMANDS[group]} {handle.backend}" if group in REBUILD_COMMANDS else "the next run"
        yield f"{group} dropped: {command} makes them anew"


def _drop_parts(findings: VerifyFindings, names: Names) -> Iterator[str]:
    place = findings.handle.backend
    for (key,) in names:
        place.remove(key)
        yield f"{key} dropped: {REBUILD_COMMANDS[key.split('/')[1]]} {place} finds it again"


def _mend_copies(findings: VerifyFindings, names: Names) -> Iterator[str]:
    """Write metadata of groups again, from their copies."""
    copies = copy_faults(findings.handle)
    for (key,) in names:
        if key in copies:
            findings.handle.backend.put(key, json.dumps(without_consolidated(copies[key])).encode())
        yield f"{key} written again, as its copy has it"


def _mend_members(findings: VerifyFindings, names: Names) -> Iterator[str]:
    """Write the copies of the metadata of sound tables again."""
    handle = findings.handle
    for (group,) in names:
        copy_members(handle.backend, group, (group_attributes(handle, group) or {})[ARRAYS])
        yield f"the copies of the metadata of {group} written again"


def _mend_machines(findings: VerifyFindings, names: Names) -> Iterator[str]:
    handle = findings.handle
    for (key,) in names:
        if read_host(handle.backend, key) is None:
            whole = mend_record(handle, key)
            yield f"{key} written again" if whole else f"{key} replaced by the record of an unknown host"


def _write_records(findings: VerifyFindings, _: Names) -> Iterator[str]:
    """Write the tile records of sound tiles from their cells, as one compaction."""
    grid = findings.handle.tiling.grid
    rows, settled = np.zeros((*grid, WIDTH)), np.zeros(grid, dtype=bool)
    for index, row in findings.rows.items():
        rows[index], settled[index] = row, True
    write_compaction(findings.handle, rows, settled)
    yield f"records of {plural(len(findings.rows), 'tile')} written again"


MENDERS: dict[str, Callable[[VerifyFindings, Names], Iterator[str]]] = {
    SPARE: _mend_spare,
    COORDINATES: _mend_coordinates,
    GROUP: _drop_groups,
    PART: _drop_parts,
    COPY: _mend_copies,
    COPIES: _mend_members,
    MACHINE: _mend_machines,
    RECORDS: _write_records,
}
"""The function that drops or restores the faulty parts of a kind, in this order, and yields lines for the user."""
