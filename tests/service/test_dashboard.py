"""What Dask shows of the workers: a dashboard of local clusters, whose address is said, and a performance report."""

import io
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.cli.progress import LogReporter, TerminalReporter
from atlas.errors import InputError
from atlas.service import clients, cluster
from atlas.service.clients import start_client
from atlas.service.cluster import local_cluster
from atlas.service.notebook import NotebookReporter
from atlas.service.progress import Progress
from tests.paths import ROOT
from tests.planes import plane_of

NOTED = Progress("starting", note="dashboard of the workers: http://127.0.0.1:8787/status")


def start(count: int = 1, **options: bool) -> tuple[list[str], str]:
    """What is noted when workers are started, and what a page of their cluster's dashboard says: its title or code."""
    seen: list[Progress] = []
    with ExitStack() as stack:
        client = start_client(None, count, atlas.RunOptions(on_progress=seen.append, **options), stack)
        try:
            page = urlopen(client.dashboard_link, timeout=60).read().decode()
        except HTTPError as error:
            with error:
                page = str(error.code)
        assert not count or client.submit(sum, [1, 2]).result() == 3
        notes = [progress.note.replace(client.dashboard_link, "LINK") for progress in seen if progress.note]
    return notes, page


def test_the_dashboard_of_a_local_cluster_is_on_and_its_link_is_said_in_one_line() -> None:
    notes, page = start()
    assert notes == ["dashboard of the workers: LINK"]
    assert "<title>Dask" in page


def test_without_a_dashboard_nothing_is_served_or_said() -> None:
    assert start(0, dashboard=False) == ([], "404")


def test_a_cluster_that_nobody_asked_a_dashboard_of_has_none() -> None:
    """Such as the explorer's, whose page has a port already."""
    with local_cluster(0) as client, pytest.raises(HTTPError, match="404") as refused:
        urlopen(client.dashboard_link, timeout=60)
    refused.value.close()


def test_where_bokeh_is_missing_a_cluster_starts_without_a_dashboard(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (cluster, clients):
        monkeypatch.setattr(module, "has_dashboard", lambda: False)
    assert start() == ([], "404")


def test_a_link_that_cannot_be_formed_is_left_out() -> None:
    """``distributed.dashboard.link`` may name what only a hub's environment has."""

    class Hub:
        @property
        def dashboard_link(self) -> str:
            return "{JUPYTERHUB_USER}".format(**{})

    assert cluster.dashboard_link(Hub()) == ""  # type: ignore[arg-type]
    assert cluster.dashboard_link(SimpleNamespace(dashboard_link=None)) == ""  # type: ignore[arg-type]


PORT = """
import sys
from atlas.service import cluster
cluster.DASHBOARD = sys.argv[1]
with cluster.local_cluster(0, dashboard=True) as client:
    print(cluster.dashboard_link(client))
"""


def test_a_port_that_is_taken_is_no_fault_and_nothing_warns() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [sys.executable, "-c", PORT, f"127.0.0.1:{port}"]
        ended = subprocess.run(words, cwd=ROOT, capture_output=True, encoding="utf-8", timeout=600)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith("http://127.0.0.1:") and f":{port}/" not in ended.stdout


def test_a_note_stays_in_sight_in_a_log_a_terminal_and_a_notebook() -> None:
    for kind in (LogReporter, TerminalReporter):
        screen = io.StringIO()
        with kind(screen) as show:
            show(Progress("starting"))
            show(NOTED)
            show(Progress("solving"))
        assert NOTED.note in screen.getvalue().splitlines()
    cells: list[str] = []
    handle = SimpleNamespace(update=lambda bar: cells.append(bar._repr_html_()))
    with NotebookReporter(lambda *_, **__: handle, interval=0.0) as note:
        for progress in (Progress("starting"), NOTED, Progress("solving")):
            note(progress)
    assert f"<div>{NOTED.note}</div>" in cells[-1] and "solving" in cells[-1]


def test_a_run_writes_a_performance_report_that_needs_no_network(tmp_path: Path, client: Client) -> None:
    report = tmp_path / "report.html"
    summary = atlas.run(plane_of(), tmp_path / "out.zarr", client, performance_report=report)
    text = report.read_text(encoding="utf-8")
    assert summary.tiles_done == 9
    assert "Dask Performance Report" in text and "number of tasks: " in text
    assert "cdn.bokeh.org" not in text.partition("<body")[0]


def test_a_report_that_cannot_be_written_at_the_end_is_told_and_the_run_is_kept(tmp_path: Path, client: Client) -> None:
    path, seen = tmp_path / "report.html", list[Progress]()

    def note(progress: Progress) -> None:
        seen.append(progress)
        if progress.stage == "solving":
            path.mkdir(exist_ok=True)

    summary = atlas.run(plane_of(), tmp_path / "out.zarr", client, performance_report=path, on_progress=note)
    assert summary.tiles_done == 9
    (told,) = [progress.note for progress in seen if progress.note]
    assert told.startswith(f"performance report {path}: not written (IsADirectoryError")


def test_a_report_that_nobody_could_write_is_refused_before_anything_is_done(
    tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in (tmp_path, tmp_path / "nowhere" / "report.html"):
        with pytest.raises(
            InputError, match=r"performance_report .*: cannot be written; give a file in an existing folder"
        ):
            atlas.RunOptions(performance_report=path)
    for name, given in (("performance_report", 3), ("dashboard", "no"), ("storage_options", "anon")):
        with pytest.raises(InputError, match=f"{name}: found {given!r}, must be"):
            atlas.RunOptions(**{name: given})
    with pytest.raises(InputError, match="performance_report: is about workers"):
        atlas.RunOptions(performance_report=tmp_path / "report.html", tile=(0, 0))
    for module in (cluster, clients):
        monkeypatch.setattr(module, "has_dashboard", lambda: False)
    with pytest.raises(InputError, match="needs Bokeh on the scheduler's host"):
        atlas.run(plane_of(), tmp_path / "out.zarr", client, performance_report=tmp_path / "report.html")
    words = ["run", "tiny", "-o", str(tmp_path / "b.zarr"), "--performance-report", str(tmp_path / "no" / "r.html")]
    shown = CliRunner().invoke(main, words)
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert list(tmp_path.iterdir()) == []
