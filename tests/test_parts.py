"""A tile with a cell that kills every process: the part with it is marked failed, and nothing else.

Truth: the cells of the other parts, solved without a service.
"""

from pathlib import Path

import numpy as np
import pytest

from atlas.store.sidecar import notes_of
from atlas.store.store import create, read_header
from atlas.store.tiles import read_tile, write_tile
from atlas.task import task
from atlas.task.attempt import run_job
from atlas.task.retry import Retry
from atlas.task.task import Job, Receipt
from tests.faults import environment
from tests.planes import plane_of
from workers.results import FAILED, PROCESS_ENDED
from workers.tile import solve_tile

pytestmark = pytest.mark.slow

PART = (slice(4, 5), slice(0, 4))
"""The part of 4 x 4 cells at the edge of the tile of 5 x 7 that has the cell."""
REASON = "the process that solved them died each of 2 times (signal 9, SIGKILL)"


@pytest.fixture
def job(tmp_path: Path) -> Job:
    header = create(tmp_path / "out.zarr", plane_of((5, 7)), (5, 7))
    return Job((0, 0), str(header.path), header.run_id, header.solver_version)


def deadly(job: Job, monkeypatch: pytest.MonkeyPatch) -> Receipt:
    """A later attempt at a tile whose cell (4, 2) kills."""
    for name, value in environment(Path(job.store).parent / "faults", {"cell 4-2": ["die"]}).items():
        if name == "FAULTS":
            monkeypatch.setenv(name, value)
        if name == "PYTHONPATH":
            monkeypatch.syspath_prepend(value.split(":")[0])
    monkeypatch.setattr(task, "PART", 4)
    notes_of(job.store).put("started-0-0", b'{"attempt": 2}', expected=None)
    return run_job(job)


def test_only_the_cells_of_the_part_that_kills_are_marked_failed(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    receipt = deadly(job, monkeypatch)
    header = read_header(job.store)
    stored = read_tile(header, (0, 0))
    dead = np.zeros((5, 7), dtype=bool)
    dead[PART] = True
    np.testing.assert_array_equal(stored["regime"] == FAILED, dead)
    assert (stored["reason"][dead] == PROCESS_ENDED).all()
    cells = header.spec.cell_params((slice(0, 5), slice(0, 7)))
    for name, values in solve_tile(header.spec.record, cells, header.spec.settings).items():
        np.testing.assert_array_equal(stored[name][~dead], values[~dead], err_msg=name)
    assert receipt.reasons.pop(REASON) == 4
    assert (receipt.cells, receipt.counts["failed"]) == (35, 4)


def test_in_a_retry_the_cells_that_were_not_chosen_stay(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    run_job(job)
    header = read_header(job.store)
    before = read_tile(header, (0, 0))
    marked = before | {"regime": before["regime"].copy()}
    chosen = np.zeros((5, 7), dtype=bool)
    chosen[4, 2] = chosen[0, 0] = True
    marked["regime"][chosen] = FAILED
    write_tile(header, (0, 0), marked)
    retried = Job(job.index, job.store, job.run_id, job.solver_version, Retry((FAILED,)))
    receipt = deadly(retried, monkeypatch)
    stored = read_tile(header, (0, 0))
    assert (stored["regime"][4, 2], stored["reason"][4, 2]) == (FAILED, PROCESS_ENDED)
    chosen[4, 2] = True
    solved = np.ones((5, 7), dtype=bool)
    solved[4, 2] = False
    for name, values in before.items():
        np.testing.assert_array_equal(stored[name][solved], values[solved], err_msg=name)
    assert (receipt.cells, receipt.reasons[REASON], receipt.changed) == (2, 1, 1)
