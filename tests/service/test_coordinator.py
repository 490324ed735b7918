"""What a coordinator checks before it begins, which worker takes its place, and the word that it leaves."""

import asyncio
import json
import subprocess
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from distributed import Client, LocalCluster, Variable, get_worker

import atlas
from atlas.cli.main import main
from atlas.errors import InputError, RunError
from atlas.platform import process_name
from atlas.service import submit as submitting
from atlas.service.lease import LeaseRecord, read_end
from atlas.service.options import DEFAULTS, RunOptions
from atlas.service.run import complete
from atlas.service.status import read_status
from atlas.service.submit import Submission, check_coordinator, coordinate, submit
from atlas.service.timing import Timing
from atlas.service.worker_health import WorkerRefusal
from atlas.store.create import create_store
from atlas.store.object_backend import open_backend
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import open_store
from atlas.store.tile_records import RunTileRecords
from atlas.task.store_ref import WorkerRefusedError
from tests.planes import plane_of
from workers import SOLVER_VERSION

PLANE = plane_of((5, 7))  # one tile


@pytest.fixture(scope="module")
def two() -> Iterator[Client]:
    """Two workers of one thread in this process, which can be reached by an address."""
    with (
        LocalCluster(
            processes=False,
            n_workers=2,
            threads_per_worker=1,
            host="127.0.0.1",
            protocol="tcp",
            dashboard_address="127.0.0.1:0",
        ) as cluster,
        Client(cluster) as made,  # the default one, so that coordinators in this process use it too
    ):
        yield made


def submitted(client: Client, store: Path, plane: atlas.Spec = PLANE) -> str:
    return submit(plane, store, RunOptions(scheduler=str(client.scheduler.address)))


def task_of(
    store: Path, run_id: str = "", solver_version: int = SOLVER_VERSION, options: RunOptions = DEFAULTS
) -> Submission:
    return Submission(PLANE, str(store), options, f"atlas-{uuid.uuid4().hex}", solver_version, run_id)


def restarted(client: Client, task: Submission, run_id: str) -> object:
    """The outcome of a coordinator that follows one whose worker died after it had begun in the store of a run."""
    Variable(task.name, client=client).set(run_id)
    return client.submit(coordinate, task, pure=False).result()


def until_idle(client: Client) -> None:
    while any(client.processing().values()):
        time.sleep(0.05)


def refuse(where: Callable[[], bool], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Have workers refuse to coordinate; the addresses of those that were asked, in turn."""
    asked: list[str] = []

    def check(task: Submission) -> None:
        asked.append(get_worker().address)
        if where():
            raise WorkerRefusedError("has another solver")

    monkeypatch.setattr(submitting, "check_coordinator", check)
    return asked


def test_a_worker_with_another_solver_version_must_not_coordinate(tmp_path: Path) -> None:
    with pytest.raises(
        WorkerRefusedError, match=rf"^this worker has solver version {SOLVER_VERSION}, the run needs 99$"
    ):
        check_coordinator(task_of(tmp_path / "out.zarr", solver_version=99))


def test_a_worker_that_sees_another_store_must_not_coordinate(tmp_path: Path) -> None:
    store = create_store(tmp_path / "out.zarr", PLANE, (5, 7)).path
    with pytest.raises(
        WorkerRefusedError, match=r"not the store of run 0123; check that the path is the same on every host"
    ):
        check_coordinator(task_of(store, run_id="0123"))
    with pytest.raises(WorkerRefusedError, match=r"no such store; check that the path is the same on every host"):
        check_coordinator(task_of(tmp_path / "none.zarr", run_id="0123"))


def test_the_right_worker_may_coordinate(tmp_path: Path) -> None:
    handle = create_store(tmp_path / "out.zarr", PLANE, (5, 7))
    check_coordinator(task_of(handle.path, handle.run_id))
    check_coordinator(task_of(tmp_path / "new.zarr"))


def test_another_worker_takes_the_place_of_one_that_refuses(
    tmp_path: Path, two: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    asked = refuse(lambda: get_worker().address == asked[0], monkeypatch)
    where = submitted(two, tmp_path / "out.zarr")
    assert [where, asked[0]] in (list(two.nthreads()), list(two.nthreads())[::-1])
    assert open_store(tmp_path / "out.zarr").solver_version == SOLVER_VERSION


def test_a_submission_that_every_worker_refuses_is_an_error_with_worker_and_reason(
    tmp_path: Path, two: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = refuse(lambda: True, monkeypatch)
    with pytest.raises(
        RunError, match=r"^no worker may coordinate this run, for example tcp://\S+: has another solver$"
    ):
        submitted(two, tmp_path / "out.zarr")
    assert {*asked} == {*two.nthreads()}
    assert list(tmp_path.iterdir()) == []


def test_a_new_store_gets_the_run_id_that_its_run_was_given(tmp_path: Path, client: Client) -> None:
    place = open_backend(tmp_path / "out.zarr")
    complete(PLANE, place, client, run_id="0123")
    assert open_store(tmp_path / "out.zarr").run_id == "0123"
    with pytest.raises(RunError, match=r"out.zarr: not the store of run 4567"):
        complete(PLANE, place, client, run_id="4567")


def test_a_coordinator_that_starts_again_hands_a_refusal_on_to_another_worker(
    tmp_path: Path, two: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = create_store(tmp_path / "out.zarr", PLANE, (5, 7))
    asked: list[str] = []
    asked = refuse(lambda: get_worker().address == asked[0], monkeypatch)
    refusal = restarted(two, task_of(handle.path), handle.run_id)
    assert refusal == WorkerRefusal(asked[0], "has another solver")
    for _ in range(200):  # the scheduler may hear of the next one after this client has its answer
        if len({*asked}) == 2:
            break
        time.sleep(0.05)
    until_idle(two)
    assert len({*asked}) == 2
    assert read_status(handle).fraction == 1
    assert read_end(sidecar_of(handle.path)) == ""


def test_a_coordinator_that_starts_again_in_another_runs_store_computes_nothing_and_leaves_word(
    tmp_path: Path, two: Client
) -> None:
    handle = create_store(tmp_path / "out.zarr", PLANE, (5, 7))
    task = task_of(handle.path, options=RunOptions(timing=Timing(replacement_worker=0.0)))
    restarted(two, task, "0123")
    for _ in range(200):  # as above: no worker is busy for a moment before the next one hears of it
        until_idle(two)
        if read_status(handle).ended:
            break
        time.sleep(0.05)
    found = read_status(handle)
    assert found.cells_done == 0
    assert found.ended.startswith("no worker may coordinate this run, for example tcp://")
    assert f"{handle.path} is not the store of run 0123" in found.ended


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (KeyError("level 1"), "KeyError: 'level 1'"),
        (RunError("no room"), "no room"),
        (InputError("not a store"), "not a store"),
        (asyncio.CancelledError(), "CancelledError"),
    ],
)
def test_every_error_of_a_run_under_way_leaves_a_word(
    tmp_path: Path, two: Client, monkeypatch: pytest.MonkeyPatch, error: BaseException, word: str
) -> None:
    def add(*_: object) -> None:
        raise error

    monkeypatch.setattr(RunTileRecords, "add", add)
    store = tmp_path / "out.zarr"
    task = task_of(store)
    Variable(task.name, client=two).set("")
    future = two.submit(coordinate, task, pure=False)
    raised = future.exception()
    assert type(raised) is type(error)
    shown = CliRunner().invoke(main, ["status", str(store), "--json"])
    assert json.loads(shown.stdout)["ended"] == word


def test_bad_input_is_reported_to_the_submitter_and_leaves_no_word(tmp_path: Path, two: Client) -> None:
    handle = create_store(tmp_path / "out.zarr", PLANE, (5, 7))
    with pytest.raises(InputError, match=r"out.zarr: has another spec: "):
        submitted(two, handle.path, plane_of((5, 7), R=0.5))
    assert read_end(sidecar_of(handle.path)) == ""
    assert [path.name for path in tmp_path.iterdir()] == ["out.zarr"]


@pytest.fixture
def claimed_store(tmp_path: Path) -> Callable[[bytes], Path]:
    def make(claim: bytes) -> Path:
        store = create_store(tmp_path / "out.zarr", PLANE, (5, 7)).path
        sidecar_of(store).put_new(LEASE_NAME, claim)
        return store

    return make


def status(store: Path) -> tuple[str, dict[str, object]]:
    """The line of the run, and the object of --json."""
    timing = Timing(lease_poll=0.02, warn_after=0.1)
    text, message = (CliRunner().invoke(main, ["status", str(store), *more], obj=timing) for more in ((), ("--json",)))
    assert (text.exit_code, message.exit_code) == (0, 0)
    line = next(line for line in text.stdout.splitlines() if line.startswith("run "))
    return line.removeprefix("run").strip(), json.loads(message.stdout)


FAR = LeaseRecord("theirs", 7, "far", 1, "another-boot pid:[1] 1 1", progress={"workers": 3})


def test_status_says_that_a_claim_from_elsewhere_stands_still(claimed_store: Callable[[bytes], Path]) -> None:
    line, message = status(claimed_store(FAR.pack()))
    assert line.startswith("no heartbeat from process 1 on far for ")
    assert (message["run"], str(message["trouble"])[:24]) == ("process 1 on far", "no heartbeat from proces")


@pytest.mark.parametrize("damage", [{"beat": "x"}, {"pid": None}, {"progress": [1]}, {"token": 1}])
def test_status_says_that_a_claim_is_damaged(claimed_store: Callable[[bytes], Path], damage: dict[str, object]) -> None:
    line, message = status(claimed_store(json.dumps(json.loads(FAR.pack()) | damage).encode()))
    assert line == "none at work; the lease is damaged; the next run takes it over"
    assert message["run"] is None


def test_status_says_that_a_runs_process_was_killed(claimed_store: Callable[[bytes], Path]) -> None:
    with subprocess.Popen(["sleep", "600"]) as sleeper:
        pid = sleeper.pid
        process = process_name(pid)
        sleeper.kill()
    line, message = status(claimed_store(LeaseRecord("t", 7, "here", pid, process).pack()))
    gone = f"process {pid} on here ended without releasing its lease; the next run takes it over"
    assert (line, message["run"], message["trouble"]) == (f"none at work; {gone}", None, gone)
