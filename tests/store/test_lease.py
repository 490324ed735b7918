import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from atlas.errors import InputError, RunError
from atlas.platform import process_name
from atlas.service.lease import STOP, LeaseObserver, LeaseRecord, cancel, hold_lease
from atlas.service.timing import Timing
from atlas.store.create import remove_half_made
from atlas.store.object_backend import LocalBackend
from atlas.store.sidecar import LEASE_NAME, read_lease_token, sidecar_of
from tests.paths import ROOT
from tests.polling import until

QUICK = Timing(heartbeat=0.02)
IMPATIENT = Timing(heartbeat=0.02, lease_poll=0.02, warn_after=0.3, expire_after=0.3)


@pytest.fixture
def notes(tmp_path: Path) -> LocalBackend:
    return LocalBackend(tmp_path / "notes")


REPLACED = "the next run takes it over"


within_20_s = partial(until, seconds=20.0)


def elsewhere(beat: int = 7) -> LeaseRecord:
    """A claim from a machine that this one cannot look into."""
    return LeaseRecord("theirs", beat, "far", 1, "another-boot pid:[1] 1 1")


def test_of_many_that_ask_for_a_lease_at_once_one_gets_it(notes: LocalBackend) -> None:
    held = list[str]()

    def ask() -> None:
        with suppress(InputError), hold_lease(notes, "out.zarr", timing=IMPATIENT) as claim:
            held.append(claim.token)
            done.wait(20)

    done = threading.Event()
    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    within_20_s(lambda: sum(thread.is_alive() for thread in threads) == 1)
    done.set()
    assert len(held) == 1


def test_of_two_that_take_over_a_lease_at_once_the_later_one_holds_it(
    notes: LocalBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other one writes its token right after the first has written its own."""
    notes.put_new(LEASE_NAME, elsewhere().pack())
    whole, later = LocalBackend.put, replace(elsewhere(), token="later")

    def put(place: LocalBackend, key: str, data: bytes) -> None:
        whole(place, key, data)
        whole(place, key, later.pack())
        moving.start()

    def move() -> None:
        for beat in range(8, 100):
            if refused.wait(0.02):
                return
            whole(notes, LEASE_NAME, replace(later, beat=beat).pack())

    moving, refused = threading.Thread(target=move), threading.Event()
    monkeypatch.setattr(LocalBackend, "put", put)
    with pytest.raises(InputError, match="leased by another run"), hold_lease(notes, "out.zarr", timing=IMPATIENT):
        pass
    refused.set()
    moving.join()
    assert read_lease_token(notes) == "later"


def test_readers_of_a_claim_that_is_renewed_always_find_its_token(notes: LocalBackend) -> None:
    """Workers read it before each commit."""
    with hold_lease(notes, "out.zarr", timing=Timing(heartbeat=1e-4)) as claim:
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            assert read_lease_token(notes) == claim.token


def test_the_folder_of_the_claim_goes_with_it(notes: LocalBackend) -> None:
    with hold_lease(notes, "out.zarr", timing=QUICK):
        (notes.path / "claim.0123.partial").touch()  # left by a process that was killed while it wrote
    assert not notes.path.exists()


def test_a_claim_moves_its_counter_and_goes_with_its_holder(notes: LocalBackend) -> None:
    with hold_lease(notes, "out.zarr", timing=QUICK):
        seen = notes.get(LEASE_NAME)
        within_20_s(lambda: notes.get(LEASE_NAME) != seen)
    assert notes.get(LEASE_NAME) is None


def test_a_second_run_is_refused_and_leaves_the_first_alone(notes: LocalBackend) -> None:
    with hold_lease(notes, "out.zarr", timing=QUICK) as first:
        refusal = rf"^out.zarr: leased by another run \(process {os.getpid()} on "
        with pytest.raises(InputError, match=refusal), hold_lease(notes, "out.zarr", timing=QUICK):
            pass
        first.check()


def test_a_claim_that_stands_still_is_replaced_and_not_before(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere().pack())
    said: list[str] = []
    begin = time.monotonic()
    with hold_lease(notes, "out.zarr", said.append, IMPATIENT):
        assert time.monotonic() - begin >= IMPATIENT.expire_after
    assert said == [
        "the store is leased by process 1 on far: waiting for a heartbeat",
        "taking over an expired lease",
    ]


def test_a_claim_of_another_machine_is_respected_while_its_counter_moves(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere(0).pack())
    stop = threading.Event()

    def beat() -> None:
        now = elsewhere(0)
        while not stop.wait(0.05):
            after = replace(now, beat=now.beat + 1)
            notes.put(LEASE_NAME, after.pack())
            now = after

    thread = threading.Thread(target=beat)
    thread.start()
    with pytest.raises(InputError, match="leased by another run"), hold_lease(notes, "out.zarr", timing=QUICK):
        pass
    stop.set()
    thread.join()


def test_a_claim_of_a_killed_process_of_this_machine_needs_no_watching(notes: LocalBackend) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from atlas.service.lease import hold_lease; from atlas.store.object_backend import LocalBackend\n"
        "with hold_lease(LocalBackend(Path(sys.argv[1])), 'out.zarr'): os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, notes.path], check=False, cwd=ROOT)
    assert notes.get(LEASE_NAME) is not None
    seen = LeaseObserver(notes).observe()
    assert seen is not None
    assert (seen.alive, seen.trouble) == (False, f"{seen.record} ended without releasing its lease; {REPLACED}")
    said: list[str] = []
    with hold_lease(notes, "out.zarr", said.append):
        pass
    assert len(said) == 1
    assert said[0].endswith("which no longer runs")


def test_a_torn_claim_is_replaced(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, b'{"token": "thei')
    with hold_lease(notes, "out.zarr", timing=IMPATIENT):
        pass


def test_a_holder_that_was_asleep_finds_itself_replaced(notes: LocalBackend) -> None:
    with hold_lease(notes, "out.zarr", timing=QUICK) as slept:
        notes.put(LEASE_NAME, elsewhere().pack())
        within_20_s(lambda: slept.lost != "")
        with pytest.raises(RunError, match=r"another run has taken over the store \(process 1 on far\)"):
            slept.check()
    assert notes.get(LEASE_NAME) == elsewhere().pack()


def test_a_holder_whose_disk_is_away_for_a_while_keeps_its_claim(
    notes: LocalBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    with hold_lease(notes, "out.zarr", timing=QUICK) as claim:
        with monkeypatch.context() as away:
            failed = threading.Event()

            def put(*_: object, **__: object) -> bool:
                failed.set()
                raise OSError(28, "No space left on device")

            away.setattr(LocalBackend, "put", put)
            assert failed.wait(20)
        seen = notes.get(LEASE_NAME)
        within_20_s(lambda: notes.get(LEASE_NAME) != seen)
        claim.check()


@pytest.mark.parametrize("patience", [0.0, 1.0])
def test_a_run_that_cannot_renew_its_claim_for_as_long_as_others_wait_stops_itself(
    notes: LocalBackend, monkeypatch: pytest.MonkeyPatch, patience: float
) -> None:
    with hold_lease(notes, "out.zarr", timing=IMPATIENT, patience=patience) as claim:

        def put(*_: object, **__: object) -> bool:
            raise OSError(5, "Input/output error")

        claim.check()
        begin = time.monotonic()
        with monkeypatch.context() as away:
            away.setattr(LocalBackend, "put", put)
            with pytest.raises(
                RunError,
                match=r"no heartbeat succeeded for \d+ s \(Input/output error\), so another run",
            ):
                while True:
                    claim.check()
                    time.sleep(0.02)
        assert time.monotonic() - begin >= max(patience, IMPATIENT.expire_after) - 2 * IMPATIENT.heartbeat
    assert notes.get(LEASE_NAME) is None  # the store is free again


def test_a_run_whose_store_refuses_it_stops_with_the_reason_and_without_waiting(
    notes: LocalBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> bool:
        raise PermissionError(13, "ExpiredToken")

    with hold_lease(notes, "out.zarr", timing=Timing(heartbeat=0.01, expire_after=0.05), patience=600.0) as claim:
        monkeypatch.setattr(LocalBackend, "put", refused)
        time.sleep(0.1)
        with pytest.raises(RunError, match=r"no heartbeat succeeded for \d+ s \(ExpiredToken\), so"):
            claim.check()


@pytest.fixture
def away(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """A disk that lets nothing be written until it is told to be back."""
    whole, back = LocalBackend.put, threading.Event()

    def put(notes: LocalBackend, name: str, data: bytes) -> None:
        if name == LEASE_NAME and not back.is_set() and b"theirs" not in data:
            raise OSError(5, "Input/output error")
        whole(notes, name, data)

    with monkeypatch.context() as patch:
        patch.setattr(LocalBackend, "put", put)
        yield back.set


def test_a_run_that_waits_for_its_store_goes_on_only_once_it_has_renewed_its_claim(
    notes: LocalBackend, away: Callable[[], None]
) -> None:
    """Others may have replaced the claim by then, long before the run's patience ends."""
    with hold_lease(notes, "out.zarr", timing=IMPATIENT, patience=60.0) as claim:
        seen, waited = notes.get(LEASE_NAME), []

        def waiting() -> None:
            if len(waited) < 5:  # after that the beat comes through at any moment
                assert notes.get(LEASE_NAME) == seen
            waited.append(time.monotonic())
            if len(waited) == 5:
                away()

        begin = time.monotonic()
        while not waited:
            claim.check(waiting)
        assert len(waited) >= 5
        assert waited[0] - begin >= IMPATIENT.expire_after - 2 * IMPATIENT.heartbeat
        assert notes.get(LEASE_NAME) != seen


def test_a_run_that_waits_for_its_store_stops_where_another_has_replaced_its_claim(
    notes: LocalBackend, away: Callable[[], None]
) -> None:
    with hold_lease(notes, "out.zarr", timing=IMPATIENT, patience=60.0) as claim:

        def waiting() -> None:
            notes.put(LEASE_NAME, elsewhere().pack())
            away()

        with pytest.raises(RunError, match=r"another run has taken over the store \(process 1 on far\)"):
            while True:
                claim.check(waiting)
    assert notes.get(LEASE_NAME) == elsewhere().pack()


def test_a_claim_is_not_replaced_because_the_store_was_away_from_its_watcher(
    notes: LocalBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its holder could not move it meanwhile; it does as soon as the store is back."""
    holder = elsewhere()
    notes.put_new(LEASE_NAME, holder.pack())
    whole, reads = LocalBackend.get, []

    def read(folder: LocalBackend, name: str) -> bytes | None:
        reads.append(name)
        if len(reads) == 3:
            time.sleep(2 * IMPATIENT.expire_after)
            return whole(folder, name)
        if len(reads) == 5:
            notes.put(LEASE_NAME, replace(holder, beat=8).pack())
        return whole(folder, name)

    monkeypatch.setattr(LocalBackend, "get", read)
    with (
        pytest.raises(InputError, match="leased by another run"),
        hold_lease(notes, "out.zarr", timing=IMPATIENT),
    ):
        pass


def test_what_a_holder_reports_is_read_by_others(notes: LocalBackend) -> None:
    with hold_lease(notes, "out.zarr", timing=QUICK) as claim:
        claim.set_progress({"workers": 3})
        within_20_s(lambda: json.loads(notes.get(LEASE_NAME) or b"{}")["progress"] == {"workers": 3})
        seen = LeaseObserver(notes).observe_until_settled()
        assert seen is not None
        assert seen.record is not None
        assert (seen.record.pid, seen.record.progress) == (os.getpid(), {"workers": 3})
        assert (seen.alive, seen.trouble) == (True, "")


def test_cancel_reaches_the_holder_and_returns_when_it_has_stopped(notes: LocalBackend) -> None:
    stopped = threading.Event()

    def work() -> None:
        with (
            pytest.raises(RunError, match="stopped by atlas cancel"),
            hold_lease(notes, "out.zarr", timing=QUICK) as claim,
        ):
            while True:
                claim.check()
                time.sleep(0.005)
        stopped.set()

    thread = threading.Thread(target=work)
    thread.start()
    within_20_s(lambda: notes.get(LEASE_NAME) is not None)
    cancel(notes, "out.zarr", wait_seconds=20)
    thread.join()
    assert stopped.is_set()
    assert notes.get(LEASE_NAME) is None


def test_cancel_without_a_run_is_refused(notes: LocalBackend) -> None:
    with pytest.raises(InputError, match=r"out.zarr: no run is at work on it"):
        cancel(notes, "out.zarr", wait_seconds=1)


def test_cancel_says_when_a_run_has_not_stopped(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere().pack())
    with pytest.raises(RunError, match=r"has not stopped within 0.1 s"):
        cancel(notes, "out.zarr", wait_seconds=0.1)


def test_cancel_says_at_once_that_a_claim_stands_still(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere().pack())
    with pytest.raises(RunError, match=r"out.zarr: no heartbeat from process 1 on far for 0 s; its"):
        cancel(notes, "out.zarr", wait_seconds=600, timing=IMPATIENT)
    assert (notes.get(LEASE_NAME), notes.get(STOP)) == (elsewhere().pack(), b"theirs")


def test_cancel_of_a_killed_run_says_that_its_process_is_gone(notes: LocalBackend) -> None:
    boot, namespace, *_ = process_name().split()
    gone = replace(elsewhere(), pid=2**31 - 1, process=f"{boot} {namespace} {2**31 - 1} 1")
    notes.put_new(LEASE_NAME, gone.pack())
    with pytest.raises(InputError, match=rf"no run is at work on it: process {2**31 - 1} on far ended"):
        cancel(notes, "out.zarr", wait_seconds=600)


def test_a_claim_from_elsewhere_is_silent_only_after_it_has_stood_still(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere().pack())
    observer = LeaseObserver(notes, IMPATIENT)
    first, settled = observer.observe(), observer.observe_until_settled()
    assert first is not None
    assert settled is not None
    assert (first.alive, first.trouble) == (None, "")
    assert settled.trouble.startswith("no heartbeat from process 1 on far for ")


def test_a_claim_from_elsewhere_that_moves_is_in_no_trouble(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere(0).pack())

    def beat(_: float) -> None:  # its holder moves it while the observer sleeps
        notes.put(LEASE_NAME, elsewhere(1).pack())

    seen = LeaseObserver(notes, sleep=beat).observe_until_settled()
    assert seen is not None
    assert (seen.record, seen.trouble) == (elsewhere(1), "")


def test_a_request_to_stop_is_no_sign_of_life(notes: LocalBackend) -> None:
    notes.put_new(LEASE_NAME, elsewhere().pack())

    def ask(text: str) -> None:
        if "waiting for a heartbeat" in text:
            notes.put(STOP, b"theirs")

    with hold_lease(notes, "out.zarr", ask, IMPATIENT) as claim:
        claim.check()


DAMAGES: dict[str, object] = {
    "token": 7,
    "beat": "x",
    "host": None,
    "pid": None,
    "process": "boot pid:[1]",
    "cancelled": "no",
    "progress": [1],
}


@pytest.mark.parametrize("field", DAMAGES)
def test_a_claim_with_a_field_of_another_type_is_damaged(notes: LocalBackend, field: str) -> None:
    data = json.dumps(json.loads(elsewhere().pack()) | {field: DAMAGES[field]}).encode()
    notes.put_new(LEASE_NAME, data)
    assert LeaseRecord.unpack(data) is None
    seen = LeaseObserver(notes, IMPATIENT).observe_until_settled()
    assert seen is not None
    assert seen.trouble == f"the lease is damaged; {REPLACED}"
    with pytest.raises(RunError, match=rf"^out.zarr: the lease is damaged; {REPLACED}$"):
        cancel(notes, "out.zarr", wait_seconds=600, timing=IMPATIENT)
    with hold_lease(notes, "out.zarr", timing=IMPATIENT) as claim:
        claim.check()


@pytest.mark.parametrize("data", [b"[]", b"{}", b"7", b"null", b"\xff", b'{"pid": 1e400}', b"[" * 10**5])
def test_bytes_that_are_no_claim_unpack_to_none(data: bytes) -> None:
    assert LeaseRecord.unpack(data) is None


@pytest.mark.parametrize("pid", [0, -1, 2**31, 10**30, True])
def test_a_claim_of_a_number_that_no_process_has_is_damaged(pid: int) -> None:
    assert LeaseRecord.unpack(json.dumps(json.loads(elsewhere().pack()) | {"pid": pid}).encode()) is None


def test_a_number_as_large_as_any_atlas_is_reported_as_it_is() -> None:
    assert replace(elsewhere(), progress={"cells": 10**12}).number("cells") == 10**12


@pytest.mark.parametrize("value", ["many", None, [1], True, float("nan"), float("inf"), 10**400])
def test_a_number_that_is_none_counts_as_not_reported(value: object) -> None:
    assert replace(elsewhere(), progress={"workers": value}).number("workers") == 0


RUN = "0123456789abcdef" * 2


def test_a_half_made_store_is_removed_and_nothing_else(tmp_path: Path) -> None:
    for name in (f".out.zarr.{RUN}.partial", f".other.zarr.{RUN}.partial", "out.zarr"):
        (tmp_path / name).mkdir()
    remove_half_made(tmp_path / "out.zarr")
    assert sorted(path.name for path in tmp_path.iterdir()) == [f".other.zarr.{RUN}.partial", "out.zarr"]


def test_notes_are_next_to_the_store(tmp_path: Path) -> None:
    notes = sidecar_of(tmp_path / "out.zarr")
    assert notes == LocalBackend(tmp_path / ".out.zarr.run")


def test_the_first_report_of_a_holder_is_told_at_once_and_the_next_with_its_beats(notes: LocalBackend) -> None:
    with hold_lease(notes, "out.zarr", timing=Timing(heartbeat=60.0)) as claim:
        claim.set_progress({"tiles": 3})
        assert json.loads(notes.get(LEASE_NAME) or b"{}")["progress"] == {"tiles": 3}
        claim.set_progress({"tiles": 4})
        assert json.loads(notes.get(LEASE_NAME) or b"{}")["progress"] == {"tiles": 3}
