"""The command that measures the attractors of an atlas."""

import click

from atlas.cli.options import (
    crew_options,
    examples,
    json_option,
    norm_option,
    read_number,
    read_pairs,
    store_argument,
)
from atlas.cli.output import to_json
from atlas.cli.progress import resumable
from atlas.errors import InputError
from atlas.service.options import RunOptions


@click.command(
    "measure",
    epilog=examples(
        "atlas attractors measure plane.zarr --margin",
        "atlas attractors measure plane.zarr --margin --scale omega=0.05 --scale b=0.01",
        "atlas attractors measure coexistence.zarr --norm v1=0.5 --norm v2=0.5",
    ),
)
@store_argument
@norm_option
@click.option("--shocks", is_flag=True, help="Also the smallest shock found of each attractor that leads to another.")
@click.option("--margin", is_flag=True, help="Also the distance of each cell to the nearest curve of STORE.")
@click.option(
    "--scale", metavar="AXIS=UNIT", multiple=True, help="Unit of the margin along an axis; default: the plane's width."
)
@crew_options
@json_option
def measure_attractors(
    ctx: click.Context,
    /,
    store: str,
    norm: tuple[str, ...],
    shocks: bool,
    margin: bool,
    scale: tuple[str, ...],
    options: RunOptions,
    as_json: bool,
) -> None:
    """Measure how stable the attractors of STORE, a finished atlas, are: return time, reactivity, amplification.

    The measures are kept in STORE, for atlas plot; what it has already is not computed again. The same command
    resumes one that was stopped.
    """
    from atlas.service import measures  # with it Numba

    weights, units = read_pairs("--norm", norm, read_number), read_pairs("--scale", scale, read_number)
    if units and not margin:
        raise InputError("--scale needs --margin: it sets its unit")
    with resumable(ctx, options, "finished parts are kept; the same command resumes") as shown:
        summary = measures.measure_attractors(
            store, shocks=shocks, margin=margin, norm=weights, scale=units or None, options=shown
        )
    click.echo(to_json(summary.as_dict()) if as_json else str(summary))
