"""What an explorer solves and finds again, without a page."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import CancelledError, Client, LocalCluster, get_worker

import atlas
from atlas.errors import InputError
from atlas.explore.cell_lookup import CellLookup
from atlas.explore.explorer import Explorer
from atlas.explore.grid_patch import solve_patch
from atlas.explore.jobs import Computation, ComputationJob, JobService, ServiceJob, Take, Task
from atlas.explore.subject import PlaneParameters, Subject, subject_of
from atlas.explore.tile_cache import MemoryTileCache
from atlas.explore.viewport import STAGES, TILE_CELLS, TileKey, Viewport
from workers.results import INVALID, PENDING, REGIME


def waited(condition: Callable[[], bool], seconds: float = 60.0) -> bool:
    """Whether a condition holds within so many seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def view_of(subject: Subject, pixels: int = 40) -> Viewport:
    """A window within the plane, a few tiles of it."""
    (x, y) = (np.array(axis.values) for axis in subject.spec.axes)
    window = (float(x[1]), float(x[3])), (float(y[1]), float(y[3]))
    return subject.viewport(*window, (pixels, pixels))


@contextmanager
def exploring(store: Path | str, client: Client, **options: object) -> Iterator[Explorer]:
    """An explorer of a store whose cells are solved on a client."""

    @contextmanager
    def connect() -> Iterator[Client]:
        yield client

    made = Explorer(subject_of(str(store)), connect, **options)  # type: ignore[arg-type]
    try:
        yield made
    finally:
        made.stop()


def solved(explorer: Explorer, sight: Viewport, plane: PlaneParameters | None = None) -> list[TileKey]:
    """Have a view solved, and return the tiles in the order in which they came."""
    came: list[TileKey] = []
    plane = plane or explorer.subject.plane
    explorer.subscribe("test", lambda _, key: came.append(key))
    explorer.request_tiles("test", plane, sight, range(3, -1, -1))
    assert waited(lambda: explorer.patches.n_remaining("test") == 0)
    explorer.subscribe("test", None)
    return came


def test_all_cells_in_view_are_solved_and_are_those_of_the_point_command_to_the_bit(
    finished: Path, client: Client
) -> None:
    with exploring(finished, client) as explorer:
        subject, sight = explorer.subject, view_of(explorer.subject)
        solved(explorer, sight)
        ds = explorer.known.visible_cells(subject.plane, sight, ["largest"]).ds
        assert not np.any(ds[REGIME.name].values == PENDING)
        cell = explorer.known.cell(subject.plane, sight, 2.4012345, 0.21)
    assert cell is not None
    alone = atlas.point(cell.parameters, system=subject.system, settings=subject.settings)
    same = {name: value for name, value in cell.results.items() if name in alone and name not in subject.spec.dims}
    assert len(same) > 15
    assert all(value == alone[name] or (value != value and alone[name] != alone[name]) for name, value in same.items())


def shares(known: CellLookup, plane: PlaneParameters, sight: Viewport) -> tuple[float, ...]:
    """The shares of the cells in view that are known at each stage or a finer one, the coarsest stage first."""
    stages = known.visible_cells(plane, sight, []).stages
    return tuple(float(np.mean(stages <= stage)) for stage in range(STAGES, -1, -1))


def test_a_view_is_known_stage_by_stage_coarse_to_fine(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        known, tiles, plane, sight = explorer.known, explorer.tiles, explorer.subject.plane, view_of(explorer.subject)
        assert shares(known, plane, sight) == (0.0, 0.0, 0.0, 0.0)
        explorer.request_tiles("test", plane, sight, range(3, 0, -1))  # all but the full density
        assert waited(lambda: explorer.patches.n_remaining("test") == 0)
        assert shares(known, plane, sight) == (1.0, 1.0, 1.0, 0.0)
        first, *_ = sight.tiles(0)
        rows, columns = sight.slices_of(first)
        tiles.memory.put(tiles, plane, first, tiles.full_tile(plane, first.parent) or {})
        share = (rows.stop - rows.start) * (columns.stop - columns.start) / (sight.x.count * sight.y.count)
        assert shares(known, plane, sight) == (1.0, 1.0, 1.0, pytest.approx(share))


def test_a_tile_that_is_known_in_full_counts_for_all_coarser_stages(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        known, tiles, plane, sight = explorer.known, explorer.tiles, explorer.subject.plane, view_of(explorer.subject)
        for key in sight.tiles(0):
            tiles.memory.put(
                tiles, plane, key, known.subject.without_results(known.subject.variables, (TILE_CELLS, TILE_CELLS))
            )
        assert shares(known, plane, sight) == (1.0, 1.0, 1.0, 1.0)


def test_a_view_of_the_stores_own_cells_is_drawn_as_densely_as_they_lie(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        subject = explorer.subject
        inner = [(float(axis.values[0]), float(axis.values[-1])) for axis in subject.spec.axes]
        cells = len(subject.spec.axes[0]), len(subject.spec.axes[1])
        sight = subject.viewport(*inner, (4 * cells[0], 4 * cells[1]))
        assert (sight.x.level, sight.y.level) == (2, 2)
        assert shares(explorer.known, subject.plane, sight) == (1.0, 1.0, 0.0, 0.0)


def test_a_cell_that_is_solved_alone_is_that_of_its_tile_to_the_bit(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        sight, plane = view_of(explorer.subject), explorer.subject.plane
        solved(explorer, sight)
        found = explorer.known.cell(plane, sight, 2.4012345, 0.21)
        assert found is not None
        alone = explorer.known.solve_cell(plane, found.parameters["omega"], found.parameters["b"])
    assert alone.parameters == found.parameters
    assert str(alone.results | {"distance": 0}) == str(found.results | {"distance": 0})  # some are not a number


def test_a_point_names_the_same_cell_before_and_after_the_view_is_solved(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        known, plane, sight = explorer.known, explorer.subject.plane, view_of(explorer.subject)
        before = known.point(plane, sight, 2.4012345, 0.21)
        solved(explorer, sight)
        found = known.cell(plane, sight, 2.4012345, 0.21)
        assert found is not None
        after = known.point(plane, sight, 2.4012345, 0.21)
    assert before == after == tuple(found.parameters[name] for name in explorer.subject.axes)


@pytest.mark.slow
def test_tiles_come_coarse_first_and_none_twice(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        sight = view_of(explorer.subject, 150)
        came = solved(explorer, sight)
        again = solved(explorer, sight)
    assert len(set(came)) == len(came) and not again
    middle = [sum(key[:2]) for key in came]
    assert np.mean(middle[: len(middle) // 3]) < np.mean(middle[-len(middle) // 3 :])


def test_a_tile_is_waited_for_until_it_is_known(finished: Path, client: Client) -> None:
    left: list[int] = []
    with exploring(finished, client) as explorer:
        explorer.subscribe("count", lambda _, key: left.append(explorer.patches.n_remaining("test")))
        solved(explorer, view_of(explorer.subject))
    assert min(left) == 1


def test_a_store_is_left_as_it_was_and_explored_by_several(finished: Path, client: Client) -> None:
    before = {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()}
    with exploring(finished, client) as one, exploring(finished, client) as other:
        for explorer in (one, other):
            assert solved(explorer, view_of(explorer.subject))
    assert {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()} == before


def test_a_packed_atlas_is_explored(finished: Path, client: Client, tmp_path: Path) -> None:
    atlas.pack(finished, tmp_path / "packed.zip")
    with exploring(tmp_path / "packed.zip", client) as explorer:
        assert solved(explorer, view_of(explorer.subject))


def test_a_tile_that_memory_has_no_room_for_is_solved_again(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        sight = view_of(explorer.subject)
        tiles = solved(explorer, sight)
        explorer.tiles.memory = MemoryTileCache(1)
        assert sorted(solved(explorer, sight)) == sorted(tiles)


def test_a_cluster_that_goes_before_a_result_is_here_is_called_again(
    finished: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    back = threading.Event()

    def gone(client: Client, *given: Any, **named: Any) -> Any:
        if not back.is_set():
            raise CancelledError("gone")
        return gather(client, *given, **named)

    gather = Client.gather
    monkeypatch.setattr(Client, "gather", gone)
    with exploring(finished, client) as explorer:
        sight = view_of(explorer.subject)
        explorer.request_tiles("test", explorer.subject.plane, sight, range(3, -1, -1))
        assert waited(lambda: explorer.patches.state.trouble == "the cluster was lost; trying again")
        back.set()
        solved(explorer, sight)
        assert explorer.patches.state.trouble == ""


_SHOUTED = list[str]()


def _shouted(text: str) -> str:
    """A text in capitals; InputError, with how often it came, for the word input."""
    _SHOUTED.append(text)
    if text == "input":
        raise InputError(f"input {_SHOUTED.count(text)}")
    return text.upper()


@dataclass(frozen=True)
class Mistaken(ServiceJob):
    """A job with a mistake in one of its methods, or in none."""

    wrong: str
    came: list[str] = field(compare=False)

    def build_task(self) -> tuple[Task, Take]:
        self._step("make")
        return (_shouted, self.wrong), self.take

    def take(self, result: object) -> int:
        self._step("take")
        self.came.append(str(result))
        return 1

    def on_failed(self, why: str) -> None:
        self.came.append(why)

    def _step(self, name: str) -> None:
        if name == self.wrong:
            raise KeyError(name)


_FAILED_AT = list[str]()


def _at_one_worker_only(good: str) -> str:
    time.sleep(0.02)  # so that the other worker gets some, too
    if (here := get_worker().address) != good:
        _FAILED_AT.append(here)
        raise MemoryError(here)
    return here


def test_a_worker_at_which_patches_fail_gets_no_more_of_them_and_another_does_them(tmp_path: Path) -> None:
    """As with the tiles of a run: the same crew has both done."""
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster) as client,
    ):

        @contextmanager
        def connect() -> Iterator[Client]:
            yield client

        good, came, refused = max(client.scheduler_info()["workers"]), list[str](), list[str]()
        patches = JobService(connect)
        try:
            question = partial(Computation[str], _at_one_worker_only, good)
            patches.request("test", [ComputationJob(question(), came.append, refused.append) for _ in range(40)])
            assert waited(lambda: patches.n_remaining("test") == 0)
        finally:
            patches.stop()
    assert came == [good] * 40 and not refused
    assert len(_FAILED_AT) <= 40


def test_a_mistake_in_one_job_ends_that_job_and_not_the_work_for_others(client: Client) -> None:
    @contextmanager
    def connect() -> Iterator[Client]:
        yield client

    patches, came = JobService(connect), list[str]()
    try:
        patches.request("page", [Mistaken(wrong, came) for wrong in ("make", "take", "none", "input")])
        assert waited(lambda: patches.n_remaining("page") == 0 and len(came) == 4)
        assert sorted(came) == ["KeyError: 'make'", "KeyError: 'take'", "NONE", "input 1"]
    finally:
        patches.stop()


def test_a_tile_that_was_given_up_is_tried_again_by_who_looks_later(
    finished: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    with exploring(finished, client) as explorer:
        plane, sight = explorer.subject.plane, view_of(explorer.subject)

        def count() -> int:
            return explorer.request_tiles("test", plane, sight, range(3, -1, -1))

        with monkeypatch.context() as broken:
            broken.setattr("atlas.explore.explorer.solve_patch", _refused)
            tiles = count()
            assert tiles > 3 and waited(lambda: explorer.patches.n_remaining("test") == 0)
        assert len(explorer.failures) == tiles and count() == 0
        monkeypatch.setattr("atlas.explore.explorer.RETRY_SECONDS", 0.0)
        assert solved(explorer, sight) and not explorer.failures
        assert not np.any(explorer.known.visible_cells(plane, sight, []).ds[REGIME.name].values == PENDING)


def _refused(patch: object) -> object:
    raise InputError("no cell of this tile can be solved")


def test_a_page_that_is_gone_wants_nothing_more(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        sight = view_of(explorer.subject, 600)
        explorer.subscribe("page", lambda *_: None)
        assert explorer.request_tiles("page", explorer.subject.plane, sight, range(3, -1, -1)) > 100
        explorer.subscribe("page", None)
        assert explorer.patches.n_remaining("page") == 0


def test_a_tile_without_a_cell_in_range_is_known_as_it_would_be_solved(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        subject, known = explorer.subject, explorer.tiles
        outside, partly = TileKey(0, 0, 0, -40), TileKey(2, 2, 0, -1)
        assert known.has(subject.plane, outside) and not known.is_out_of_range(partly)
        found = known.full_tile(subject.plane, outside)
        assert found is not None
        for name, solved_so in solve_patch(
            subject.patch(subject.plane, outside, np.ones((TILE_CELLS, TILE_CELLS), dtype=bool))
        ).items():
            assert np.array_equal(
                found[name].reshape(solved_so.shape), solved_so, equal_nan=solved_so.dtype.kind == "f"
            )
        sight = subject.viewport((2.0, 3.0), (-20.0, -19.0), (30, 30))
        assert solved(explorer, sight) == []
        assert (explorer.known.visible_cells(subject.plane, sight, []).ds.regime == INVALID).all()


@pytest.mark.slow
def test_cells_out_of_range_are_invalid(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        subject = explorer.subject
        sight = subject.viewport((2.0, 3.0), (-0.1, 0.1), (30, 30))
        solved(explorer, sight)
        ds = explorer.known.visible_cells(subject.plane, sight, []).ds
        assert set(np.unique(ds[REGIME.name].values[ds.b.values <= 0])) == {5}


def test_neither_workers_nor_the_explorer_need_bokeh() -> None:
    imports = """
from atlas.explore.branches import follow_orbit
from atlas.explore.cut import cut_computation
from atlas.explore.grid_patch import solve_patch
from atlas.explore.connection import PageConnection
from atlas.explore.session import explore
"""
    program = f"import sys\n{imports}\nprint('bokeh' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
