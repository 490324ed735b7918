"""Check the records of tiles, their stored digests and counts, against the cells of the tiles."""

from collections.abc import Mapping

import numpy as np

from atlas.formatting import plural
from atlas.store.record_format import BY_REASON, CELLS, RECORDS, Index, Rows
from atlas.store.store import AtlasStore
from atlas.store.tile_records import TileRecords
from workers.results import REASON


def record_faults(handle: AtlasStore, records: TileRecords, counted: Mapping[Index, Rows]) -> list[str]:
    """Return texts about the faults of a store's tile records.

    ``counted`` has the correct record of every finished tile, from its cells. Missing records are a fault of a complete
    store only: a run that was killed may have left finished tiles without a record.
    """
    faults = [f"{key} {damage}" for key, damage in records.damaged.items()]
    missing = int((records.finished_mask & ~records.known_mask).sum())
    if missing and records.finished_mask.all() and not faults:
        faults.append(f"{RECORDS}: the records of {plural(missing, 'tile')} are missing")
    counts = slice(CELLS.start, None if REASON in handle.variables else BY_REASON.start)
    rows = records.columns()
    wrong = [
        index
        for index, row in counted.items()
        if records.known_mask[index] and not np.allclose(rows[index][counts], row[counts], rtol=1e-9, atol=0)
    ]
    return faults + [f"the record of tile {index} contradicts its cells" for index in wrong]
