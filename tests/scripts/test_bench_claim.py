"""Claims about readers of one claim on a shared folder, as scripts/bench_claim.py counts them."""

from pathlib import Path

from scripts.bench_claim import measure


def test_two_hundred_readers_of_a_claim_take_no_lock_and_always_find_its_token(tmp_path: Path) -> None:
    found = measure(tmp_path / "notes", readers=200, seconds=0.5)
    assert found.reads >= 200
    assert found.renewals > 0
    assert (found.torn, found.locks) == (0, 0)
