"""What a package needs to run on Windows and macOS too, as far as Linux can show it."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import pytest

import atlas
from atlas import platform
from atlas.errors import InputError
from atlas.store import create, object_backend
from atlas.store.object_backend import LocalBackend, is_url, open_backend
from atlas.store.zarr_backend import ZarrBackend
from tests.paths import ROOT

APART = "atlas/platform.py"
"""The one file that may do different things on different systems."""
MODULES = {
    "crypt", "curses", "fcntl", "grp", "nis", "ossaudiodev", "posix", "pty", "pwd", "readline", "resource", "spwd",
    "syslog", "termios", "tty", "_posixsubprocess",  # not on Windows
    "msvcrt", "winreg", "winsound", "_winapi", "nt", "ntpath", "posixpath",  # only there, or of one system's paths
}  # fmt: skip
NAMES = {
    "os": """chown chroot ctermid fchmod fchown fork forkpty fpathconf getegid geteuid getgid getgroups getloadavg
        getpgid getpgrp getpriority getresuid getsid getuid initgroups kill killpg lchown link_at lockf major makedev
        mkfifo mknod nice openpty pathconf pipe2 posix_fadvise posix_fallocate posix_spawn posix_spawnp pread preadv
        pwrite pwritev sched_getaffinity sched_setaffinity sched_yield sendfile setegid seteuid setgid setpgid
        setpriority setsid setuid statvfs fstatvfs sync sysconf tcgetpgrp tcsetpgrp uname wait wait3 wait4 waitid
        waitpid O_CLOEXEC O_DIRECT O_DIRECTORY O_DSYNC O_NOCTTY O_NOFOLLOW O_NONBLOCK O_SYNC""",
    "signal": """SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGIO SIGKILL SIGPIPE SIGPROF SIGQUIT SIGSTOP SIGSYS SIGTSTP
        SIGUSR1 SIGUSR2 SIGWINCH alarm getitimer pause pthread_kill pthread_sigmask setitimer siginterrupt sigpending
        sigtimedwait sigwait sigwaitinfo""",
    "socket": "AF_UNIX fromfd_unix recv_fds send_fds socketpair_unix",
    "time": "clock_settime pthread_getcpuclockid tzset",
    "select": "epoll kqueue poll",
    "multiprocessing": "set_start_method",
    "threading": "pthread_getcpuclockid",
}
FOLDERS_OF_POSIX = ("/proc", "/bin/", "/dev/", "/usr/", "/tmp", "/etc", "/sys/")


def sources() -> list[Path]:
    return sorted(path for package in ("atlas", "workers") for path in (ROOT / package).rglob("*.py"))


def faults(tree: ast.AST) -> Iterator[str]:
    """Imports, at any depth, of modules that another system lacks, and uses of names that it lacks."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.partition(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            module = node.module or ""
            if module.partition(".")[0] in MODULES:
                yield module
            yield from (f"{module}.{name.name}" for name in node.names if name.name in NAMES.get(module, "").split())
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in NAMES.get(node.value.id, "").split():
                yield f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(FOLDERS_OF_POSIX):
            yield node.value


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import fcntl", "fcntl"),
        ("def f():\n    from resource import getrusage", "resource"),
        ("import os\nif os.fork(): pass", "os.fork"),
        ("from signal import SIGKILL", "signal.SIGKILL"),
        ("def f(): return Path('/proc/self/status')", "/proc/self/status"),
        ("import os\nhasattr(os, 'x') and os.getuid()", "os.getuid"),
    ],
)
def test_the_search_finds_what_other_systems_lack(source: str, found: str) -> None:
    assert list(faults(ast.parse(source))) == [found]


def test_no_file_uses_a_module_or_name_that_a_system_lacks() -> None:
    found = {path.relative_to(ROOT).as_posix(): [*faults(ast.parse(path.read_text("utf-8")))] for path in sources()}
    assert [name for name, lacking in found.items() if lacking] == [APART]


def test_the_platform_asks_which_system_it_is_on_before_it_uses_what_another_lacks() -> None:
    """Outside the branches for Linux, and after those for Windows, only POSIX: getrusage, poll, sigmask."""
    tree = ast.parse((ROOT / APART).read_text(encoding="utf-8"))
    for node in list(ast.walk(tree)):
        for field, value in ast.iter_fields(node):
            if isinstance(value, list):
                kept = [
                    one for one in value if not (isinstance(one, ast.If) and "sys.platform" in ast.unparse(one.test))
                ]
                setattr(node, field, kept)
    assert list(faults(tree)) == ["resource", "select.poll", "signal.pthread_sigmask", "signal.pthread_sigmask"]


@pytest.mark.slow
@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_the_types_hold_with_what_the_standard_library_has_there(system: str, tmp_path: Path) -> None:
    """typeshed knows which names exist on which system: an honest look at one that is not here."""
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--platform", system, "--cache-dir", str(tmp_path), "atlas", "workers"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


# Names of paths


@pytest.mark.parametrize(
    "name", [r"C:\data\plane.zarr", "C:/data/plane.zarr", "C:plane.zarr", "c://plane.zarr", r"\\host\disk\a"]
)
def test_a_path_of_windows_is_no_url(name: str) -> None:
    assert not is_url(name)
    assert isinstance(open_backend(name), LocalBackend)


@pytest.mark.parametrize("name", ["s3://bucket/plane.zarr", "file:///data/plane.zarr", "https://host/plane.zarr"])
def test_a_scheme_of_two_letters_or_more_makes_a_url(name: str) -> None:
    assert is_url(name)


def test_a_file_url_may_have_spaces_and_accents() -> None:
    assert open_backend("file:///data/un%20plan%20%C3%A9toil%C3%A9.zarr") == LocalBackend(
        Path("/data/un plan étoilé.zarr")
    )


@pytest.mark.parametrize("path", [PurePosixPath("/a b/é.zip"), PureWindowsPath("C:/a b/é.zip")])
def test_an_archive_is_known_by_its_suffix_in_the_paths_of_both_systems(path: PurePosixPath) -> None:
    assert isinstance(object_backend._place_at(Path(path.as_posix())), ZarrBackend)


NAMES_OF_FOLDERS = ("my atlases (2nd try)", "étude – Übergänge, 混沌", "a[1]{b}*?'$&;#%20", *["x" * 55] * 5)


def test_an_atlas_lives_below_folders_with_spaces_accents_brackets_and_more_than_260_characters(tmp_path: Path) -> None:
    """Made by a worker process, resumed, drawn, exported and packed."""
    folder = tmp_path.joinpath(*NAMES_OF_FOLDERS)
    folder.mkdir(parents=True)
    store = folder / "plane of a machine.zarr"
    axes = {"omega": {"values": [2.0, 3.0]}, "b": {"values": [0.2, 0.4]}}
    spec = atlas.Spec("two-mass", axes, solve={"max_periods": 50}, store={"tile": [2, 2]})
    first = atlas.run(spec, store, workers=1)
    assert first.tiles_done == 1
    assert atlas.run(spec, store, workers=1).periods == 0  # nothing is solved again
    ds = atlas.open(store)
    ds.atlas.plot("exponent").savefig(folder / "map é.png")
    packed = atlas.pack(store, folder / "plane é.zip")
    assert np.array_equal(atlas.open(packed.file)["regime"], ds["regime"])
    assert {path.name for path in folder.iterdir()} == {store.name, "map é.png", "plane é.zip"}


def test_a_name_that_is_too_long_for_the_disk_is_bad_input(tmp_path: Path) -> None:
    spec = atlas.Spec("two-mass", {"omega": {"values": [2.0, 3.0]}})
    with pytest.raises(InputError, match="cannot be"):
        atlas.run(spec, tmp_path / ("x" * 300), workers=1)


# Disks that ignore case

_ONE_MASS = """
[system]
name = "cases"
coordinates = ["x"]
mass = [["m"]]
damping = [[0.1]]
stiffness = [["M"]]
force = [1.0]
gap = [1.0]
upper = 1.0
restitution = 0.5
[system.parameters]
m = { default = 1.0 }
M = { default = 2.0 }
"""


@pytest.fixture
def two_cases() -> atlas.Spec:
    from workers import System

    return atlas.Spec(System.from_toml(_ONE_MASS), {"m": {"values": [1.0, 2.0]}, "M": {"values": [3.0, 4.0]}})


def test_names_that_differ_by_case_alone_are_two_arrays_where_the_disk_knows_case(
    two_cases: atlas.Spec, tmp_path: Path
) -> None:
    create.make_store(open_backend(tmp_path / "plane.zarr"), two_cases, (2, 2), None, "0" * 32)
    ds = atlas.open(tmp_path / "plane.zarr")
    assert ds["m"].values.tolist() == [1.0, 2.0]
    assert ds["M"].values.tolist() == [3.0, 4.0]


def test_names_that_differ_by_case_alone_are_refused_on_a_disk_that_ignores_case(
    two_cases: atlas.Spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exists = Path.exists
    folded = lambda path: any(one.name.casefold() == path.name.casefold() for one in path.parent.iterdir())  # noqa: E731
    monkeypatch.setattr(Path, "exists", lambda path: exists(path) or (exists(path.parent) and folded(path)))
    with pytest.raises(
        InputError, match=r"the file system ignores case, so [mM] and [mM] collide; rename [mM] in the system"
    ):
        create.make_store(open_backend(tmp_path / "plane.zarr"), two_cases, (2, 2), None, "0" * 32)
    monkeypatch.undo()
    assert not list(tmp_path.iterdir())


# What Linux can only pretend


@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_elsewhere_a_process_has_a_name_of_four_words_which_tells_the_living_from_the_dead(
    system: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """psutil's part, which is the same code on all systems."""
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    monkeypatch.setattr(sys, "platform", system)
    try:
        name = platform.process_name(child.pid)
        assert len(name.split()) == 4
        assert platform.is_running(child.pid, name) is True
        assert platform.is_running(child.pid, name.rpartition(" ")[0] + " 1.000000") is False
    finally:
        child.communicate(b"\n")
    assert platform.is_running(child.pid, name) is False


def test_a_system_without_affinity_counts_all_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert platform.processors() == os.cpu_count()


# Text


def test_a_pipe_gets_utf_8_whatever_the_system_s_own_encoding_is() -> None:
    """Windows gives a pipe the code page of the language; PYTHONIOENCODING makes the same here."""
    environment = os.environ | {"PYTHONIOENCODING": "cp1252", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "atlas", "plan", "混沌.toml"]
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert done.stderr.decode("utf-8").rstrip() == "Error: 混沌.toml: no such file"
    assert done.returncode == 2
