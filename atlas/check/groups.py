"""Checks of the groups beside cells and overviews: tables, curves, records of hosts."""

import json
from collections.abc import Iterator

from atlas.check.metadata import copy_faults
from atlas.check.report import COPIES, COPY, GROUP, MACHINE, PART, StoreFault
from atlas.errors import REBUILD_COMMANDS, ChunkError
from atlas.store.groups import groups_of, read_group
from atlas.store.host_records import host_keys, read_host
from atlas.store.metadata_backup import form_fault, without_consolidated
from atlas.store.parts import damaged_parts
from atlas.store.schema import OVERVIEWS
from atlas.store.store import ROOT, AtlasStore


def check_groups(handle: AtlasStore) -> Iterator[StoreFault]:
    """Yield the faults of all groups, which are read, and of metadata that differ from their copies."""
    tables = groups_of(handle)
    faulty = {group: texts for group in tables if (texts := _group_faults(handle, group))}
    for group, texts in faulty.items():
        for text in texts:
            yield StoreFault(None, f"{text}{_remedy(handle, group)}", (GROUP, group))
    for key in copy_faults(handle):
        group = key.partition("/")[0]
        if group in tables and group not in faulty:  # its checksum is correct
            yield StoreFault(None, f"{key} differs from its copy, which is damaged", (COPIES, group))
            continue
        part = (GROUP, group) if group in (*tables, OVERVIEWS) else (COPY, key)
        yield StoreFault(None, f"{key} is damaged, or its copy is{_remedy(handle, group)}", part)
    for key in (key for group in tables for key in damaged_parts(handle, group)):
        yield StoreFault(None, f"{key} is damaged", (PART, key))
    for key in host_keys(handle):
        if read_host(handle.backend, key) is None:
            yield StoreFault(None, f"{key} is damaged", (MACHINE, key))


def _group_faults(handle: AtlasStore, group: str) -> list[str]:
    try:
        # Arrays without the metadata of their group: the metadata are lost, or the writer was killed.
        lost = read_group(handle, group) is None and any(handle.backend.list_keys(f"{group}/"))
    except ChunkError as error:
        return error.lines
    if lost:
        return [f"{group}/{ROOT} is missing"]
    metadata = handle.backend.get(f"{group}/{ROOT}")
    fault = metadata is not None and form_fault(
        without_consolidated(json.loads(metadata))
    )  # its copies: see copy_faults
    return [f"{group}/{ROOT} {fault}"] if fault else []


def _remedy(handle: AtlasStore, group: str) -> str:
    return f" ({REBUILD_COMMANDS[group]} {handle.backend} makes it anew)" if group in REBUILD_COMMANDS else ""
