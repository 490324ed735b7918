"""The command about the saddles between the basins of one cell."""

from pathlib import Path
from typing import Any

import click

from atlas.argument_checks import validate_suffix
from atlas.cli.options import (
    Bounds,
    Numbers,
    examples,
    json_option,
    norm_option,
    out_option,
    pairs_option,
    read_bounds,
    resolve_cell,
    set_option,
    settings_options,
    starts_option,
    system_option,
)
from atlas.cli.output import print_table, text, to_json
from atlas.cli.progress import show_solving
from atlas.errors import InputError
from atlas.query.export import write_table
from atlas.robustness.norm import validate_weights
from atlas.task.compile import ATTRACTORS


@click.command(
    epilog=examples(
        "atlas attractors saddles --system gear-mesh",
        "atlas attractors saddles --system gear-mesh --box x=-2:2 --box v=-1:1 -o boundary.csv",
    )
)
@set_option
@system_option
@norm_option
@starts_option
@out_option("For one mass, write the stable manifolds to this .csv file.")
@pairs_option("--box", "NAME=LOW:HIGH", "With --out: limits of the states on the manifolds.", read_bounds)
@settings_options("observe", "observe_values")
@json_option
def saddles(
    given: Numbers,
    system: str,
    norm: Numbers,
    starts: int,
    out: Path | None,
    box: Bounds,
    as_json: bool,
    **solve: Any,
) -> None:
    """Find the unstable orbits on the boundaries between the basins of one cell, and for one mass the boundaries.

    A boundary is the stable manifold of such an orbit, a saddle.
    """
    import pandas as pd

    from atlas.robustness.saddles import saddles as find_saddles

    record, pairs, settings = resolve_cell(given, system, solve)
    weights = validate_weights(norm, record)
    if out is None and box:
        raise InputError("--box needs --out, whose manifolds it limits")
    if out is not None:
        validate_suffix(out, [".csv"])
    with show_solving(record, ATTRACTORS):
        results = find_saddles(
            pairs, system=record, settings=settings, starts=starts, norm=weights, manifolds=out is not None, box=box
        )
    if out is not None:
        rows = [
            (k, number, *state)
            for k, saddle in enumerate(results["saddles"])
            for number, line in enumerate(saddle["manifold"])
            for state in line
        ]
        write_table(out, pd.DataFrame(rows, columns=["saddle", "line", *record.states]))
    if as_json:
        click.echo(to_json(results | ({"file": str(out)} if out is not None else {})))
        return
    shown = ("period", "between", "residual", "multipliers", "states", "slopes")
    rows = [(name, *(text(saddle.get(name, "")) for saddle in results["saddles"])) for name in shown]
    if results["saddles"]:
        print_table("saddles", ["", *map(str, range(len(results["saddles"])))], rows)
    for line in results["troubles"]:
        click.echo(f"no saddle {line}")
    click.echo(f"saddles: {len(results['saddles'])}, between {results['attractors']} attractors")
    if out is not None:
        click.echo(str(out))
