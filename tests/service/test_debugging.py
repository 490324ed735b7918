"""A tile that fails can be debugged: its traceback is kept, and it can be done alone in this process."""

import logging
from pathlib import Path

import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.dispatch import Dispatcher
from atlas.service.summary import TileFailure
from atlas.store.store import done_tiles, open_store
from tests.fake_cluster import Numbered
from tests.planes import plane_of
from workers import tile as solving

FAULTY = (1, 1)


def faulty(job: Numbered) -> tuple[int, ...]:
    """Work with a mistake in one job."""
    if job.index == FAULTY:
        raise ZeroDivisionError("a mistake")
    return job.index


def outcomes(client: Client) -> list[object]:
    jobs = [Numbered((i, j)) for i in range(3) for j in range(3)]
    return list(Dispatcher(client, faulty).iter_outcomes(jobs, lambda _: None))


def test_the_traceback_of_a_tile_that_fails_is_in_its_failure_and_in_the_log(
    client: Client, caplog: pytest.LogCaptureFixture
) -> None:
    """Truth: "ZeroDivisionError: a mistake" was all that was left of it."""
    with caplog.at_level(logging.DEBUG, "atlas"):
        (failure,) = [outcome for outcome in outcomes(client) if isinstance(outcome, TileFailure)]
    line = 'raise ZeroDivisionError("a mistake")'
    assert line in failure.traceback and "in faulty" in failure.traceback
    assert failure.traceback not in repr(failure)
    said = [record.getMessage() for record in caplog.records if record.name.startswith("atlas.")]
    assert sum(line in text for text in said) == 3
    assert "tile (1, 1) is given up after 3 attempts" in said


def test_without_a_log_nothing_is_said_of_an_attempt_that_failed(
    client: Client, capfd: pytest.CaptureFixture[str]
) -> None:
    outcomes(client)
    assert capfd.readouterr() == ("", "")


def test_one_tile_is_done_in_this_process(tmp_path: Path, client: Client) -> None:
    store = tmp_path / "out.zarr"
    summary = atlas.run(plane_of(), store, tile=FAULTY)
    assert (summary.tiles_solved, summary.cells_solved) == (1, 6)
    assert done_tiles(open_store(store)) == {FAULTY}
    assert atlas.run(plane_of(), store, client=client).tiles_solved == 8
    assert atlas.verify(store, sample=0).is_sound
    with pytest.raises(InputError, match=r"tile \(1, 1\) is already finished$"):
        atlas.run(plane_of(), store, tile=FAULTY)


def test_what_a_tile_raises_in_this_process_comes_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("a mistake")

    monkeypatch.setattr(solving, "solve_tile", fail)
    with pytest.raises(ZeroDivisionError, match="a mistake"):
        atlas.run(plane_of(), tmp_path / "out.zarr", tile=FAULTY)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--tile", "30,0"], "tile: found (30, 0), must be the index of a tile: 0 to "),
        (["--tile", "0"], "tile: found (0,), must be the index of a tile"),
        (["--tile", "a"], "--tile: found 'a', must be a whole number"),
        (["--tile", "0,0", "--scheduler", "tcp://127.0.0.1:1"], "tile: is solved in this process, found a scheduler"),
        (["--log", "/nowhere/log"], "--log /nowhere/log: No such file or directory"),
    ],
)
def test_a_wrong_tile_or_log_is_one_line(tmp_path: Path, words: list[str], says: str) -> None:
    ended = CliRunner().invoke(main, ["run", "tiny", "-o", str(tmp_path / "out.zarr"), *words])
    assert (ended.exit_code, list(tmp_path.iterdir())) == (2, [])
    assert says in ended.stderr.splitlines()[-1]


def test_the_log_of_a_run_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "run.log"
    ended = CliRunner().invoke(
        main, ["run", "tiny", "-o", str(tmp_path / "o.zarr"), "--tile", "0,0", "--log", str(log)]
    )
    assert ended.exit_code == 0, ended.stderr
    assert log.exists()
    assert not logging.getLogger("atlas").handlers
