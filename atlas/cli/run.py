"""Commands that compute: plan, run, retry, cancel, extend."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import click

from atlas.cell.law_check import CELLS, check_law, finer
from atlas.cli import progress
from atlas.cli.options import (
    PLACE,
    examples,
    json_option,
    print_status,
    read_factors,
    read_whole,
    spec_argument,
    storage_option,
    store_argument,
    timing_of,
    worker_options,
)
from atlas.cli.output import emit, to_json
from atlas.errors import InputError
from atlas.service.extend import extend as extend_store
from atlas.service.lease import cancel as cancel_run
from atlas.service.options import RunOptions
from atlas.service.plan import check_free_space, make_plan
from atlas.service.probe import add_probe, with_time
from atlas.service.retry import retry as retry_store
from atlas.service.run import run as run_spec
from atlas.service.summary import RunSummary
from atlas.spec.laws import check_steps
from atlas.spec.spec import Spec
from atlas.store.object_backend import open_backend
from atlas.store.sidecar import sidecar_of
from atlas.store.zarr_backend import check_not_packed

CANCEL_SECONDS = 60
"""Maximum seconds that ``atlas cancel`` waits for a run to stop."""


points_option = click.option(
    "--points",
    type=PLACE,
    metavar="FILE",
    help="A CSV file of parameter sets, one row per cell, in place of SPEC's axes.",
)


observe_option = click.option(
    "--observe", metavar="NAMES", help="Observables, separated by commas, in place of SPEC's: impact_phase:stop."
)


@click.command(
    epilog=examples(
        "atlas plan omega-b", "atlas plan plane.toml --workers 16", "atlas plan hertz-ball --no-probe --laws"
    )
)
@spec_argument
@click.option("-o", "--out", type=PLACE, default=".", help="The path or URL that the store is to have.")
@storage_option
@click.option("--workers", type=click.IntRange(min=1), help="Workers of the run; default: one per processor.")
@click.option("--probe/--no-probe", default=True, help="Solve a few cells to measure the time.")
@click.option(
    "--laws",
    type=click.IntRange(2, 200),
    is_flag=False,
    flag_value=CELLS,
    metavar="[N]",
    help=f"Solve N x N cells, default {CELLS}, also with laws of a quarter of the bound, and list what changes.",
)
@points_option
@observe_option
@json_option
def plan(
    spec: str,
    out: str,
    workers: int | None,
    probe: bool,
    laws: int | None,
    points: str | None,
    observe: str | None,
    as_json: bool,
) -> None:
    """Estimate the cost of SPEC: cells, tiles, bytes, probed time. With --laws check whether its segments matter."""
    read = _read(spec, points, observe)
    fine = None if laws is None else finer(read)
    estimate = make_plan(read, workers)
    backend = open_backend(out)
    check_not_packed(backend)
    try:
        check_steps(read)
        if backend.local is not None:
            check_free_space(estimate, backend.local)
    except InputError as error:
        print_status(f"atlas run will refuse this: {error}")
    if probe:
        with progress.reporter(sys.stderr) as show:
            estimate = add_probe(estimate, show)
    if fine is None or laws is None:
        emit(estimate, as_json)
        return
    with progress.show_solving(read.system_def):
        check = check_law(read, fine, laws)
    click.echo(to_json(estimate.as_dict() | {"laws": check.as_dict()}) if as_json else f"{estimate}\n{check}")


def _read(spec: str, points: str | None, observe: str | None) -> Spec:
    """Return the spec of a command, with its options --points and --observe applied."""
    read = Spec.from_toml(spec, points)
    return read if observe is None else read.with_observables(observe)


def _out_option(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with the option -o, the store that is created or completed."""
    words = "The store to create or complete, a path or a URL."
    return click.option("-o", "--out", type=PLACE, required=True, help=words)(storage_option(command))


@click.command(
    epilog=examples(
        "atlas run plane.toml -o plane.zarr",
        "atlas run plane.toml -o /shared/plane.zarr --scheduler tcp://10.0.0.1:8786",
    )
)
@spec_argument
@_out_option
@points_option
@observe_option
@worker_options
@click.option(
    "--performance-report",
    "report",
    type=PLACE,
    metavar="FILE",
    help="Write Dask's report of how the workers spent their time.",
)
@click.option("--tile", metavar="I,J", help="Solve only this tile, in this process, with its traceback.")
@click.option("--log", type=PLACE, metavar="FILE", help="Log decisions, and tracebacks of failed tiles, to a file.")
def run(
    ctx: click.Context,
    /,
    spec: str,
    out: str,
    points: str | None,
    observe: str | None,
    options: RunOptions,
    report: str | None,
    tile: str | None,
    log: str | None,
) -> None:
    """Compute SPEC into a store. The same command resumes a run that was stopped."""
    read = _read(spec, points, observe)
    index = None if tile is None else tuple(read_whole("--tile", part) for part in tile.split(","))
    options = replace(options, tile=index, performance_report=report)
    with _logged(log), progress.resumable(ctx, options, with_time) as run_options:
        summary = run_spec(read, out, options=run_options)
    _report(ctx, summary)


@click.command(
    epilog=examples(
        "atlas retry plane.zarr undetermined --max-periods 100000 -o decided.zarr",
        "atlas retry plane.zarr chaotic --survival 500000 -o watched.zarr --scheduler tcp://10.0.0.1:8786",
    )
)
@store_argument
@click.argument("regimes")
@click.option("-o", "--out", type=PLACE, required=True, help="The new store, a path or a URL: made, or completed.")
@click.option("--max-periods", type=int, help="For undetermined cells: a larger budget than that of the spec.")
@click.option("--survival", type=int, help="For chaotic or aperiodic cells: a longer survival than that of the spec.")
@worker_options
def retry(
    ctx: click.Context,
    /,
    store: str,
    regimes: str,
    out: str,
    max_periods: int | None,
    survival: int | None,
    options: RunOptions,
) -> None:
    """Solve cells of STORE again, with more periods or a longer survival, into a new store with all other cells.

    REGIMES is one or more of undetermined, chaotic, aperiodic, separated by commas. STORE does not change. The same
    command resumes a retry that was stopped.
    """
    with progress.resumable(ctx, options) as run_options:
        summary = retry_store(store, out, regimes, max_periods, survival, options=run_options)
    _report(ctx, summary)


@click.command(epilog=examples("atlas cancel plane.zarr"))
@store_argument
@click.pass_context
def cancel(ctx: click.Context, store: str) -> None:
    """Stop the run that writes STORE, on any host. Finished tiles are kept."""
    stopped = cancel_run(sidecar_of(store), store, CANCEL_SECONDS, print_status, timing_of(ctx))
    click.echo(f"{store}: {stopped} has stopped")


@click.command(
    epilog=examples(
        "atlas extend plane.zarr --refine 2 -o finer.zarr", "atlas extend plane.zarr wider.toml -o wider.zarr"
    )
)
@store_argument
@click.argument("spec", required=False, type=PLACE)
@click.option(
    "--refine", metavar="N or NAME=N", multiple=True, help="Refinement factor for all axes, or NAME=N for one."
)
@click.option("-o", "--out", type=PLACE, required=True, help="The new store, a path or a URL: made, or completed.")
@worker_options
def extend(
    ctx: click.Context,
    store: str,
    spec: str | None,
    refine: tuple[str, ...],
    out: str,
    options: RunOptions,
) -> None:
    """Compute a larger or finer atlas into a new store, reusing all cells that STORE has.

    SPEC may differ from that of STORE only in the values on the axes. The same command resumes an extension that was
    stopped.
    """
    factors = read_factors(refine) if refine else None
    read = None if spec is None else Spec.from_toml(spec)
    with progress.resumable(ctx, options, with_time) as run_options:
        summary = extend_store(store, out, read, factors, options=run_options)
    _report(ctx, summary)


@contextmanager
def _logged(path: str | None) -> Iterator[None]:
    """Append the log messages of the package to a file within the block; do nothing if ``path`` is None.

    Raise InputError if the file cannot be written.
    """
    if path is None:
        yield
        return
    logger = logging.getLogger("atlas")
    level = logger.level
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise InputError(f"--log {path}: {error.strerror or error}") from None
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()


def _report(ctx: click.Context, summary: RunSummary) -> None:
    """Print the summary of a run, and end the command with exit code 1 if a tile failed."""
    click.echo(str(summary))
    for worker, reason in summary.refused.items():
        print_status(f"worker {worker} was excluded: {reason}")
    for failure in summary.failures:
        print_status(str(failure))
    if summary.failures:
        ctx.exit(1)
