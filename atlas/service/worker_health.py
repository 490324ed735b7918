"""Exclusion of workers from a run, decided by the outcomes of their attempts.

A worker refuses if it cannot do the jobs. If an attempt fails, the worker or the job may be at fault. A failure counts
against the worker until the job also fails on a worker that has succeeded. After MAX_FAILURES such failures in a row
the worker is excluded, and its failures do not count against the jobs.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

Index = tuple[int, ...]

MAX_FAILURES = 3
"""Number of failures that count against a worker, without a success between them, after which it is excluded."""
MAX_FAILED_JOBS = 16
"""Number of jobs that failed at every attempt, without a success, after which a run without a fit worker ends."""


@dataclass(frozen=True)
class WorkerRefusal:
    """A worker's declaration that it cannot do the jobs of a run.

    worker     address of the worker
    reason     reason for the refusal
    temporary  True if the store may respond to the worker later
    """

    worker: str
    reason: str
    temporary: bool = False


@dataclass(frozen=True)
class AttemptFailure:
    """The exception of a failed attempt.

    worker      address of the worker; empty if unknown
    reason      type and message of the exception
    store_full  True if the store is full
    traceback   traceback on the worker
    """

    worker: str
    reason: str
    store_full: bool = False
    traceback: str = ""


class WorkerHealth:
    """The record of successes and failures by which workers are excluded from a run."""

    def __init__(self) -> None:
        self.refused: dict[str, str] = {}
        self._away: set[str] = set()
        self._proven: set[str] = set()
        self._failing: dict[str, dict[Index, str]] = {}
        self._failed: set[Index] = set()

    def record_refusal(self, refusal: WorkerRefusal) -> None:
        """Record that a worker has refused a job, and exclude it."""
        self.refused[refusal.worker] = refusal.reason
        if refusal.temporary:
            self._away.add(refusal.worker)

    def readmit(self, worker: str) -> None:
        """Readmit a worker that refused."""
        self.refused.pop(worker, None)

    def finish(self, worker: str) -> None:
        """Record that a worker has done a job."""
        self._proven.add(worker)
        self._failing.pop(worker, None)
        for waiting in self._away:  # the store responds to this worker, so perhaps to the others too
            self.refused.pop(waiting, None)
        self._away.clear()

    def fail(self, index: Index, failure: AttemptFailure, before: Iterable[AttemptFailure]) -> None:
        """Record that a job has failed; ``before`` are its earlier failures."""
        self._failed.add(index)
        others = {earlier.worker for earlier in before} - {failure.worker}
        if others and failure.worker in self._proven:
            for worker in others:
                self._failing.get(worker, {}).pop(index, None)
        elif failure.worker:
            self._failing.setdefault(failure.worker, {})[index] = failure.reason

    @property
    def excluded(self) -> Mapping[str, str]:
        """The reasons for exclusion, by address of the excluded worker."""
        unfit = {worker: jobs for worker, jobs in self._failing.items() if len(jobs) >= MAX_FAILURES}
        return {worker: _in_words(jobs) for worker, jobs in unfit.items()} | self.refused

    def is_at_fault(self, failures: Iterable[AttemptFailure], attempts: int) -> bool | None:
        """Return True if a job has failed ``attempts`` times on fit workers.

        Return None if some of these workers have not succeeded yet.
        """
        left_out = self.excluded
        workers = [failure.worker for failure in failures if failure.worker not in left_out]
        if len(workers) < attempts:
            return False
        return True if {*workers} <= self._proven | {""} else None

    def readmit_failed(self) -> bool:
        """Readmit workers that failed, count their failures against the jobs, and return True.

        Return False if there is no excluded worker of this kind, or if MAX_FAILED_JOBS jobs have failed without a
        success.
        """
        if not self.excluded.keys() - self.refused.keys() or (
            not self._proven and len(self._failed) >= MAX_FAILED_JOBS
        ):
            return False
        self._failing.clear()
        return True


def host_of(worker: str) -> str:
    """Return the part of a worker's address that all workers of one host share."""
    return worker.rpartition(":")[0]


def _in_words(jobs: Mapping[Index, str]) -> str:
    index, reason = next(iter(jobs.items()))
    return f"{len(jobs)} consecutive tiles failed on this worker, the first is {index}: {reason}"
