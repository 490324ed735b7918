"""The command about the saddles between the basins of one cell."""

from typing import Any

import click

from atlas.cli.options import (
    Numbers,
    examples,
    json_option,
    norm_option,
    resolve_cell,
    set_option,
    settings_options,
    starts_option,
    system_option,
)
from atlas.cli.output import print_table, text, to_json
from atlas.cli.progress import show_solving
from atlas.robustness.norm import validate_weights
from atlas.task.compile import ATTRACTORS


@click.command(
    epilog=examples(
        "atlas attractors saddles --system gear-mesh",
        "atlas attractors saddles --system gear-mesh --starts 64 --json",
    )
)
@set_option
@system_option
@norm_option
@starts_option
@settings_options("observe", "observe_values")
@json_option
def saddles(
    given: Numbers,
    system: str,
    norm: Numbers,
    starts: int,
    as_json: bool,
    **solve: Any,
) -> None:
    """Find the unstable orbits on the boundaries between the basins of one cell.

    A boundary is the stable manifold of such an orbit, a saddle.
    """
    from atlas.robustness.saddles import saddles as find_saddles

    record, pairs, settings = resolve_cell(given, system, solve)
    weights = validate_weights(norm, record)
    with show_solving(record, ATTRACTORS):
        results = find_saddles(pairs, system=record, settings=settings, starts=starts, norm=weights)
    if as_json:
        click.echo(to_json(results))
        return
    shown = ("period", "between", "residual", "multipliers", "states", "slopes")
    rows = [(name, *(text(saddle.get(name, "")) for saddle in results["saddles"])) for name in shown]
    if results["saddles"]:
        print_table("saddles", ["", *map(str, range(len(results["saddles"])))], rows)
    for line in results["troubles"]:
        click.echo(f"no saddle {line}")
    click.echo(f"saddles: {len(results['saddles'])}, between {results['attractors']} attractors")
