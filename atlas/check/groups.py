"""Checks of the groups beside cells and overviews: tables, curves, records of machines, zoom levels."""

from dataclasses import dataclass

from atlas.check.metadata import copy_faults, restore
from atlas.errors import MADE_BY, ChunkError
from atlas.overview.pyramid import drop_all
from atlas.store.groups import drop_group, groups_of, read_group
from atlas.store.machine import UNKNOWN
from atlas.store.machines import machine_keys, record_machine, recorded_machine
from atlas.store.parts import damaged_parts
from atlas.store.schema import OVERVIEWS
from atlas.store.store import ROOT, Atlas


@dataclass(frozen=True)
class GroupReport:
    """The faults of a store's groups: faults, each in a line; the groups and objects that they are in.

    copies   keys of metadata of other groups that are not as the root's copy has them
    """

    faults: tuple[str, ...]
    groups: tuple[str, ...]
    parts: tuple[str, ...]
    machines: tuple[str, ...]
    copies: tuple[str, ...]


def check_groups(handle: Atlas) -> GroupReport:
    """Read all groups."""
    found: dict[str, list[str]] = {}
    for group in groups_of(handle):
        try:
            # Arrays without the metadata of their group: these are lost, or whoever wrote them was killed.
            if read_group(handle, group) is None and any(handle.place.list_keys(f"{group}/")):
                found[group] = [f"{group}/{ROOT} is missing"]
        except ChunkError as error:
            found[group] = [f"{key} {fault}" for key, fault in error.faults.items()]
    copies = copy_faults(handle)
    for key in copies:
        found.setdefault(key.partition("/")[0], []).append(f"{key} is damaged, or its copy is")
    parts = [key for group in groups_of(handle) for key in damaged_parts(handle, group)]
    machines = [key for key in machine_keys(handle) if recorded_machine(handle.place, key) is None]
    faults = [f"{fault}{_remedy(handle, group)}" for group, several in found.items() for fault in several]
    faults += [f"{key} is damaged" for key in (*parts, *machines)]
    groups = tuple(group for group in found if group in (*groups_of(handle), OVERVIEWS))
    others = tuple(key for key in copies if key.partition("/")[0] not in groups)
    return GroupReport(tuple(faults), groups, tuple(parts), tuple(machines), others)


def mend_groups(handle: Atlas, report: GroupReport) -> list[str]:
    """Drop damaged groups and restore the rest; returns each action as a line."""
    done = []
    for group in report.groups:
        if group == OVERVIEWS:
            drop_all(handle)
        else:
            drop_group(handle, group)
            handle.place.remove_all(list(handle.place.list_keys(f"{group}/")))
        command = f"{MADE_BY[group]} {handle.place}" if group in MADE_BY else "the next run"
        done.append(f"{group} dropped: {command} makes them anew")
    for key in report.parts:
        handle.place.remove(key)
        done.append(f"{key} dropped: {MADE_BY[key.split('/')[1]]} {handle.place} finds it again")
    copies = copy_faults(handle) if report.copies else {}
    restore(handle, {key: copies[key] for key in report.copies if key in copies})
    done += [f"{key} written again, as its copy has it" for key in report.copies]
    for key in report.machines:
        if recorded_machine(handle.place, key) is None:
            record_machine(handle, UNKNOWN)  # that there was one still counts
            handle.place.remove(key)
            done.append(f"{key} replaced by the record of an unknown machine")
    return done


def _remedy(handle: Atlas, group: str) -> str:
    return f" ({MADE_BY[group]} {handle.place} makes it anew)" if group in MADE_BY else ""
