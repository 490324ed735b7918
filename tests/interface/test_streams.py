"""What commands do where nobody reads them: closed pipes, closed streams, Ctrl-C while they begin."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from atlas.cli.main import main
from atlas.cli.output import print_table
from atlas.cli.progress import LogReporter
from atlas.service.progress import Progress
from tests.paths import ROOT
from tests.support.faults import ATLAS

ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
UNBUFFERED = ENVIRONMENT | {"PYTHONUNBUFFERED": "1"}


def begun(*words: object, **streams: object) -> subprocess.Popen[str]:
    options = {"env": ENVIRONMENT, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | streams
    return subprocess.Popen([*ATLAS, *map(str, words)], **options)  # type: ignore[call-overload,no-any-return]


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """The exit code of a command and its errors."""
    _, errors = process.communicate(timeout=120)
    return process.returncode, errors


@pytest.fixture
def unread() -> int:
    """The end of a pipe that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    return writer


def test_a_command_whose_output_nobody_reads_ends_with_0_and_says_nothing_of_it(
    unread: int, solved_plane: Path
) -> None:
    """As ``head`` leaves it. Tables, plain text and help are written in different ways."""
    lines = [["query", solved_plane], ["example", "tiny"], ["--help"]]
    running = [begun(*words, stdout=unread) for words in lines]
    running.append(begun("query", solved_plane, stdout=unread, env=UNBUFFERED))
    for process in running:
        code, errors = ended(process)
        assert (code, errors.replace("0 chunks read from the store\n", "")) == (0, ""), process.args


def test_a_broken_pipe_that_is_not_its_output_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection, say: the answer is not there, and its reader is."""

    def broken(name: str) -> str:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("atlas.cli.begin.example_text", broken)
    monkeypatch.setattr("atlas.platform.is_unread", lambda stream: False)
    done = CliRunner().invoke(main, ["example", "tiny"])
    assert (done.exit_code, done.stderr) == (1, "Error: Broken pipe\n")


def test_work_goes_on_where_nobody_reads_its_progress(unread: int) -> None:
    with os.fdopen(unread, "w", buffering=1) as log, LogReporter(log) as show:
        show(Progress("solving"))
        show(Progress("writing"))
        os.dup2(os.open(os.devnull, os.O_WRONLY), unread)


@pytest.mark.parametrize("closed", [">&-", "2>&-"])
def test_a_command_without_a_stream_ends_as_with_one(closed: str) -> None:
    line = ["sh", "-c", f'"$@" {closed}', "sh", *ATLAS, "systems"]
    done = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_ctrl_c_while_the_command_is_imported_ends_it_in_order() -> None:
    """The signal comes in the middle of an import, as it does in the first half of a second."""
    code = f"""
import os, runpy, signal, sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            os.kill(os.getpid(), {int(signal.SIGINT)})
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupting())
sys.argv = ["atlas", "systems"]
runpy.run_module("atlas", run_name="__main__")
"""
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_lines_of_a_table_have_no_spaces_at_their_ends_and_are_not_broken(
    capsys: pytest.CaptureFixture[str],
) -> None:
    long = "a reason of many words " * 20
    print_table("", ["", ""], [("reason", long), ("regime", "periodic")])
    assert capsys.readouterr().out == f"reason  {long.rstrip()}\nregime  periodic\n"
