"""Commands about attractors: those of a store, labelled and measured, and those of one cell."""

import sys

import click

from atlas.cli.cell_options import Cell, cell_options, starts_option
from atlas.cli.options import (
    Numbers,
    examples,
    interruptible,
    json_option,
    norm_option,
    store_argument,
    timing_of,
    worker_options,
)
from atlas.cli.output import emit, print_table, print_values, text, to_json
from atlas.cli.progress import reporter, resumable, show_solving
from atlas.robustness.norm import validate_weights
from atlas.service.options import RunOptions
from atlas.task.compile import ATTRACTORS


@click.command("label", epilog=examples("atlas attractors label coexistence.zarr"))
@store_argument
@json_option
@click.pass_context
def label_attractors(ctx: click.Context, store: str, as_json: bool) -> None:
    """Label the attractors of STORE, a finished atlas of all attractors: one label per branch, from cell to cell.

    Each orbit is continued to the neighbouring cells. Labels are written into STORE; stored labels are not computed
    again.
    """
    from atlas.service import labels  # imports Numba

    with interruptible(), reporter(sys.stderr) as show:
        summary = labels.label_attractors(store, RunOptions(on_progress=show, timing=timing_of(ctx)))
    emit(summary, as_json)


@click.command(
    "measure",
    epilog=examples(
        "atlas attractors measure plane.zarr",
        "atlas attractors measure coexistence.zarr --norm v1=0.5 --norm v2=0.5",
    ),
)
@store_argument
@norm_option
@click.option("--shocks", is_flag=True, help="Also the smallest shock found that leads from each attractor to another.")
@worker_options
@json_option
def measure_attractors(
    ctx: click.Context, /, store: str, norm: Numbers, shocks: bool, options: RunOptions, as_json: bool
) -> None:
    """Measure the stability of the attractors of STORE, a finished atlas: return time, reactivity, amplification.

    The measures are written into STORE, for atlas plot; stored measures are not computed again. The same command
    resumes a measurement that was stopped.
    """
    from atlas.service import measures  # imports Numba

    with resumable(ctx, options) as run_options:
        summary = measures.measure_attractors(store, shocks=shocks, norm=norm, options=run_options)
    emit(summary, as_json)


@click.command(
    epilog=examples(
        "atlas attractors stability --set omega=4 --set b=0.1",
        "atlas attractors stability --set omega=4 --set b=0.1 --norm v1=0.5 --norm v2=0.5 --json",
        "atlas attractors stability --system gear-mesh --shocks",
    )
)
@cell_options("observe", "observe_values")
@norm_option
@starts_option
@click.option("--shocks", is_flag=True, help="Also the smallest shock found that leads to another attractor.")
@json_option
def stability(cell: Cell, norm: Numbers, starts: int, shocks: bool, as_json: bool) -> None:
    """Measure the stability of each attractor of one cell: basin stability, return time, reactivity and more."""
    from atlas.robustness.cell_stability import stability as measure

    record, pairs, settings = cell
    weights = validate_weights(norm, record)
    with show_solving(record, ATTRACTORS):
        measures = measure(pairs, system=record, settings=settings, starts=starts, norm=weights, shocks=shocks)
    summary = measures | {"system": record.name}
    click.echo(to_json(measures)) if as_json else print_values(summary, "coexisting")


@click.command(
    epilog=examples(
        "atlas attractors saddles --system gear-mesh",
        "atlas attractors saddles --system gear-mesh --starts 64 --json",
    )
)
@cell_options("observe", "observe_values")
@norm_option
@starts_option
@json_option
def saddles(cell: Cell, norm: Numbers, starts: int, as_json: bool) -> None:
    """Find the unstable orbits on the boundaries between the basins of one cell.

    A boundary is the stable manifold of such an orbit, a saddle.
    """
    from atlas.robustness.saddles import saddles as find_saddles

    record, pairs, settings = cell
    weights = validate_weights(norm, record)
    with show_solving(record, ATTRACTORS):
        results = find_saddles(pairs, system=record, settings=settings, starts=starts, norm=weights)
    if as_json:
        click.echo(to_json(results))
        return
    names = ("period", "between", "residual", "multipliers", "states", "slopes")
    rows = [(name, *(text(saddle.get(name, "")) for saddle in results["saddles"])) for name in names]
    if results["saddles"]:
        print_table("saddles", ["", *map(str, range(len(results["saddles"])))], rows)
    for line in results["troubles"]:
        click.echo(f"no saddle {line}")
    click.echo(f"saddles: {len(results['saddles'])}, between {results['attractors']} attractors")
