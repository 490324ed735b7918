"""The command about the stability of the attractors of one cell."""

import sys
from typing import Any

import click

from atlas.cli.options import (
    examples,
    json_option,
    read_number,
    read_pairs,
    set_option,
    settings_options,
    system_option,
)
from atlas.cli.output import print_attractors, print_table, text, to_json
from atlas.cli.progress import reporter
from atlas.robustness.norm import checked_weights
from atlas.service.progress import Progress, prepare_kernels
from atlas.spec.spec import checked_parameters, checked_settings
from atlas.spec.system import checked_system
from atlas.task.compile import ATTRACTORS, kernels_for
from workers.attractors.starts import MOST_STARTS, Starts


@click.command(
    epilog=examples(
        "atlas stability --set omega=4 --set b=0.1",
        "atlas stability --set omega=4 --set b=0.1 --norm v1=0.5 --norm v2=0.5 --json",
        "atlas stability --system gear-mesh --shocks",
    )
)
@set_option
@system_option
@click.option(
    "--norm",
    metavar="NAME=WEIGHT",
    multiple=True,
    help="Weight of a component of the state; default: 1 for displacements, 1/omega for velocities.",
)
@click.option(
    "--starts",
    type=click.IntRange(1, MOST_STARTS),
    default=Starts.count,
    show_default=True,
    help="Initial states from which the attractors are found.",
)
@click.option("--shocks", is_flag=True, help="Also the smallest shock found that leads to another attractor.")
@settings_options()
@json_option
def stability(
    given: tuple[str, ...],
    system: str,
    norm: tuple[str, ...],
    starts: int,
    shocks: bool,
    as_json: bool,
    **solve: Any,
) -> None:
    """Print how stable each attractor of one cell is: basin stability, return time, reactivity and more."""
    from atlas.robustness.cell import stability as measure

    pairs, settings = read_pairs("--set", given, read_number), checked_settings(solve)
    weights = read_pairs("--norm", norm, read_number)
    record = checked_system(system)
    checked_parameters(record, pairs)
    checked_weights(weights, record)
    with reporter(sys.stderr) as show:
        prepare_kernels(show, *kernels_for(record, ATTRACTORS))
        show(Progress("solving"))
        found = measure(pairs, system=record, settings=settings, starts=starts, norm=weights, shocks=shocks)
    if as_json:
        click.echo(to_json(found))
        return
    shown = found | {"system": record.name}
    several = shown.pop("coexisting")
    print_table("", ["", ""], [(name, text(value)) for name, value in shown.items()])
    print_attractors(several)
