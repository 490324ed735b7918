"""Options that commands share, and functions that read and check the texts of options."""

import math
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import click
from click.core import ParameterSource

from atlas.errors import ChunkError, InputError, NetworkError, brief_repr
from atlas.service.cluster import Tls
from atlas.service.options import MAX_WORKERS, RunOptions
from atlas.service.timing import TIMING, Timing
from atlas.store.object_backend import StoreBackend, is_url, open_backend

if TYPE_CHECKING:
    import xarray as xr

PLACE = click.Path(readable=False)
"""Type of an argument that is a path, a URL or the name of an example. It is not checked; the shell completes paths."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
_T = TypeVar("_T")

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, and nothing else.")
workers_option = click.option(
    "--workers", type=click.IntRange(1, MAX_WORKERS), help="Worker processes on this host; default: one per processor."
)
scheduler_option = click.option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, such as tcp://host:8786.")
_FILE: dict[str, Any] = {"type": PLACE, "metavar": "FILE"}
Numbers: TypeAlias = dict[str, float]
Bounds: TypeAlias = dict[str, tuple[float, float]]
"""Type of an option's values by name: Numbers if given as NAME=VALUE, Bounds if given as NAME=LOW:HIGH."""
spec_argument = click.argument("spec", type=PLACE)


def out_option(words: str, required: bool = False) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds the option -o, a file or a folder to write, with the help text ``words``."""
    return click.option("-o", "--out", type=click.Path(path_type=Path), required=required, help=words)


picture_option = out_option("The picture; the suffix chooses the format.", required=True)


def pairs_option(
    name: str, metavar: str, words: str, read: Callable[[str, str], Any], *dest: str
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds a repeatable option NAME=VALUE; the command receives a dict.

    name     name of the option
    metavar  form of its value in the help
    words    help text
    read     function that converts a value, called with the text that names it in messages and its own text
    dest     parameter of the command, by default from the name
    """

    def callback(ctx: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, Any]:
        return read_pairs(name, pairs, read)

    return click.option(name, *dest, metavar=metavar, multiple=True, callback=callback, help=words)


def storage_option(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with the option --storage-option, access options for URLs.

    If the option is given, the command receives backends in place of its URLs, which open in the same way. Raise
    InputError if the option is given and the command has no URL.
    """

    @pairs_option(
        "--storage-option",
        "KEY=VALUE",
        "Access option of a URL, such as endpoint=URL or anon=true; repeatable.",
        lambda _, value: value,
    )
    @wraps(command)
    def wrapper(*args: Any, storage_option: Mapping[str, str], **arguments: Any) -> None:
        def open_url(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(open_url, value))
            is_remote = is_url(value) and not value.startswith("file:")
            return open_backend(value, storage_options=storage_option) if is_remote else value

        if storage_option:
            given, arguments = arguments, {name: open_url(value) for name, value in arguments.items()}
            if arguments == given:
                raise InputError("--storage-option: sets the access of a store at a URL, found no URL of a server")
        command(*args, **arguments)

    return wrapper


def store_argument(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with the argument STORE, a path or a URL, and with the option --storage-option."""
    return click.argument("store", type=PLACE)(storage_option(command))


def figure_options(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds the options of a picture's layout and limits, except for those in ``without``."""
    options = {
        "width": click.option(
            "--width", metavar="LENGTH", help="Width of the picture: 85mm, 8.5cm, 3.35in; default: 7in."
        ),
        "height": click.option("--height", metavar="LENGTH", help="Height of the picture; default: by the width."),
        "font_size": click.option("--font-size", type=float, metavar="POINTS", help="Font size."),
        "dpi": click.option("--dpi", type=float, help="Dots per inch; default: 300."),
        "vmin": click.option("--vmin", type=float, help="Lower colour limit, to share limits between pictures."),
        "vmax": click.option("--vmax", type=float, help="Upper colour limit."),
        "title": click.option("--title/--no-title", default=True, help="Print the fixed parameters above the picture."),
        "legend": click.option("--legend/--no-legend", default=True, help="Draw the legend."),
        "style": click.option(
            "--style", metavar="FILE", help="A matplotlib style: a file, a name, or current: your matplotlibrc."
        ),
    }

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for name in reversed([name for name in options if name not in without]):
            command = options[name](command)
        return command

    return decorate


def examples(*lines: str) -> str:
    """Return example command lines as the last part of a command's help."""
    return _as_it_stands("Examples:", lines)


def meanings(title: str, words: Mapping[str, str]) -> str:
    """Return names and their meanings as a part of a command's help, with a title."""
    width = max(map(len, words))
    return _as_it_stands(title, [f"{name:{width}}  {meaning}" for name, meaning in words.items()])


def _as_it_stands(title: str, lines: Iterable[str]) -> str:
    return "\b\n" + "\n".join([title, *(f"  {line}" for line in lines)])  # \b keeps click from filling the lines


def options_given(context: click.Context) -> Iterator[click.Parameter]:
    """Yield those options and arguments of a command that the user gave on the command line."""
    for option in context.command.params:
        if context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE:
            yield option


def open_selection(store: str | StoreBackend, selection: Mapping[str, float]) -> "xr.Dataset":
    """Open the atlas of a STORE at the given values of some of its axes.

    If a value lies between two cells, the nearest cell is taken, and a line about it is printed.
    """
    from atlas.query.open import open_atlas
    from atlas.query.window import select

    ds = select(open_atlas(store), selection)
    for name, value in selection.items():
        if name in ds.coords and not math.isclose(nearest := float(ds[name]), value, rel_tol=1e-9):
            print_status(f"{name} = {nearest:.10g}, the nearest to {value:.10g}")
    return ds


def print_status(text: str) -> None:
    """Print a line for the user on stderr; do nothing if the reader of a pipe has gone."""
    with suppress(BrokenPipeError):
        click.echo(text, err=True)


def timing_of(ctx: click.Context) -> Timing:
    """Return the waiting times of a command: the times that a caller in Python passes as click's ``obj``, or the
    defaults.
    """
    return ctx.find_object(Timing) or TIMING


def worker_options(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with the options of its workers: --scheduler, files for TLS, --workers and --dashboard.

    The command receives them as ``RunOptions``.
    """

    @scheduler_option
    @click.option("--tls-ca-file", **_FILE, help="Authority of a tls:// scheduler; default: Dask's configuration.")
    @click.option("--tls-cert", **_FILE, help="This program's certificate.")
    @click.option("--tls-key", **_FILE, help="The key of that certificate.")
    @workers_option
    @click.option("--dashboard/--no-dashboard", default=True, help="Serve Dask's dashboard; needs Bokeh.")
    @click.pass_context
    @wraps(command)
    def wrapper(ctx: click.Context, /, scheduler: Any, workers: Any, dashboard: bool, **arguments: Any) -> None:
        files = [arguments.pop(name) for name in ("tls_ca_file", "tls_cert", "tls_key")]
        tls = Tls(*files) if any(files) else None
        options = RunOptions(workers, scheduler, tls, dashboard=dashboard, timing=timing_of(ctx))
        command(ctx, options=options, **arguments)

    return wrapper


@contextmanager
def interruptible() -> Iterator[None]:
    """End the block in order on Ctrl-C, or on the SIGTERM of a batch system.

    The first signal raises KeyboardInterrupt in the block, the second ends the process at once. Ending at once loses
    only the unfinished tiles: the next run recognises that this process no longer runs.
    """

    def second(number: int, frame: FrameType | None) -> None:
        os.write(2, b"\nstopped at once: finished tiles are kept\n")
        os._exit(INTERRUPTED)

    def first(number: int, frame: FrameType | None) -> None:
        for caught in before:
            signal.signal(caught, second)
        raise KeyboardInterrupt

    # A job in the background starts with Ctrl-C ignored, which remains so.
    signals = [caught for caught in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(caught) != signal.SIG_IGN]
    before = {caught: signal.signal(caught, first) for caught in signals}
    try:
        yield
    finally:
        for caught, handler in before.items():
            signal.signal(caught, handler)


@contextmanager
def input_errors() -> Iterator[None]:
    """Convert errors of queries and pictures within the block into an InputError, for exit code 2 and a message of one
    line.

    A ChunkError, about a damaged chunk, passes: it is no bad input.
    """
    try:
        yield
    except (NetworkError, BrokenPipeError):
        raise
    except ChunkError:
        from atlas.overview.verifying_store import abandon_reads

        abandon_reads()
        raise
    except OSError as error:
        raise InputError(f"{error.filename or ''}: {error.strerror or error}".lstrip(": ")) from None
    except ValueError as error:
        raise InputError(str(error)) from None


def read_pairs(option: str, pairs: tuple[str, ...], read: Callable[[str, str], _T]) -> dict[str, _T]:
    """Convert the texts NAME=VALUE of a repeatable option to a dict of values by name.

    option  name of the option
    pairs   the texts
    read    function that converts a value, called with the text that names it in messages and its own text
    """
    values: dict[str, _T] = {}
    for item in pairs:
        name, equals, value = item.partition("=")
        if not equals:
            raise InputError(f"{option} {item}: must be NAME=VALUE")
        if name in values:
            raise InputError(f"{option} {name}: given twice")
        values[name] = read(f"{option} {name}", value)
    return values


def read_number(where: str, value: str) -> float:
    """Return the number in a text. Raise InputError, beginning with ``where``, if it is no number."""
    try:
        return float(value)
    except ValueError:
        raise InputError(f"{where}: found {brief_repr(value)}, must be a number") from None


def read_factors(factors: tuple[str, ...]) -> int | dict[str, int]:
    """Convert the texts of the option --refine: one factor for all axes, or factors by name."""
    if len(factors) == 1 and "=" not in factors[0]:
        return read_whole("--refine", factors[0])
    return read_pairs("--refine", factors, read_whole)


def read_whole(where: str, value: str) -> int:
    """Return the whole number in a text. Raise InputError, beginning with ``where``, for any other text."""
    try:
        return int(value)
    except ValueError:
        raise InputError(f"{where}: found {brief_repr(value)}, must be a whole number") from None


def read_bounds(where: str, value: str) -> tuple[float, float]:
    """Return the two numbers in a text LOW:HIGH. Raise InputError, beginning with ``where``, for another form."""
    low, colon, high = value.partition(":")
    if not colon:
        raise InputError(f"{where}: found {brief_repr(value)}, must be LOW:HIGH")
    bounds = read_number(where, low), read_number(where, high)
    if not bounds[0] <= bounds[1]:
        raise InputError(f"{where}: found {brief_repr(value)}, must be LOW:HIGH with LOW <= HIGH")
    return bounds


select_option = pairs_option(
    "--select", "NAME=VALUE", "The plane of a stack, or the line of cells, nearest to VALUE.", read_number
)
window_option = pairs_option("--window", "NAME=LOW:HIGH", "Only this window of an axis; repeatable.", read_bounds)
norm_option = pairs_option(
    "--norm",
    "NAME=WEIGHT",
    "Weight of a component of the state; default: 1 for displacements, 1/omega for velocities.",
    read_number,
)
