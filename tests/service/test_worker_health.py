"""Which workers are left out for what failed there. Truth: the rules in the module's own words, case by case."""

import pytest

from atlas.service.worker_health import MAX_FAILED_JOBS, MAX_FAILURES, AttemptFailure, WorkerHealth, WorkerRefusal

BAD, OTHER = "tcp://10.0.0.2:1", "tcp://10.0.0.3:1"


def fail_at(fitness: WorkerHealth, worker: str, *jobs: int) -> None:
    for job in jobs:
        fitness.fail((job,), AttemptFailure(worker, "ImportError: no numba"), ())


def test_a_worker_is_left_out_once_several_jobs_in_a_row_failed_there_and_the_reason_is_named() -> None:
    fitness = WorkerHealth()
    fail_at(fitness, BAD, 0, 1)
    assert fitness.excluded == {}
    fail_at(fitness, BAD, 2)
    reason = "3 consecutive tiles failed on this worker, the first is (0,): ImportError: no numba"
    assert fitness.excluded == {BAD: reason}


def test_one_job_that_fails_over_and_over_leaves_no_worker_out() -> None:
    fitness = WorkerHealth()
    fail_at(fitness, BAD, *[0] * 10)
    assert fitness.excluded == {}


def test_a_job_that_is_done_begins_the_count_of_its_worker_anew() -> None:
    fitness = WorkerHealth()
    fail_at(fitness, BAD, 0, 1)
    fitness.finish(BAD)
    fail_at(fitness, BAD, 2, 3)
    assert fitness.excluded == {}


def test_a_job_that_fails_at_a_worker_that_does_others_speaks_against_none() -> None:
    fitness = WorkerHealth()
    fitness.finish(OTHER)
    fail_at(fitness, BAD, 0, 1, 2)
    fitness.fail((0,), AttemptFailure(OTHER, "ZeroDivisionError"), (AttemptFailure(BAD, ""),))
    assert fitness.excluded == {}


def test_two_workers_that_do_nothing_do_not_excuse_each_other() -> None:
    fitness = WorkerHealth()
    fail_at(fitness, BAD, 0, 1, 2)
    for job in range(3):
        fitness.fail((job,), AttemptFailure(OTHER, ""), (AttemptFailure(BAD, ""),))
    assert fitness.excluded.keys() == {BAD, OTHER}


def test_what_failed_at_a_worker_that_is_left_out_does_not_count_against_the_job() -> None:
    fitness = WorkerHealth()
    fitness.finish(OTHER)
    fail_at(fitness, BAD, 0, 1, 2)
    assert fitness.is_at_fault([AttemptFailure(BAD, "")] * 3, attempts=3) is False
    assert fitness.is_at_fault([AttemptFailure(OTHER, "")] * 3, attempts=3) is True
    assert fitness.is_at_fault([AttemptFailure("", "")] * 3, attempts=3) is True


def test_whether_a_job_is_at_fault_is_open_while_its_workers_have_done_none() -> None:
    assert WorkerHealth().is_at_fault([AttemptFailure(BAD, "")] * 3, attempts=3) is None


def test_workers_that_failed_get_another_chance_where_something_was_done() -> None:
    fitness = WorkerHealth()
    fitness.finish(OTHER)
    fail_at(fitness, BAD, *range(MAX_FAILED_JOBS + MAX_FAILURES))
    assert fitness.readmit_failed()
    assert fitness.excluded == {}


@pytest.mark.parametrize(("jobs", "again"), [(MAX_FAILED_JOBS - 1, True), (MAX_FAILED_JOBS, False)])
def test_they_get_none_where_many_jobs_failed_and_none_was_done(jobs: int, again: bool) -> None:
    fitness = WorkerHealth()
    fail_at(fitness, BAD, *range(jobs))
    assert fitness.readmit_failed() is again


def test_a_worker_that_refuses_gets_no_other_chance() -> None:
    fitness = WorkerHealth()
    fitness.record_refusal(WorkerRefusal(BAD, "another solver"))
    assert not fitness.readmit_failed()
    assert fitness.excluded == {BAD: "another solver"}
