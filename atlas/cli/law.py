"""The command about the segments of laws."""

import click

from atlas.cell.law import CELLS, check_law, finer
from atlas.cli.options import examples, json_option, spec_argument
from atlas.cli.output import print_table, to_json
from atlas.cli.progress import solving
from atlas.spec.spec import Spec

SHOWN = 20
"""Cells that are listed."""


@click.command("check-law", epilog=examples("atlas check-law plane.toml", "atlas check-law plane.toml --cells 24"))
@spec_argument
@click.option("--cells", type=click.IntRange(2, 200), default=CELLS, show_default=True, help="Cells along each axis.")
@json_option
def check(spec: str, cells: int, as_json: bool) -> None:
    """Check whether the segments of SPEC's laws matter: solve a coarse plane with twice as many."""
    read = Spec.from_toml(spec)
    fine = finer(read)
    with solving(read.record):
        found = check_law(read, fine, cells)
    if as_json:
        click.echo(to_json(found.as_dict()))
        return
    for where, (here, there) in found.segments.items():
        click.echo(f"{where}: {here} segments at the defaults, compared with {there}")
    invalid = f", {found.beyond} of them invalid" if found.beyond else ""
    click.echo(f"{len(found.changed)} of {found.cells} cells change their class{invalid}")
    if found.state is not None:
        size, share, at = found.state
        place = ", ".join(f"{name} = {value:.6g}" for name, value in at.items())
        click.echo(f"states of periodic cells change by {size:.2g} at most, {share:.2g} of their size, at {place}")
    if found.changed:
        click.echo()
        rows = [(*(f"{value:.6g}" for value in at.values()), here, there) for at, here, there in found.changed[:SHOWN]]
        print_table("", [*found.changed[0][0], "class", "with twice the segments"], rows)
        if len(found.changed) > SHOWN:
            click.echo(f"... and {len(found.changed) - SHOWN} more; --json lists all")
