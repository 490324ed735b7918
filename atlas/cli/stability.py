"""The command about the stability of the attractors of one cell."""

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
from atlas.cli.output import print_values, to_json
from atlas.cli.progress import show_solving
from atlas.robustness.norm import validate_weights
from atlas.task.compile import ATTRACTORS


@click.command(
    epilog=examples(
        "atlas attractors stability --set omega=4 --set b=0.1",
        "atlas attractors stability --set omega=4 --set b=0.1 --norm v1=0.5 --norm v2=0.5 --json",
        "atlas attractors stability --system gear-mesh --shocks",
    )
)
@set_option
@system_option
@norm_option
@starts_option
@click.option("--shocks", is_flag=True, help="Also the smallest shock found that leads to another attractor.")
@settings_options("observe", "observe_values")
@json_option
def stability(
    given: Numbers,
    system: str,
    norm: Numbers,
    starts: int,
    shocks: bool,
    as_json: bool,
    **solve: Any,
) -> None:
    """Measure the stability of each attractor of one cell: basin stability, return time, reactivity and more."""
    from atlas.robustness.cell_stability import stability as measure

    record, pairs, settings = resolve_cell(given, system, solve)
    weights = validate_weights(norm, record)
    with show_solving(record, ATTRACTORS):
        measures = measure(pairs, system=record, settings=settings, starts=starts, norm=weights, shocks=shocks)
    shown = measures | {"system": record.name}
    click.echo(to_json(measures)) if as_json else print_values(shown, "coexisting")
