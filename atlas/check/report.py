"""The report of a verification, as a value, as text and as JSON."""

from dataclasses import asdict, dataclass
from typing import Any

from atlas.errors import REPACK_HINT
from atlas.formatting import PrintableResult, plural
from atlas.store.tiling import Index

MAX_FAULTS_SHOWN = 50
"""Maximum number of faults that a terminal shows; ``--json`` lists all."""

METADATA, CHUNK, GROUP, PART, FOREIGN, MACHINE = "metadata", "chunk", "group", "part", "foreign", "machine"
"""Kinds of faulty objects other than tiles, by which a repair chooses what to do, see ``repair.MENDERS``.

Other kinds have the name of their folder or object.
"""


@dataclass(frozen=True)
class StoreFault:
    """A fault of a store.

    tile  index of the faulty tile; None for the store as a whole
    what  line of text that describes the fault
    part  kind and name of the faulty object that a repair drops or writes again; empty for a tile
    """

    tile: Index | None
    what: str
    part: tuple[Any, ...] = ()

    def __str__(self) -> str:
        return self.what if self.tile is None else f"tile {self.tile}: {self.what}"


@dataclass(frozen=True, repr=False)
class VerifyReport(PrintableResult):
    """The findings of a verification.

    store              path or URL of the store
    tiles, tiles_done  numbers of tiles: all, and finished ones
    chunks             number of chunks of finished tiles that were read whole, with correct checksums
    cells_checked      number of cells checked against the rules
    cells_solved       number of cells of the sample that were solved again
    comparison         "bits", "error", or the reason why no cell was compared
    seed               seed by which the sample was drawn
    faults             proved faults: damage, contradictions, cells whose results differ on the same host
    doubts             cells whose results differ, beyond their errors, on another kind of host
    overview_chunks    number of chunks of overviews read whole, and compared with the cells below them
    repaired           tiles that became unfinished, so that the next run solves them again; None without repair
    dropped            number of faulty chunks of overviews that were removed
    removed            keys of removed objects: objects that are no chunks, and leftovers
    restored           other repairs, one line each
    leftovers          files of killed writes, which nothing reads: no faults, but a repair removes them
    """

    store: str
    tiles: int
    tiles_done: int
    chunks: int
    cells_checked: int
    cells_solved: int
    comparison: str
    seed: int
    faults: tuple[StoreFault, ...]
    doubts: tuple[StoreFault, ...]
    overview_chunks: int = 0
    repaired: tuple[Index, ...] | None = None
    dropped: int = 0
    removed: tuple[str, ...] = ()
    restored: tuple[str, ...] = ()
    leftovers: tuple[str, ...] = ()

    @property
    def is_complete(self) -> bool:
        """True if every tile is finished."""
        return self.tiles_done == self.tiles

    @property
    def is_sound(self) -> bool:
        """True if the store is complete, and no fault and no doubtful cell was found."""
        return self.is_complete and not self.faults and not self.doubts

    @property
    def remedy(self) -> str:
        """Text about what to do about the faults."""
        if self.store.lower().endswith(".zip"):
            return REPACK_HINT
        solves = any(fault.tile is not None for fault in self.faults)
        return f"atlas verify --repair {self.store}" + ", then run it again" * solves

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The numbers of checked objects by name, then the faults and repairs, as rows of text."""
        how = {"bits": "all to the bit", "error": "within error (solved on another kind of host)"}
        sample = f"not solved again: {self.comparison}"
        if self.comparison in how:
            sample = f"{plural(self.cells_solved, 'cell')} solved again, compared {how[self.comparison]}"
        counts: list[tuple[str, ...]] = [
            ("tiles", f"{self.tiles_done} of {self.tiles} done" + "; atlas run completes it" * (not self.is_complete)),
            ("chunks", f"{self.chunks} read, checksums correct"),
            ("levels", f"{plural(self.overview_chunks, 'chunk')} of overviews compared with the cells below"),
            ("cells", f"{self.cells_checked} checked against the rules"),
            ("sample", sample),
        ]
        if self.leftovers and self.repaired is None:
            rest = f"{plural(len(self.leftovers), 'file')} of killed writes, which nothing reads: --repair removes them"
            counts.append(("left", rest))
        return [*counts, *((line,) for line in self.findings)]

    @property
    def findings(self) -> list[str]:
        """Lines of text about the faults and the repairs, with the verdict at the end."""
        lines = []
        for title, faults in (("found", self.faults), ("in doubt", self.doubts)):
            lines += [f"{title}: {fault}" for fault in faults[:MAX_FAULTS_SHOWN]]
            lines += (
                [f"and {len(faults) - MAX_FAULTS_SHOWN} more {title}: --json lists them"]
                if len(faults) > MAX_FAULTS_SHOWN
                else []
            )
        if self.faults and self.repaired is None:
            lines.append(f"remedy: {self.remedy}")
        if self.repaired is not None:
            dropped = f"{plural(len(self.repaired), 'tile')} dropped: run it again to solve them"
            lines.append(dropped if self.repaired else "no tile to drop")
            if self.dropped:
                lines.append(f"{plural(self.dropped, 'chunk')} of overviews dropped: the next run makes them again")
            lines += [f"removed: {key}" for key in self.removed]
            lines += self.restored
        bad = bool(self.faults or self.doubts)
        lines.append("fine" if self.is_sound else "not fine" if bad else "nothing wrong, but not complete")
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas verify --json`` prints."""
        facts = {"store": self.store, "sound": self.is_sound, "complete": self.is_complete} | asdict(self)
        faults, doubts = ([{"tile": f.tile, "what": f.what} for f in group] for group in (self.faults, self.doubts))
        return facts | {"faults": faults, "doubts": doubts}
