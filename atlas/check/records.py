"""Checks of tile records against the cells of their tiles."""

from collections.abc import Mapping

import numpy as np

from atlas.store.record_format import BY_REASON, CELLS, DIGEST, RECORDS, Index, Rows, record_key
from atlas.store.store import AtlasStore
from atlas.store.tile_records import EXCHANGED, TileRecords, is_exchanged
from workers.results import REASON


def record_faults(handle: AtlasStore, records: TileRecords, counted: Mapping[Index, Rows]) -> list[str]:
    """Return the faults of a store's tile records; ``counted`` has the correct row of every finished tile."""
    faults = [f"{RECORDS} {records.damaged[RECORDS]}"] if RECORDS in records.damaged else []
    counts = slice(CELLS.start, None if REASON in handle.variables else BY_REASON.start)
    wrong = [
        index
        for index, row in counted.items()
        if records.known_mask[index] and not np.allclose(records.rows[index][counts], row[counts], rtol=1e-9, atol=0)
    ]
    return faults + [f"the record of tile {index} contradicts its cells" for index in wrong]


def tile_faults(records: TileRecords, index: Index, row: Rows) -> list[str]:
    """Return the faults of a finished tile's record; ``row`` is the correct record, from the cells of the tile."""
    key = record_key(index)
    if key in records.damaged:
        return [f"{key} {records.damaged[key]}"]
    if records.rows[index][DIGEST].any():
        return [EXCHANGED] if is_exchanged(records, index, row) else []
    lost = RECORDS not in records.damaged and index not in records.single
    return [f"{key} is missing"] if lost else []
