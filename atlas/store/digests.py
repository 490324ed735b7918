"""A digest of every tile, of its place and all that is in it, so that no exchange of chunks goes unnoticed.

They lie in an array of one number a tile, ``tiles/digest``, which lists the variables that they cover. Stores made
before there were digests have none.
"""

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from workers.results import Variable

TILES = "tiles"
DIGESTS = f"{TILES}/digest"
COVERED = "variables"
"""The attribute with the names of the variables covered, in the order in which they enter a digest."""


def digest_of(index: tuple[int, ...], variables: Iterable[Variable], arrays: Mapping[str, Any]) -> int:
    """The digest of a tile, 64 bits, of these variables."""
    found = hashlib.blake2b(repr(tuple(map(int, index))).encode(), digest_size=8)
    for variable in variables:
        dtype = np.dtype(variable.dtype).newbyteorder("<")
        found.update(variable.name.encode())
        found.update(np.asarray(arrays[variable.name], dtype=dtype).tobytes())
    return int.from_bytes(found.digest(), "little")


def create_digests(
    root: Any, variables: Iterable[Variable], dims: tuple[str, ...], grid: tuple[int, ...], codecs: list[Any]
) -> None:
    """Make room for the digests of a new store."""
    described = {"long_name": "digest of the place and the contents of each tile", "units": "1"}
    root.create_group(TILES).create_array(
        "digest",
        shape=grid,
        chunks=(1,) * len(grid),
        dtype="uint64",
        fill_value=0,
        dimension_names=tuple(f"tile_{dim}" for dim in dims),
        compressors=codecs,
        attributes={**described, COVERED: [variable.name for variable in variables]},
    )
