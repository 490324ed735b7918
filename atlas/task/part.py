"""Jobs whose results are parts of a store: which store that is, and how a worker reads it and keeps a part."""

from collections.abc import Sequence
from dataclasses import dataclass

from atlas.store.location import Place
from atlas.store.outage import LONG
from atlas.store.parts import get_part, put_part
from atlas.store.store import Header
from atlas.task.compile import compile_once
from atlas.task.task import RefusedError, checked_header, file_errors, guarded


@dataclass(frozen=True)
class Site:
    """The store that the jobs of a run work on, as it crosses the scheduler.

    ``claim`` is the token of the run's claim of the store: once that is lost, nothing is kept. A job done by hand has
    none. ``patience`` is how many seconds to wait for a store at a URL that does not answer.
    """

    store: str | Place
    run_id: str
    solver_version: int
    patience: float = LONG
    claim: str = ""

    def header(self) -> Header:
        """The header of the store, see ``checked_header``, behind the fence of the run's claim."""
        with file_errors(self.store):
            header = checked_header(self.store, self.run_id, self.solver_version, self.patience)
            _ = header.spec  # read once for all jobs
            return header.at(guarded(header.place, self.claim))

    def keep(self, header: Header, group: str, name: str, data: bytes) -> None:
        """Keep a part of a group."""
        with file_errors(self.store):
            put_part(header, group, name, data)


def prepare(site: Site, kernels: Sequence[str]) -> None:
    """Check what any job needs of this worker, and see to it that its kernels are compiled."""
    site.header()
    compile_once(*kernels)


def stored_part(header: Header, group: str, name: str) -> bytes:
    """A part that a job has kept; RefusedError if there is none."""
    data = get_part(header, group, name)
    if data is None:
        raise RefusedError(f"{header.place}: has no part {name}; is the path the same on all hosts?")
    return data
