"""The command that labels the attractors of an atlas."""

import sys

import click

from atlas.cli.options import examples, interruptible, json_option, store_argument, timing_of
from atlas.cli.output import to_json
from atlas.cli.progress import reporter
from atlas.service.options import RunOptions


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
    click.echo(to_json(summary.as_dict()) if as_json else str(summary))
