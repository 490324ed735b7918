import io
import os
import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from distributed import Client, LocalCluster, get_client

import atlas
import workers
from atlas.cli.main import main
from atlas.cli.progress import LogReporter, reporter
from atlas.errors import InputError, RunError
from atlas.overview.pyramid import Pyramid
from atlas.platform import peak_memory
from atlas.service.cluster import worker_memory
from atlas.service.probe import CELLS, with_time
from atlas.service.progress import Progress
from atlas.store import create
from atlas.store.store import done_tiles, open_store
from tests.fake_cluster import Cluster
from tests.paths import ROOT
from tests.planes import plane_of
from tests.synthetic import fill, spec_of
from workers import tile as solving
from workers.results import REGIME


def arrays_of(path: Path) -> dict[str, tuple[str, bytes]]:
    ds = xr.open_zarr(path)
    return {str(name): (str(ds[name].dtype), ds[name].values.tobytes()) for name in ds.data_vars}


def test_a_run_solves_every_cell_and_adds_up(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    summary = atlas.run(plane, tmp_path / "out.zarr", client=client)
    assert (summary.tiles, summary.tiles_done, summary.tiles_solved) == (9, 9, 9)
    assert summary.cells_solved == sum(summary.counts.values()) == 35
    ds = atlas.open(tmp_path / "out.zarr")
    assert (ds.regime.values >= 0).all()
    assert summary.periods == ds.periods_used.values.sum()
    assert 0 < summary.efficiency <= 1
    assert summary.failures == ()


def test_the_store_holds_what_solve_tile_gives(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    atlas.run(plane, tmp_path / "out.zarr", client=client)
    whole = plane.cell_params((slice(0, 5), slice(0, 7)))
    expected = workers.solve_tile(plane.system, whole, plane.settings)
    ds = atlas.open(tmp_path / "out.zarr")
    for name, values in expected.items():
        np.testing.assert_array_equal(ds[name].values, values, err_msg=name, strict=True)


@pytest.mark.parametrize("tile", [(1, 1), (5, 7), (4, 3)])
def test_arrays_do_not_depend_on_the_tile_shape(
    solved_plane: Path, tmp_path: Path, client: Client, tile: tuple[int, int]
) -> None:
    atlas.run(plane_of(tile), tmp_path / "b.zarr", client=client)
    assert arrays_of(solved_plane) == arrays_of(tmp_path / "b.zarr")


def test_arrays_do_not_depend_on_the_number_of_workers(solved_plane: Path, tmp_path: Path) -> None:
    """The client of all tests has two threads."""
    with (
        LocalCluster(processes=False, n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as single,
    ):
        atlas.run(plane_of(), tmp_path / "one.zarr", client=single)
    assert arrays_of(tmp_path / "one.zarr") == arrays_of(solved_plane)


def test_cells_of_a_tile_do_not_depend_on_their_neighbours_or_order(plane: atlas.Spec) -> None:
    params = plane.cell_params((slice(0, 5), slice(0, 7)))
    whole = workers.solve_tile(plane.system, params, plane.settings)
    omega, b = (grid.ravel() for grid in np.broadcast_arrays(params["omega"], params["b"]))
    order = list(range(omega.size))
    random.Random(1).shuffle(order)
    shuffled = workers.solve_tile(plane.system, params | {"omega": omega[order], "b": b[order]}, plane.settings)
    for place, cell in enumerate(order):
        alone = workers.solve_tile(plane.system, params | {"omega": omega[cell], "b": b[cell]}, plane.settings)
        for name, values in whole.items():
            one = values.reshape(35, *values.shape[2:])[cell]
            np.testing.assert_array_equal(alone[name], one, err_msg=name)
            np.testing.assert_array_equal(shuffled[name][place], one, err_msg=name)


def test_a_sweep_has_one_dimension(tmp_path: Path, client: Client) -> None:
    spec = atlas.Spec("two-mass", axes={"omega": [2.0, 3.0, 4.0]}, solve={"max_periods": 200})
    atlas.run(spec, tmp_path / "out.zarr", client=client)
    assert atlas.open(tmp_path / "out.zarr").regime.dims == ("omega",)


def test_going_on_solves_only_what_is_missing(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    store = tmp_path / "out.zarr"
    atlas.run(plane, store, client=client)
    whole = arrays_of(store)
    for chunk in ("0/0", "2/1"):
        (store / "regime" / "c" / chunk).unlink()
    kept = {path: path.stat().st_mtime_ns for path in (store / "regime" / "c").rglob("*") if path.is_file()}
    summary = atlas.run(plane, store, client=client)
    assert (summary.tiles_solved, summary.tiles_done) == (2, 9)
    assert arrays_of(store) == whole
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_the_tile_shape_of_the_store_wins_when_going_on(tmp_path: Path, client: Client) -> None:
    atlas.run(plane_of((2, 3)), tmp_path / "out.zarr", client=client)
    (tmp_path / "out.zarr" / "regime" / "c" / "0" / "0").unlink()
    assert atlas.run(plane_of((5, 7)), tmp_path / "out.zarr", client=client).tiles_solved == 1


def test_a_complete_store_needs_no_cluster(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    atlas.run(plane, tmp_path / "out.zarr", client=client)
    told: list[Progress] = []
    summary = atlas.run(plane, tmp_path / "out.zarr", options=atlas.RunOptions(on_progress=told.append))
    assert (summary.tiles_solved, summary.tiles_done) == (0, 9)
    assert not any("worker" in progress.stage for progress in told)


def test_a_client_passed_is_left_open(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    atlas.run(plane, tmp_path / "out.zarr", client=client)
    assert client.status == "running"
    assert client.submit(sum, [1, 2]).result() == 3


def test_progress_ends_with_every_cell_done(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    told: list[Progress] = []
    atlas.run(plane, tmp_path / "out.zarr", client=client, options=atlas.RunOptions(on_progress=told.append))
    assert (told[-1].cells_done, told[-1].tiles_done) == (35, 9)
    assert [p.cells_done for p in told] == sorted(p.cells_done for p in told)


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "probed"), [(CELLS, False), (CELLS + 1, True)])
def test_a_run_is_probed_only_where_a_probe_would_not_solve_all_of_it(
    tmp_path: Path, client: Client, cells: int, probed: bool
) -> None:
    spec = atlas.Spec("two-mass", {"omega": {"start": 2.0, "stop": 4.0, "num": cells}}, {"b": 5.0})
    told: list[Progress] = []
    atlas.run(spec, tmp_path / "out.zarr", client=client, on_progress=with_time(told.append))
    plan = next(progress.plan for progress in told if progress.plan)
    assert (plan.probe is not None) == probed


def test_a_terminal_shows_speed_and_regimes(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen = Terminal()
    with reporter(screen) as show:
        summary = atlas.run(plane, tmp_path / "out.zarr", client=client, options=atlas.RunOptions(on_progress=show))
    assert "9 tiles of 2 x 3" in screen.getvalue()
    assert "cells/s" in screen.getvalue()
    assert max(summary.counts, key=summary.counts.__getitem__) in screen.getvalue()


def test_a_log_gets_plain_lines_at_intervals(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    log = io.StringIO()
    with LogReporter(log, interval=0.0) as show:
        atlas.run(plane, tmp_path / "out.zarr", client=client, options=atlas.RunOptions(on_progress=show))
    assert "\x1b" not in log.getvalue()
    assert log.getvalue().splitlines()[-1].startswith("solving: 9/9 tiles, 35/35 cells, ")


def test_a_tile_that_raises_is_reported_and_the_others_finish(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = solving.solve_tile

    def broken(system, params, settings):  # type: ignore[no-untyped-def]
        if 2.0 in params["omega"] and 0.1 in params["b"]:
            raise ZeroDivisionError("two\nlines")
        return whole(system, params, settings)

    monkeypatch.setattr(solving, "solve_tile", broken)
    summary = atlas.run(plane, tmp_path / "out.zarr", client=client)
    assert [(failure.index, failure.message) for failure in summary.failures] == [
        ((0, 0), "ZeroDivisionError: two lines")
    ]
    assert summary.tiles_done == 8
    assert len(done_tiles(open_store(tmp_path / "out.zarr"))) == 8


def test_the_summary_says_how_many_cells_are_invalid_and_why(tmp_path: Path, client: Client) -> None:
    """Truth: with b from 0.1 to 0.5, the mass starts beyond a stop in the rows of b = 0.1 and 0.2."""
    summary = atlas.run(plane_of(x1=0.25), tmp_path / "out.zarr", client=client)
    assert summary.reasons == {"the initial state lies beyond a stop": 14}
    assert "14 invalid cells: the initial state lies beyond a stop" in str(summary).splitlines()


def test_an_interrupt_leaves_no_task_on_the_callers_cluster(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    def interrupt(progress: Progress) -> None:
        if progress.tiles_done == 2 and progress.stage == "solving":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atlas.run(plane, tmp_path / "out.zarr", client=client, options=atlas.RunOptions(on_progress=interrupt))
    assert not [key for key in client.futures if str(key).startswith("tile-")]
    assert atlas.run(plane, tmp_path / "out.zarr", client=client).tiles_done == 9


def test_what_a_killed_run_left_half_made_is_cleared_away(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    left = tmp_path / f".out.zarr.{uuid4().hex}.partial"
    left.mkdir()
    (left / "zarr.json").write_text("{}")
    atlas.run(plane, tmp_path / "out.zarr", client=client)
    assert [path.name for path in tmp_path.iterdir()] == ["out.zarr"]


def test_a_lost_scheduler_ends_the_run(tmp_path: Path, plane: atlas.Spec) -> None:
    with LocalCluster(processes=False, n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        lost = Client(cluster, set_as_default=False)

        def lose(progress: Progress) -> None:
            if progress.tiles_done == 1:
                cluster.close()

        with pytest.raises(RunError, match="the cluster was lost"):
            atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client=lost, options=atlas.RunOptions(on_progress=lose))
        lost.close()


def run_in_task(spec: atlas.Spec, store: str) -> tuple[int, int, list[str]]:
    """A run within a task of Dask: its tiles, its workers, and what it reported."""
    told: list[str] = []
    options = atlas.RunOptions(on_progress=lambda progress: told.append(str(progress)))
    summary = atlas.run(spec, store, options=options)
    get_client().close()  # else it looks for its scheduler until this process ends
    return summary.tiles_done, summary.workers, told


def test_a_run_within_a_dask_task_uses_the_cluster_of_the_task(tmp_path: Path, plane: atlas.Spec) -> None:
    """Of one thread, which the task leaves to the tiles; processes of its own a worker cannot always start."""
    with (
        LocalCluster(processes=False, n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as outer,
    ):
        tiles, workers, told = outer.submit(run_in_task, plane, str(tmp_path / "out.zarr")).result(timeout=120)
        assert outer.submit(sum, [1, 2]).result(timeout=30) == 3  # the thread is back
    assert (tiles, workers) == (9, 1)
    assert any("using the active Dask client" in text for text in told)
    assert not any("starting" in text and "worker" in text for text in told)


def test_a_daemonic_process_says_that_it_cannot_start_workers(
    tmp_path: Path, plane: atlas.Spec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a Dask worker's, which is no script without a __main__ guard."""
    daemon = SimpleNamespace(daemon=True)
    monkeypatch.setattr("atlas.service.cluster.multiprocessing.current_process", lambda: daemon)
    with pytest.raises(InputError, match=r"^workers: found 2, cannot be started by a daemonic process") as caught:
        atlas.run(plane, tmp_path / "out.zarr", options=atlas.RunOptions(workers=2))
    assert "__main__" not in str(caught.value) and list(tmp_path.iterdir()) == []


def test_a_cluster_given_as_a_client_is_told_how_to_have_one(tmp_path: Path, plane: atlas.Spec) -> None:
    with (
        LocalCluster(processes=False, n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        pytest.raises(
            InputError, match=r"^client: found LocalCluster.* must be a Dask client; .*cluster.get_client\(\)$"
        ),
    ):
        atlas.run(plane, tmp_path / "out.zarr", cluster)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_memory_and_pauses_of_all_workers_are_looked_at() -> None:
    """A client of distributed 2025.4 to 2026.3 lists five workers unless it is asked for all."""
    workers = [f"tcp://127.0.0.1:{k}" for k in range(8)]
    assert list(worker_memory(Cluster(workers, lambda worker, job: 1.0))) == workers  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "given", [{"workers": 0}, {"workers": 10**20}, {"workers": 2, "scheduler": "tcp://127.0.0.1:1"}]
)
def test_workers_that_make_no_sense_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="workers: found"):
        atlas.RunOptions(**given)


def test_more_workers_than_any_machine_has_are_refused_in_one_line(tmp_path: Path) -> None:
    shown = CliRunner().invoke(main, ["run", "tiny", "-o", str(tmp_path / "out.zarr"), "--workers", str(10**20)])
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert "--workers" in shown.stderr and "1024" in shown.stderr
    assert list(tmp_path.iterdir()) == []


def test_workers_of_this_machine_do_not_go_with_a_client(tmp_path: Path, plane: atlas.Spec, client: Client) -> None:
    with pytest.raises(InputError, match="workers: found 2, applies to a local cluster only"):
        atlas.run(plane, tmp_path / "out.zarr", client, atlas.RunOptions(workers=2))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("given", [{"patience": -1.0}, {"patience": float("nan")}])
def test_a_patience_that_is_no_time_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="patience: found"):
        atlas.RunOptions(**given)


@pytest.mark.slow
def test_a_script_without_a_main_guard_is_refused_with_the_remedy(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import atlas\n"
        'spec = atlas.Spec("two-mass", axes={"omega": [2.0, 3.0]}, solve={"max_periods": 50})\n'
        f"atlas.run(spec, {str(tmp_path / 'out.zarr')!r}, options=atlas.RunOptions(workers=1))\n"
    )
    ended = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 1
    assert 'if __name__ == "__main__":' in ended.stderr.splitlines()[-1]


@pytest.mark.slow
def test_the_memory_of_a_worker_is_its_own_and_not_that_of_the_process_that_started_it() -> None:
    ballast = np.ones(100_000_000)
    child = [sys.executable, "-c", "from atlas.platform import peak_memory; print(peak_memory())"]
    own = int(subprocess.run(child, capture_output=True, text=True, check=True, cwd=ROOT).stdout)
    assert 20e6 < own < ballast.nbytes < peak_memory()


def test_an_overview_that_fails_on_a_worker_is_told_and_made_at_the_end(
    tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, make, failures = spec_of(200, 2), Pyramid.build_chunk, iter([ValueError("no such codec")])

    def failing(pyramid: Pyramid, level: int, index: tuple[int, ...]) -> None:
        for failure in failures:
            raise failure
        make(pyramid, level, index)

    handle = create.create_store(tmp_path / "out.zarr", spec, (2, 200))
    fill(handle)
    monkeypatch.setattr(Pyramid, "build_chunk", failing)
    notes = list[str]()
    atlas.run(spec, handle.path, client, on_progress=lambda progress: notes.append(progress.note))
    told = "overview 1, chunk (0, 0): no such codec; this process builds it at the end"
    assert [note for note in notes if note] == [told]
    assert Pyramid(handle).stored(1, REGIME) == {(0, 0)}
