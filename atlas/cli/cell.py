"""Commands about one cell, and lists of systems and examples."""

import sys
from pathlib import Path
from typing import Any

import click

from atlas.cell.trajectory import HISTORY_SAMPLES
from atlas.cli.cell_options import Cell, GivenCell, cell_options, given_cell_options, starts_option
from atlas.cli.options import examples, figure_options, input_errors, json_option, out_option, picture_option
from atlas.cli.output import print_values, to_json
from atlas.cli.progress import reporter, show_solving
from atlas.errors import InputError
from atlas.service.progress import Progress, prepare_kernels
from atlas.spec.laws import law_lines, uses_of_cell
from atlas.spec.spec import SETTING_MEANINGS
from atlas.spec.system import parse_system
from atlas.task.compile import ATTRACTORS, ORBITS, PATHS, kernels_for
from workers.attractors.initial_states import AttractorSettings

_COUNT = click.IntRange(min=1)


@click.command(
    epilog=examples(
        "atlas point --set omega=4 --set b=0.1 --exponents spectrum",
        "atlas point --system impact-damper --set omega=1 --json",
        "atlas point --set omega=4 --set b=0.1 --attractors",
    )
)
@cell_options()
@click.option("--attractors", "every", is_flag=True, help="All attractors that initial states reach, with shares.")
@starts_option
@json_option
def point(cell: Cell, every: bool, starts: int, as_json: bool) -> None:
    """Solve one cell and print all its results, or with --attractors all its attractors."""
    from atlas.cell.point import point as solve_point
    from atlas.robustness.attractors import attractors

    if starts != AttractorSettings.count and not every:
        raise InputError("--starts needs --attractors; without --attractors one initial state is solved")
    record, pairs, settings = cell
    with show_solving(record, *((ATTRACTORS,) if every else ()), settings=settings):
        if every:
            results = attractors(pairs, system=record, settings=settings, starts=starts)
        else:
            results = solve_point(pairs, system=record, settings=settings)
    if as_json:
        click.echo(to_json(results))
        return
    print_values(results | {"system": record.name}, "coexisting")
    click.echo("".join(f"{line}\n" for line in law_lines(uses_of_cell(record, results))), nl=False)


@click.command(
    epilog=examples(
        "atlas portrait --set omega=3 --set b=0.2 -o cell.png",
        "atlas portrait plane.zarr --at omega=3 --at b=0.2 -o cell.png",
    )
)
@given_cell_options("exponents", "section_samples")
@picture_option
@figure_options("vmin", "vmax")
def portrait(cell: GivenCell, out: Path, **look: Any) -> None:
    """Draw one cell: its motion in time, phase planes, section, and its exponents as they converge.

    The cell is one of STORE, by --at, solved again with its settings, or is given by --set.
    """
    from atlas.query.cell import CellSpec, read_cell_spec
    from atlas.render import check_path
    from atlas.render import portrait as draw_portrait
    from atlas.render.request import PictureRequest

    check_path(out)
    PictureRequest.from_arguments(**look)  # before the cell is solved
    with input_errors(), reporter(sys.stderr) as show:
        drawn = CellSpec(*cell.resolve()) if cell.store is None else read_cell_spec(cell.open(), cell.point)
        prepare_kernels(show, *kernels_for(drawn.system, PATHS, settings=drawn.settings))
        show(Progress("solving and drawing"))
        draw_portrait(drawn.parameters, system=drawn.system, settings=drawn.settings, path=out, **look)
    click.echo(str(out))


@click.command(
    epilog=examples(
        "atlas trace --set omega=4 --set b=0.1 --periods 2 --events",
        "atlas trace --system capsule --periods 10 --transient 100 -o capsule.csv",
        "atlas trace plane.zarr --at omega=3 --at b=0.2 --periods 40 -o cell.nc",
    )
)
@given_cell_options(*SETTING_MEANINGS)
@click.option("--periods", type=_COUNT, default=1, show_default=True, help="Number of periods of the force.")
@click.option("--transient", type=click.IntRange(0), default=0, show_default=True, help="Number of periods left out.")
@click.option("--samples", type=_COUNT, default=HISTORY_SAMPLES, show_default=True, help="Instants per period.")
@click.option("--time", "times", type=float, multiple=True, help="An instant in place of --samples; repeatable.")
@click.option("--events", "events_only", is_flag=True, help="Events alone: impacts, sticking, slips.")
@out_option("The table: .csv or .nc; by default it is printed as CSV.")
def trace(cell: GivenCell, out: Path | None, times: tuple[float, ...], **options: Any) -> None:
    """Print the motion of one cell in time: states, forces of contacts, and events with their names.

    The cell is one of STORE, by --at, or is given by --set. The motion begins at its initial state.
    """
    from atlas.cell.time_history import time_history
    from atlas.query.cell import read_cell_spec
    from atlas.query.export import FORMATS, check_target, write_history

    if out is not None:
        check_target(out, FORMATS)
    with input_errors(), reporter(sys.stderr) as show:
        record, parameters = parse_system(cell.system), cell.parameters
        if cell.store is not None:
            stored = read_cell_spec(cell.open(), cell.point)
            record, parameters = stored.system, dict(stored.parameters)
        prepare_kernels(show, *kernels_for(record, PATHS, ORBITS))  # of orbits: the motion from event to event
        show(Progress("following the motion"))
        table = time_history(parameters, system=record, times=times or None, **options)
        if out is not None:
            write_history(table, out)
    click.echo(table.to_csv(index=False, na_rep="nan", lineterminator="\n") if out is None else str(out), nl=bool(out))
