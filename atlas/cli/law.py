"""The command about the segments of laws."""

import click

from atlas.cell.law_check import CELLS, check_law, finer
from atlas.cli.options import examples, json_option, spec_argument
from atlas.cli.output import print_table, to_json
from atlas.cli.progress import show_solving
from atlas.spec.spec import Spec

MAX_ROWS = 20
"""Maximum number of cells that are listed."""


@click.command("check-law", epilog=examples("atlas check-law plane.toml", "atlas check-law plane.toml --cells 24"))
@spec_argument
@click.option("--cells", type=click.IntRange(2, 200), default=CELLS, show_default=True, help="Cells along each axis.")
@json_option
def check(spec: str, cells: int, as_json: bool) -> None:
    """Check whether the segments of SPEC's laws matter: solve a coarse plane with twice as many segments."""
    read = Spec.from_toml(spec)
    fine = finer(read)
    with show_solving(read.system_def):
        changes = check_law(read, fine, cells)
    if as_json:
        click.echo(to_json(changes.as_dict()))
        return
    for where, (here, there) in changes.segments.items():
        click.echo(f"{where}: {here} segments at the defaults, compared with {there}")
    invalid = f", {changes.beyond} of them invalid" if changes.beyond else ""
    click.echo(f"{len(changes.changed)} of {changes.cells} cells change their class{invalid}")
    if changes.state is not None:
        size, share, at = changes.state
        place = ", ".join(f"{name} = {value:.6g}" for name, value in at.items())
        click.echo(f"states of periodic cells change by {size:.2g} at most, {share:.2g} of their size, at {place}")
    if changes.changed:
        click.echo()
        rows = [
            (*(f"{value:.6g}" for value in at.values()), here, there) for at, here, there in changes.changed[:MAX_ROWS]
        ]
        print_table("", [*changes.changed[0][0], "class", "with twice the segments"], rows)
        if len(changes.changed) > MAX_ROWS:
            click.echo(f"... and {len(changes.changed) - MAX_ROWS} more; --json lists all")
