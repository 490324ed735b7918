"""A digest of every tile, of its place and all that is in it, so that no exchange of chunks goes unnoticed.

They lie in an array of one number a tile, ``tiles/digest``. Stores made before there were digests have none.
"""

import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.store.schema import BUDGET
from workers.results import REGIME, Variable, result_variables

if TYPE_CHECKING:
    from atlas.spec.spec import Spec

GROUP = "tiles"
PATH = f"{GROUP}/digest"


def digest_of(spec: "Spec", index: tuple[int, ...], arrays: Mapping[str, Any]) -> int:
    """The digest of a tile, 64 bits, of all results and budgets that ``arrays`` has."""
    found = hashlib.blake2b(repr(tuple(map(int, index))).encode(), digest_size=8)
    for variable in (*result_variables(spec.settings), BUDGET):
        if variable.name in arrays:
            found.update(variable.name.encode())
            found.update(_bytes(variable, arrays[variable.name]))
    return int.from_bytes(found.digest(), "little")


def _bytes(variable: Variable, values: Any) -> bytes:
    return np.asarray(values, dtype=np.dtype(variable.dtype).newbyteorder("<")).tobytes()


def create_digests(root: Any, spec: "Spec", grid: tuple[int, ...], codecs: list[Any]) -> None:
    """Make room for the digests of a new store."""
    described = {"long_name": "digest of the place and the contents of each tile", "units": "1"}
    root.create_group(GROUP).create_array(
        "digest",
        shape=grid,
        chunks=(1,) * len(grid),
        dtype="uint64",
        fill_value=0,
        dimension_names=tuple(f"tile_{dim}" for dim in spec.dims),
        compressors=codecs,
        attributes=described,
    )


def write_digest(root: Any, spec: "Spec", index: tuple[int, ...], arrays: Mapping[str, Any]) -> None:
    """Note the digest of a tile whose arrays are being written; nothing in a store that has no room for it."""
    if PATH not in root:
        return
    if BUDGET.name not in arrays:
        budget = np.full(arrays[REGIME.name].shape, spec.settings.max_periods)
        arrays = {**arrays, BUDGET.name: budget}
    root[PATH].with_config({"write_empty_chunks": True})[index] = digest_of(spec, index, arrays)
