"""A Zarr store for reading that raises ChunkError, with the chunk's key, for every missing or damaged chunk.

Zarr alone reads a missing chunk as fill values and does not name a chunk with a wrong checksum. Here chunks of finished
tiles and current overviews must exist, and each checksum is compared when its chunk is read. Metadata and coordinates
of the root are not read, since they follow from the spec.
"""

import asyncio
import atexit
import errno
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import google_crc32c
import numpy as np
from zarr.abc.store import SuffixByteRequest

from atlas.errors import ChunkError
from atlas.overview.coarsen import REGIME_SHOWN, level_variables
from atlas.store.backend import StoreBackend
from atlas.store.origin import ALLOWANCES
from atlas.store.schema import OVERVIEWS, TABLES
from atlas.store.store import AtlasStore
from atlas.store.zarr_store import BackendStore
from workers.results import REGIME

_CHECKSUM_BYTES = 4
_FRAME = b"\x28\xb5\x2f\xfd"
"""First four bytes of data compressed by Zstandard."""
_PATIENCE_SECONDS = 10.0
_asked: ContextVar[set[tuple[StoreBackend, str]] | None] = ContextVar("asked", default=None)
"""Arrays from which chunks were requested within ``skip_chunk_reads``.

Zarr's own thread works in the context of the caller, so it sees the same set.
"""


class VerifyingStore(BackendStore):
    """A Zarr store for reading an atlas. ``get`` raises ChunkError for a missing or damaged chunk.

    ``chunks_read`` counts the chunks read.
    """

    def __init__(self, handle: AtlasStore) -> None:
        super().__init__(handle.backend)
        levels = level_variables(handle.variables)
        self.chunks_read = 0
        self._dims, self._end = len(handle.spec.shape), "/0" * len(handle.regime.extra_dims)
        self._complete = {variable.name for variable in (*handle.variables, *levels) if not variable.sparse}
        self._handle = handle
        self._parts = {name: parts_of(node) for name, node in handle.nodes.items()}
        self._sizes = {name: chunk_bytes(node) for name, node in handle.nodes.items()}
        self._checked = {variable.name for variable in (*handle.variables, *ALLOWANCES)}

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return the bytes of an object; None if it does not exist and need not exist.

        Raise ChunkError if it is a chunk that is missing or damaged.
        """
        if key in self._handle.layout:
            return prototype.buffer.from_bytes(self._handle.layout[key])
        folder, mark, index = f"/{key}".rpartition("/c")
        if not mark or index[:1] not in ("", "/"):
            return await super().get(key, prototype, byte_range)
        array, requested = folder[1:], _asked.get()
        if requested is not None:
            requested.add((self.backend, array))
            return None
        try:
            data = await super().get(key, prototype, byte_range)
            if data is None and await self._must_exist(array, index):
                # Read again: the chunk, and the regime, which comes last, may have been written in the meantime.
                data = await super().get(key, prototype, byte_range)
                if data is None:
                    raise self._error(key, "is missing")
        except OSError as error:
            if error.errno != errno.EIO:  # a bad sector is the chunk's fault, a lost network is not
                raise
            raise self._error(key, f"cannot be read ({error.strerror})") from None
        if data is None:
            return None
        self.chunks_read += not isinstance(byte_range, SuffixByteRequest)  # the index of a shard
        parts = self._parts.get(array, 0) if byte_range is None else 0
        is_intact = _is_whole_shard(data.to_bytes(), parts) if parts else _is_whole(data.to_bytes())
        size, must = unpacked_size(data.to_bytes()), self._sizes.get(array, 0)
        if is_intact and not parts and byte_range is None and None is not size != must > 0:  # a chunk of another array
            raise self._error(key, f"is damaged (it unpacks to {size} bytes, must be {must})")
        above, _, name = array.rpartition("/")
        names = self._complete if above.partition("/")[0] == OVERVIEWS else self._checked
        if (above in TABLES or name in names) and not is_intact:
            raise self._error(key, "is damaged (its checksum is wrong)")
        return data

    async def _must_exist(self, array: str, index: str) -> bool:
        """Return True if a chunk must exist, since the object that is written after it exists.

        array  path of the array
        index  end of the chunk's key, its indices
        """
        above, _, name = array.rpartition("/")
        if above in TABLES:  # single chunks, all of which exist
            return True
        if name not in self._complete or name == REGIME.name:
            return False
        marks = (REGIME.name, REGIME_SHOWN.name) if above else (REGIME.name,)
        chunk_index = "/".join(index.split("/")[: self._dims + 1])
        end = "" if above else self._end
        keys = [f"{above}/{mark}/c{chunk_index}{end}".lstrip("/") for mark in marks if mark != name]
        return any([await self.exists(key) for key in keys])

    def _error(self, key: str, fault: str) -> ChunkError:
        _loops.add(asyncio.get_running_loop())
        return ChunkError(self.backend, {key: fault})


@contextmanager
def skip_chunk_reads() -> Iterator[set[tuple[StoreBackend, str]]]:
    """Let no chunk be read within the block, as if none existed.

    Yield a set that collects the arrays from which chunks are requested, by backend and path.
    """
    requested: set[tuple[StoreBackend, str]] = set()
    token = _asked.set(requested)
    try:
        yield requested
    finally:
        _asked.reset(token)


def _is_whole(data: bytes) -> bool:
    """Return True if the last four bytes of a chunk are the checksum, CRC32C, of the bytes before."""
    inner, checksum = data[:-_CHECKSUM_BYTES], data[-_CHECKSUM_BYTES:]
    return len(checksum) == _CHECKSUM_BYTES and google_crc32c.value(inner) == int.from_bytes(checksum, "little")


def parts_of(metadata: Mapping[str, Any]) -> int:
    """Return the number of chunks in each object (shard) of an array, from the array's metadata; 0 without shards."""
    codec: Mapping[str, Any] = next(iter(metadata.get("codecs", ())), {})
    if codec.get("name") != "sharding_indexed":
        return 0
    inner, shard_shape = codec["configuration"]["chunk_shape"], metadata["chunk_grid"]["configuration"]["chunk_shape"]
    return math.prod(n // k for n, k in zip(shard_shape, inner, strict=True))


def chunk_bytes(metadata: Mapping[str, Any]) -> int:
    """Return the size, in bytes, of an array's uncompressed chunks, from its metadata; 0 if sizes vary, or with
    shards.
    """
    try:
        size = np.dtype(metadata["data_type"]).itemsize
        return 0 if parts_of(metadata) else size * math.prod(metadata["chunk_grid"]["configuration"]["chunk_shape"])
    except (KeyError, TypeError):
        return 0


def unpacked_size(data: bytes) -> int | None:
    """Return the uncompressed size that data compressed by Zstandard state (RFC 8878, 3.1.1.1); None for other data."""
    if data[:4] != _FRAME or len(data) < 5:
        return None
    single, dictionary, field = data[4] >> 5 & 1, (0, 1, 2, 4)[data[4] & 3], (0, 2, 4, 8)[data[4] >> 6]
    field, begin = field or single, 6 - single + dictionary
    if not field or len(data) < begin + field:
        return None
    return int.from_bytes(data[begin : begin + field], "little") + (256 if field == 2 else 0)


def _is_whole_shard(data: bytes, parts: int) -> bool:
    """Return True if all ``parts`` chunks in a shard, and the index at its end, have correct checksums."""
    size = 16 * parts + _CHECKSUM_BYTES
    index, absent = data[-size:], 2**64 - 1
    if len(index) != size or not _is_whole(index):
        return False
    places = np.frombuffer(index[:-_CHECKSUM_BYTES], dtype="<u8").reshape(parts, 2).tolist()
    return all(_is_whole(data[begin : begin + length]) for begin, length in places if begin != absent)


def abandon_reads() -> None:
    """Cancel the pending reads after a failed read, before the process exits.

    At exit Zarr closes its event loop with everything pending, and Python reports each pending read on stderr.
    """

    async def cancel() -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        if others:
            await asyncio.wait(others, timeout=_PATIENCE_SECONDS)

    for loop in list(_loops):
        if loop.is_running():
            asyncio.run_coroutine_threadsafe(cancel(), loop).result()


_loops: set[asyncio.AbstractEventLoop] = set()
"""Event loops of Zarr in which a read failed; Zarr has one."""
atexit.register(abandon_reads)  # registered after Zarr's own function (imported above), so called before it
