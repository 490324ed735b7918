"""The command about a plane's curves."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import click

from atlas.cli.options import (
    examples,
    json_option,
    out_option,
    store_argument,
    worker_options,
)
from atlas.cli.output import to_json
from atlas.cli.progress import resumable
from atlas.orbits.curves.export import check_path, export
from atlas.orbits.curves.settings import CurveSettings
from atlas.service.options import RunOptions

_DEFAULTS = {budget.name: budget.default for budget in fields(CurveSettings)}


def _budget(name: str, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    option = f"--{name.replace('_', '-')}"
    return click.option(option, type=click.IntRange(min=1), default=_DEFAULTS[name], show_default=True, help=text)


@click.command("curves", epilog=examples("atlas find curves plane.zarr", "atlas find curves plane.zarr -o curves.csv"))
@store_argument
@out_option("Also write them to this file, .csv or .json.")
@_budget("edges", "Maximum number of edges beside which events are searched.")
@_budget("curves", "Maximum number of curves to follow.")
@_budget("points", "Maximum number of points of all curves.")
@_budget("min_cells", "Minimum number of cells of a region beside which events are searched.")
@worker_options
@json_option
def find_curves(
    ctx: click.Context,
    /,
    store: str,
    out: Path | None,
    options: RunOptions,
    as_json: bool,
    **budget: int,
) -> None:
    """Find the exact curves that bound the regions of STORE, a finished plane: bifurcations and grazes of its orbits.

    The curves are written into STORE; stored curves are not computed again. The command prints the share of the
    borders between regions that the curves explain. The same command resumes a search that was stopped.
    """
    from atlas.service import curves  # imports Numba

    if out is not None:
        check_path(out)
    with resumable(ctx, options) as shown:
        summary = curves.find_curves(store, CurveSettings(**budget), options=shown)
    if out is not None:
        export(summary.curves, out)
    click.echo(to_json(summary.as_dict()) if as_json else str(summary))
