"""All waiting times of the service, in one record for runs, watchers and commands."""

from dataclasses import dataclass

from atlas.errors import InputError, brief_repr
from atlas.formatting import short_repr


@dataclass(frozen=True)
class Timing:
    """Seconds, each positive or 0; the defaults suit a cluster on a network.

    connect   for a scheduler to answer
    worker    for a scheduler to get a worker after all others refused
    tick      between two looks at the cluster and the claim while tiles are solved
    poll      between two looks at a coordinator that is to begin
    beat      between two steps of a claim's counter
    look      between two looks at the claim of another run
    silent    after which a counter that stands still is reported: one beat may be late, two rarely are
    stalled   after which a run without a finished tile gives the reason, if known
    hung      after which a worker that ends no job may hang, if it is also many times the longest job so far
    dead      after which the holder of a still counter counts as dead: ten beats, for a busy network disk
    """

    connect: float = 5.0
    replacement_worker: float = 30.0
    tick: float = 1.0
    poll: float = 0.5
    heartbeat: float = 2.0
    lease_poll: float = 0.2
    warn_after: float = 5.0
    stall_after: float = 30.0
    hung: float = 60.0
    expire_after: float = 20.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name, seconds in vars(self).items():
            if not seconds >= 0:
                raise InputError(f"timing: {name} is {brief_repr(seconds)}, must be 0 s or more")


TIMING = Timing()
"""The defaults."""
