"""All waiting times of the service, in one record for runs, observers and commands."""

from dataclasses import dataclass

from atlas.errors import InputError, brief_repr
from atlas.formatting import short_repr


@dataclass(frozen=True)
class Timing:
    """Waiting times in seconds, each positive or 0; the defaults suit a cluster on a network.

    connect             time for a scheduler to answer
    replacement_worker  time for a scheduler to get a worker after all others refused
    tick                interval of looking at the cluster and the lease while tiles are solved
    poll                interval of looking whether a cluster has its first worker, or can be reached
    heartbeat           interval of the renewals of a lease
    lease_poll          interval of looking at the lease of another run
    warn_after          time without renewal after which a lease is reported: one may be late, two rarely are
    stall_after         time without a finished tile after which a run gives the reason, if known
    hung                time after which a worker that finishes no job may hang, if it is also many times the median
                        duration of a job
    expire_after        time without renewal after which a lease has expired: ten intervals, for a busy network disk
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
                raise InputError(f"timing: {name}: found {brief_repr(seconds)}, must be 0 s or more")


TIMING = Timing()
"""The default waiting times."""
