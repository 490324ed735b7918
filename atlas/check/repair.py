"""Dropping faulty objects from a store, so that the next run, search or explorer makes them again.

What no run makes is written again: metadata, coordinates and records of tiles, which the spec and the cells decide.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from atlas.check.find import Findings, Index
from atlas.check.groups import mend_groups
from atlas.check.metadata import restore_coordinates
from atlas.check.overviews import drop_unsound
from atlas.check.report import Report
from atlas.check.zoom import drop_zoom
from atlas.overview.pyramid import Pyramid
from atlas.store.place import Place
from atlas.store.record import WIDTH, Rows
from atlas.store.records import write_compaction
from atlas.store.spare import SPARE, copy_metadata, mend_by_spare, packed_spare, read_spare, spare_faults
from atlas.store.store import ROOT, ZOOM, Atlas
from atlas.store.tiles import drop_tile
from atlas.text import plural


def repair(found: Findings, again: Callable[[], Findings]) -> Report:
    """Drop the faulty objects of a claimed store; without a fault nothing is written.

    Where the metadata were, they are written again and the store is read ``again``: no cell was read through them.
    """
    if not found.unread:
        return _dropped(found)
    written = _write_metadata(found.handle.place)
    told, found = found.report.faults, again()
    if found.unread:
        return replace(found.report, faults=tuple(dict.fromkeys((*told, *found.report.faults))), repaired=())
    report = _dropped(found)
    return replace(report, faults=(*told, *report.faults), mended=(*written, *report.mended))


def _write_metadata(place: Place) -> list[str]:
    """Write metadata as their spare has them, else the root's copies as the arrays have them; a line for each."""
    spare = read_spare(place)
    if spare is not None and (lost := spare_faults(place, spare)):
        mend_by_spare(place, spare, lost)
        return [f"{key} written again" for key in lost]
    copy_metadata(place, json.loads(place.get(ROOT) or b"{}"))
    return [f"{ROOT}: its consolidated metadata written again"]


def _dropped(found: Findings) -> Report:
    """The report after the faulty parts were dropped, overviews before the tiles that they are of."""
    handle, report = found.handle, found.report
    mended = list[str]()
    if found.spareless:
        handle.place.put(SPARE, packed_spare(handle.place.get(ROOT) or b""))
        mended.append(f"{SPARE} written again")
    if found.worn:
        restore_coordinates(handle)
    if found.overviews is not None:
        drop_unsound(handle, found.overviews)
    if found.tiles:
        Pyramid(handle).drop(found.tiles)
    for index in found.tiles:
        drop_tile(handle, index)
    for key in found.foreign:
        handle.place.remove(key)
    if found.groups is not None:
        mended += mend_groups(handle, found.groups)
    if found.records is not None:
        mended += _records_written(handle, found.records)
    if found.zoom:
        drop_zoom(handle, found.zoom)
        mended += [f"{ZOOM}/{ROOT} written again"] * (() in found.zoom)
    if folders := {*found.zoom} - {()}:
        mended.append(f"{ZOOM}: {plural(len(folders), 'folder')} dropped: the explorer solves them again")
    dropped = 0 if found.overviews is None else len(found.overviews.unsound)
    return replace(report, repaired=found.tiles, dropped=dropped, removed=found.foreign, mended=tuple(mended))


def _records_written(handle: Atlas, sound: Mapping[Index, Rows]) -> Iterator[str]:
    """Write the records of sound tiles by their cells, all together; a line about it."""
    rows, settled = np.zeros((*handle.tiling.grid, WIDTH)), np.zeros(handle.tiling.grid, dtype=bool)
    for index, row in sound.items():
        rows[index], settled[index] = row, True
    write_compaction(handle, rows, settled)
    yield f"records of {plural(len(sound), 'tile')} collected"
