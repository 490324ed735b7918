"""The command that measures the attractors of an atlas."""

import click

from atlas.cli.options import (
    Numbers,
    examples,
    json_option,
    norm_option,
    store_argument,
    worker_options,
)
from atlas.cli.output import to_json
from atlas.cli.progress import resumable
from atlas.service.options import RunOptions


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
    ctx: click.Context,
    /,
    store: str,
    norm: Numbers,
    shocks: bool,
    options: RunOptions,
    as_json: bool,
) -> None:
    """Measure the stability of the attractors of STORE, a finished atlas: return time, reactivity, amplification.

    The measures are written into STORE, for atlas plot; stored measures are not computed again. The same command
    resumes a measurement that was stopped.
    """
    from atlas.service import measures  # imports Numba

    with resumable(ctx, options, "finished parts are kept; rerun the same command to resume") as shown:
        summary = measures.measure_attractors(store, shocks=shocks, norm=norm, options=shown)
    click.echo(to_json(summary.as_dict()) if as_json else str(summary))
