"""The command ``atlas``. Heavy imports wait until a command needs them, so that help comes at once."""

import os
import shlex
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

import click

from atlas.errors import ChunkError, InputError, NetworkError, RunError, one_line, shown
from atlas.render import FORMATS, KINDS, OVERLAYS
from atlas.spec.spec import Spec, checked_parameters, checked_settings, checked_system, example_names
from workers import Settings
from workers.model.system import SYSTEMS
from workers.settings import EXPONENTS, METHODS

if TYPE_CHECKING:
    from atlas.service.cluster import Tls
    from atlas.service.summary import Summary
    from atlas.task.retry import Retry

INTERRUPTED = 130
CANCEL_SECONDS = 60
"""How long ``atlas cancel`` waits for a run to stop."""
WATCH_SECONDS = 2.0
_T = TypeVar("_T")


class _BadInput(click.ClickException):
    """One line on stderr, exit code 2."""

    exit_code = 2


def _bad_usage(error: click.UsageError) -> _BadInput:
    """What click says of a wrong command line, without the usage before it."""
    where = error.ctx.command_path if error.ctx else "atlas"
    return _BadInput(one_line(f"{error.format_message().rstrip('.')} (see {where} --help)"))


class _Group(click.Group):
    """Commands whose errors end in one line: 1 failed, 2 bad usage or input, 130 interrupted."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args:  # click shows the help
            return super().parse_args(ctx, args)
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            raise _bad_usage(error) from None

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            raise _bad_usage(error) from None
        except InputError as error:
            raise _BadInput(str(error)) from None
        except RunError as error:
            raise click.ClickException(str(error)) from None
        except OSError as error:  # a disk or a network that gave up in the middle
            where = f"{error.filename}: " if error.filename else ""
            raise click.ClickException(f"{where}{error.strerror or error}") from None
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="impact-atlas", prog_name="atlas")
def cli() -> None:
    """Maps of chaos in vibro-impact oscillators.

    A SPEC is a TOML file, or the name of an example in the package. Exit codes: 0 done, 1 failed, 2 bad usage or
    input, 130 interrupted.
    """


main = cli

_json_option = click.option(
    "--json", "as_json", is_flag=True, help="One JSON object on stdout, and nothing else there."
)
_workers_option = click.option(
    "--workers", type=click.IntRange(min=1), help="Worker processes on this machine; default: one a processor."
)
_window_option = click.option(
    "--window", metavar="NAME=LOW:HIGH", multiple=True, help="Only this part of an axis; may be given for each."
)
_store_argument = click.argument("store")  # a path or a URL


@cli.command()
@click.argument("spec")
@click.option("-o", "--out", default=".", help="Where the store is to lie: a path or a URL.")
@_workers_option
@click.option("--probe/--no-probe", default=True, help="Solve a few cells to measure the time.")
@_json_option
def plan(spec: str, out: str, workers: int | None, probe: bool, as_json: bool) -> None:
    """What SPEC will cost: cells, tiles, bytes, probed time."""
    from atlas.cli.output import to_json
    from atlas.service import plan as planning
    from atlas.service.probe import probe as measure
    from atlas.store.location import place_of
    from atlas.task.compile import compile_once, warming

    read = Spec.from_toml(spec)
    made = planning.make_plan(read, workers)
    place = place_of(out)
    if place.local is not None:
        planning.check_disk(made, place.local)
    if probe:
        _say(f"{warming(read.settings.exponents)}, probing a few cells")
        compile_once(read.system, read.settings)
        made = replace(made, probe=measure(read, made.tiling.tile))
    click.echo(to_json(made.as_dict()) if as_json else str(made))


def _run_options(command: Callable[..., None]) -> Callable[..., None]:
    """What a run takes, in the foreground or left to a cluster."""
    for option in (
        click.option("--max-periods", type=int, help="With --retry: the larger budget of the cells solved again."),
        click.option(
            "--retry", metavar="REGIMES", help="Solve these cells of finished tiles again: failed, undetermined."
        ),
        click.option("--tls-key", metavar="FILE", help="Its key."),
        click.option("--tls-cert", metavar="FILE", help="Certificate for a tls:// scheduler."),
        click.option("--tls-ca-file", metavar="FILE", help="Authority for it; default: Dask's configuration."),
        click.option("-o", "--out", required=True, help="The store, a path or a URL: made, or gone on with."),
        click.argument("spec"),
    ):
        command = option(command)
    return command


@cli.command()
@_run_options
@click.option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, such as tcp://host:8786.")
@_workers_option
@click.pass_context
def run(ctx: click.Context, /, spec: str, out: str, scheduler: str | None, workers: int | None, **given: Any) -> None:
    """Compute SPEC into a store. The same line again goes on where it stopped."""
    from atlas.service.progress import reporter
    from atlas.service.run import run as run_spec

    if scheduler is not None and workers is not None:
        raise InputError("--workers is for this machine, --scheduler for a cluster; give one of the two")
    read = Spec.from_toml(spec)
    retry, tls = _checked_run_options(read, **given)
    try:
        with _interruptible(), reporter(sys.stderr) as show:
            summary = run_spec(
                read, out, scheduler=scheduler, workers=workers, on_progress=show, probe=True, retry=retry, tls=tls
            )
    except KeyboardInterrupt:
        given = {"scheduler": scheduler, "workers": workers} | given
        options = [(f"--{name.replace('_', '-')}", str(value)) for name, value in given.items() if value is not None]
        line = shlex.join(["atlas", "run", spec, "-o", out, *(text for pair in options for text in pair)])
        _say(f"interrupted: finished tiles are kept; go on with\n  {line}")
        ctx.exit(INTERRUPTED)
    _tell_end(ctx, summary)


@cli.command()
@_run_options
@click.option("--scheduler", metavar="ADDRESS", required=True, help="A Dask scheduler, such as tcp://host:8786.")
def submit(spec: str, out: str, scheduler: str, **given: Any) -> None:
    """Have a cluster compute SPEC into a store, and leave."""
    from atlas.service.progress import reporter
    from atlas.service.submit import submit as submit_spec

    read = Spec.from_toml(spec)
    retry, tls = _checked_run_options(read, **given)
    store = shlex.quote(out)
    advice = f"see how far it is: atlas status {store} --watch\nstop it: atlas cancel {store}"
    try:
        with reporter(sys.stderr) as show:
            where = submit_spec(read, out, scheduler, on_progress=show, retry=retry, tls=tls)
    except KeyboardInterrupt:
        _say(f"interrupted: the cluster may have begun already\n{advice}")
        raise
    click.echo(f"{out}: at work on the cluster, coordinated by {where}")
    _say(advice)


@cli.command()
@_store_argument
def cancel(store: str) -> None:
    """Stop the run that is at work on STORE, wherever it runs. Finished tiles are kept."""
    from atlas.service.lease import cancel as cancel_run
    from atlas.store.sidecar import notes_of

    stopped = cancel_run(notes_of(store), store, CANCEL_SECONDS, _say)
    click.echo(f"{store}: {stopped} has stopped")


@cli.command()
@_store_argument
@click.argument("spec", required=False)
@click.option("--refine", metavar="N or NAME=N", multiple=True, help="Make all axes, or one, so many times finer.")
@click.option("-o", "--out", required=True, help="The new store, a path or a URL: made, or gone on with.")
@click.option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, such as tcp://host:8786.")
@_workers_option
@click.pass_context
def extend(
    ctx: click.Context,
    store: str,
    spec: str | None,
    refine: tuple[str, ...],
    out: str,
    scheduler: str | None,
    workers: int | None,
) -> None:
    """Compute a larger or finer atlas into a new store, taking over all cells that STORE has.

    SPEC may have other values on STORE's axes, and nothing else that differs. The same line again goes on.
    """
    from atlas.service.extend import extend as extend_store
    from atlas.service.progress import reporter

    if scheduler is not None and workers is not None:
        raise InputError("--workers is for this machine, --scheduler for a cluster; give one of the two")
    if (spec is None) == (not refine):
        raise InputError("give either the SPEC of the new atlas or --refine")
    factors = _factors(refine) if refine else None
    read = None if spec is None else Spec.from_toml(spec)
    options: dict[str, Any] = {"scheduler": scheduler, "workers": workers}
    try:
        with _interruptible(), reporter(sys.stderr) as show:
            summary = extend_store(store, out, read, factors, on_progress=show, probe=True, **options)
    except KeyboardInterrupt:
        _say("interrupted: finished tiles are kept; the same line goes on")
        ctx.exit(INTERRUPTED)
    _tell_end(ctx, summary)


@cli.command()
@_store_argument
@click.option("--watch", "watching", is_flag=True, help="Go on until it is complete, or no run is at work on it.")
@_json_option
def status(store: str, watching: bool, as_json: bool) -> None:
    """How far STORE is: tiles, cells and regimes done, and the run at work on it."""
    from atlas.cli.output import to_json
    from atlas.service.progress import reporter
    from atlas.service.status import read_status, watch
    from atlas.store.store import read_header

    header = read_header(store)
    if watching:
        with reporter(sys.stderr) as show:
            for now in watch(header, WATCH_SECONDS):
                show(now.progress)
    found = read_status(header)
    click.echo(to_json(found.as_dict()) if as_json else str(found))


@cli.command()
@_store_argument
@click.option("--repair", is_flag=True, help="Drop each bad tile, so that atlas run solves it again.")
@click.option(
    "--sample", type=click.IntRange(min=0), metavar="N", default=32, show_default=True, help="Cells to solve again."
)
@_json_option
@click.pass_context
def verify(ctx: click.Context, store: str, repair: bool, sample: int, as_json: bool) -> None:
    """Read all of STORE and check it: checksums, completeness, consistency, a sample of cells solved again.

    Exit code 0: complete and fine; 1: something found. For a store that no run is at work on.
    """
    from atlas.check.verify import verify as verify_store
    from atlas.cli.output import to_json
    from atlas.service.progress import reporter

    with reporter(sys.stderr) as show:
        report = verify_store(store, sample=sample, repair=repair, on_progress=show)
    click.echo(to_json(report.as_dict()) if as_json else str(report))
    if not report.fine:
        ctx.exit(1)


@cli.command()
@_store_argument
@click.option("--at", "point", metavar="NAME=VALUE", multiple=True, help="The cell nearest to a point; one per axis.")
@_window_option
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="Write the cells of the window to a .csv or .nc (netCDF) file."
)
@_json_option
def query(store: str, point: tuple[str, ...], window: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """What STORE holds at a point, or the share of each regime in a window (default: everywhere), or a window's cells.

    Shares are of the area in the axes' own units. Also see: atlas render.
    """
    from atlas.cli.output import print_table, text, to_json
    from atlas.query import queries as questions
    from atlas.query.export import check_path, export
    from atlas.query.open import open_atlas
    from atlas.query.source import counted
    from atlas.service.progress import reasons_told

    if point and window:
        raise InputError("--at asks for one cell, --window for shares; give one of the two")
    wanted = _pairs("--at", point, _number)
    bounds = _pairs("--window", window, _bounds)
    if out is not None and point:
        raise InputError("--at prints one cell, --out writes a window; give one of the two")
    found: dict[str, Any]
    with _input_errors(), counted() as reads:
        if out is not None:
            check_path(out)
        dataset = open_atlas(store)
        if out is not None:
            _say("reading and writing")
            found = {"file": str(out), "cells": export(dataset, out, bounds)}
        else:
            found = questions.at(dataset, wanted) if point else questions.fractions(dataset, bounds)
        why = questions.reasons(dataset, bounds) if {"undetermined", "invalid", "failed"} & found.keys() else {}
    if as_json:
        click.echo(to_json(found | ({"reasons": why} if why else {})))
    elif point or out:
        print_table("", ["", ""], [(name, text(value)) for name, value in found.items()])
    else:
        print_table("", ["", ""], [(name, f"{100 * share:.2f} %") for name, share in found.items()])
        click.echo("".join(f"{line}\n" for line in reasons_told(why)), nl=False)
        _say(f"{reads.chunks} chunks read")


@cli.command()
@_store_argument
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True, help="The picture; the suffix decides how."
)
@click.option("--kind", metavar="KIND", help=f"One of {', '.join(KINDS)}; default: by the axes.")
@click.option(
    "--overlay", "overlays", type=click.Choice(OVERLAYS), multiple=True, help="Lines over a map; may be given again."
)
@click.option(
    "--against",
    metavar="STORE",
    help="A second sweep of the same axis, for hysteresis.",
)
@_window_option
def render(
    store: str,
    out: Path,
    kind: str | None,
    overlays: tuple[str, ...],
    against: str | None,
    window: tuple[str, ...],
) -> None:
    """Draw STORE, or a window of it: a map of two axes, or a sweep of one."""
    from atlas.query.open import open_atlas
    from atlas.query.source import counted

    bounds = _pairs("--window", window, _bounds)
    with _input_errors(), counted() as reads:
        dataset = open_atlas(store)
        other = None if against is None else open_atlas(against)
        _say("drawing")
        from atlas.render import render as draw

        draw(dataset, out, kind=kind, window=bounds, overlays=overlays, against=other)
    if reads.chunks:
        cells = f"overview {reads.level}" if reads.level else "the cells themselves"
        _say(f"{reads.chunks} chunks read, of {cells}")
    click.echo(str(out))


@cli.command()
@click.option("--paper", is_flag=True, required=True, help="Figs 3, 4, 5 and 6 of Li & Tan (2011).")
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="The folder to write them into.")
@click.option(
    "--format",
    "formats",
    type=click.Choice(FORMATS),
    multiple=True,
    default=("png",),
    show_default=True,
    help="May be given again.",
)
@_workers_option
def figures(paper: bool, out: Path, formats: tuple[str, ...], workers: int | None) -> None:
    """Compute and draw the figures of the paper."""
    from atlas.cli.paper import figures as draw_figures
    from atlas.service.progress import reporter

    with _input_errors(), reporter(sys.stderr) as show:
        written = draw_figures(out, formats, workers, on_progress=show)
    for path in written:
        click.echo(str(path))


def _settings_options(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """One option for each setting but these, from the record of settings itself."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        choices = {"exponents": click.Choice(EXPONENTS), "method": click.Choice(METHODS)}
        for field in reversed([field for field in fields(Settings) if field.name not in without]):
            kind = choices.get(field.name) or {int: click.INT, float: click.FLOAT}[type(field.default)]
            name = f"--{field.name.replace('_', '-')}"
            command = click.option(name, type=kind, default=field.default, show_default=True)(command)
        return command

    return decorate


_set_option = click.option(
    "--set", "given", metavar="NAME=VALUE", multiple=True, help="A parameter that differs from its default."
)
_system_option = click.option("--system", default=next(iter(SYSTEMS)), show_default=True, help="See: atlas systems.")


@cli.command()
@_set_option
@_system_option
@_settings_options()
@_json_option
def point(given: tuple[str, ...], system: str, as_json: bool, **solve: Any) -> None:
    """Solve one cell and print all its results."""
    from atlas.cell.point import point as solve_point
    from atlas.cli.output import print_table, text, to_json
    from atlas.task.compile import warming

    pairs, settings = _pairs("--set", given, _number), checked_settings(solve)
    checked_parameters(checked_system(system), pairs)
    if not as_json:
        _say(f"{warming(settings.exponents)}, solving")
    found = solve_point(system, pairs, settings)
    if as_json:
        click.echo(to_json(found))
    else:
        print_table("", ["", ""], [(name, text(value)) for name, value in found.items()])


@cli.command()
@_set_option
@_system_option
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True, help="The picture; the suffix decides how."
)
@_settings_options("exponents", "section_samples")
def portrait(given: tuple[str, ...], system: str, out: Path, **solve: Any) -> None:
    """Draw one cell: its motion in time, phase planes, section, and its exponents as they converge."""
    from atlas.render import portrait as draw_portrait
    from atlas.task.compile import warming

    pairs, settings = _pairs("--set", given, _number), checked_settings(solve)
    checked_parameters(checked_system(system), pairs)
    _say(f"{warming(settings.exponents)}, solving, drawing")
    with _input_errors():
        draw_portrait(pairs, system=system, settings=settings, path=out)
    click.echo(str(out))


@cli.command()
def systems() -> None:
    """The systems that can be solved, with their parameters, and the examples in the package."""
    from atlas.cli.output import print_table

    for record in SYSTEMS.values():
        rows = [(p.name, p.meaning, p.unit, f"{p.default:g}", p.range) for p in record.parameters]
        print_table(f"{record.name}: {record.title}", ["parameter", "meaning", "unit", "default", "valid"], rows)
    click.echo(f"\nexamples: {', '.join(example_names())}")


def _checked_run_options(
    spec: Spec,
    retry: str | None,
    max_periods: int | None,
    tls_ca_file: str | None,
    tls_cert: str | None,
    tls_key: str | None,
) -> "tuple[Retry | None, Tls | None]":
    from atlas.service.cluster import Tls
    from atlas.task.retry import checked_retry

    if retry is None and max_periods is not None:
        raise InputError("--max-periods is for cells solved again: give --retry too, or set it in the spec")
    tls = Tls(tls_ca_file, tls_cert, tls_key) if tls_ca_file or tls_cert or tls_key else None
    return None if retry is None else checked_retry(spec, retry, max_periods), tls


@contextmanager
def _interruptible() -> Iterator[None]:
    """Ctrl-C, or the SIGTERM of a batch system: in order the first time, at once the second.

    Leaving at once loses no more than the tiles under way: the next run sees that this process is gone.
    """

    def second(number: int, frame: FrameType | None) -> None:
        os.write(2, b"\nleft at once: finished tiles are kept\n")
        os._exit(INTERRUPTED)

    def first(number: int, frame: FrameType | None) -> None:
        for caught in before:
            signal.signal(caught, second)
        raise KeyboardInterrupt

    # A job in the background starts with Ctrl-C ignored, and keeps it so.
    wanted = [caught for caught in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(caught) != signal.SIG_IGN]
    before = {caught: signal.signal(caught, first) for caught in wanted}
    try:
        yield
    finally:
        for caught, handler in before.items():
            signal.signal(caught, handler)


def _tell_end(ctx: click.Context, summary: "Summary") -> None:
    """Say how a run ended, and exit with 1 where a tile failed."""
    click.echo(str(summary))
    for worker, reason in summary.refused.items():
        _say(f"worker {worker} did no tile: {reason}")
    for failure in summary.failures:
        _say(f"tile {failure.index} failed: {failure.message}")
    if summary.failures:
        ctx.exit(1)


def _say(text: str) -> None:
    click.echo(text, err=True)


@contextmanager
def _input_errors() -> Iterator[None]:
    """What a query or a picture cannot answer is the question's fault: one line, exit code 2. A bad chunk is not."""
    try:
        yield
    except NetworkError:
        raise
    except ChunkError:
        from atlas.overview.guard import abandon_reads

        abandon_reads()
        raise
    except OSError as error:
        raise InputError(f"{error.filename or ''}: {error.strerror or error}".lstrip(": ")) from None
    except ValueError as error:
        raise InputError(str(error)) from None


def _pairs(option: str, given: tuple[str, ...], read: Callable[[str, str], _T]) -> dict[str, _T]:
    found: dict[str, _T] = {}
    for item in given:
        name, equals, value = item.partition("=")
        if not equals:
            raise InputError(f"{option} {item}: must be NAME=VALUE")
        if name in found:
            raise InputError(f"{option} {name}: given twice")
        found[name] = read(f"{option} {name}", value)
    return found


def _number(where: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"{where}: found {shown(value)}, must be a number") from None


def _factors(given: tuple[str, ...]) -> int | dict[str, int]:
    """One factor for all axes, or factors by name."""
    if len(given) == 1 and "=" not in given[0]:
        return _whole("--refine", given[0])
    return _pairs("--refine", given, _whole)


def _whole(where: str, value: str) -> int:
    try:
        return int(value)
    except ValueError:
        raise InputError(f"{where}: found {shown(value)}, must be a whole number") from None


def _bounds(where: str, value: str) -> tuple[float, float]:
    low, colon, high = value.partition(":")
    if not colon:
        raise InputError(f"{where}: found {shown(value)}, must be LOW:HIGH")
    bounds = _number(where, low), _number(where, high)
    if not bounds[0] <= bounds[1]:
        raise InputError(f"{where}: found {shown(value)}, must be LOW:HIGH with LOW <= HIGH")
    return bounds
