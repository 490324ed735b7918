"""The command that follows the orbit of a cell along one parameter."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from atlas.cli.cell_options import GivenCell, given_cell_options
from atlas.cli.options import examples, figure_options, input_errors, json_option, out_option
from atlas.cli.output import print_table, to_json
from atlas.cli.progress import reporter
from atlas.formatting import plural
from atlas.orbits.branches.from_cell import MAX_BRANCHES, observed_of, tree_from
from atlas.orbits.branches.seed import seed_of_cell, seed_of_point
from atlas.orbits.branches.table import BranchTable, orbit_name
from atlas.query.export import check_target, replace_on_success, write_table
from atlas.render import FORMATS, render
from atlas.render.request import PictureRequest
from atlas.service.progress import Progress, prepare_kernels
from atlas.spec.system import system_of
from atlas.task.compile import OBSERVED, ORBITS, kernels_for
from workers.results import CYCLE_PERIOD

if TYPE_CHECKING:
    import pandas

    from atlas.orbits.branches.seed import BranchSeed

TABLES = ("csv", "json")
"""File formats, besides pictures, in which branches can be written."""


@click.command(
    epilog=examples(
        "atlas branch --set b=0.15 --set omega=3.5 --along omega --from 2 --to 4",
        "atlas branch plane.zarr --at omega=3.5 --at b=0.15 --along b --from 0.1 --to 0.5 -o branch.png",
    )
)
@given_cell_options("exponents", "section_samples", "observe", "observe_values")
@click.option("--along", required=True, metavar="NAME", help="The parameter along which to follow the orbit.")
@click.option("--from", "low", type=float, required=True, metavar="VALUE", help="Lower end of the parameter range.")
@click.option("--to", "high", type=float, required=True, metavar="VALUE", help="Upper end of the parameter range.")
@click.option(
    "--switch-branches", is_flag=True, help="Also follow the branches from period doublings and symmetry breakings."
)
@click.option(
    "--observe",
    metavar="NAME",
    help="What a picture shows in place of section values and a file has besides, such as impact_phase:stop.",
)
@click.option(
    "--budget",
    type=click.IntRange(min=1),
    default=MAX_BRANCHES,
    show_default=True,
    help="Maximum number of branches to follow.",
)
@out_option(f"Write the points to a .csv file, everything to .json, or a picture: .{', .'.join(FORMATS)}.")
@json_option
@figure_options("vmin", "vmax")
def branch(
    cell: GivenCell,
    along: str,
    low: float,
    high: float,
    switch_branches: bool,
    budget: int,
    observe: str | None,
    out: Path | None,
    as_json: bool,
    **look: Any,
) -> None:
    """Follow the periodic orbit of a cell along one parameter, where it is stable and where it is not.

    The cell is one of STORE, by --at, or is given by --set and solved here. The command prints the events on the way:
    folds, symmetry breakings, period doublings, Neimark-Sacker points, grazes, lost impacts and contacts, onset and
    end of sticking. Each event is located to 1e-10 or better. For a machine without a force it follows cycles and
    equilibria, with their Hopf points.
    """
    if out is not None:
        check_target(out, [f".{name}" for name in (*TABLES, *FORMATS)])
    PictureRequest.from_arguments(**look)  # before the branch is followed
    with input_errors(), reporter(sys.stderr) as show:
        seed = _seed(show, cell)
        observable = observed_of(seed, observe)
        if observable is not None:
            prepare_kernels(show, *kernels_for(seed.system, OBSERVED))
        show(Progress("following"))
        branches = BranchTable.from_tree(tree_from(seed, along, (low, high), switch_branches, budget), observable)
        if out is not None:
            _write(branches, out, look)
    message = {"file": str(out)} if out is not None else {}
    if as_json:
        click.echo(to_json(message | summary(branches)))
        return
    _print(branches)
    if out is not None:
        click.echo(str(out))


def summary(branches: BranchTable) -> dict[str, Any]:
    """Return branches and events as dicts and lists for JSON, without the solution points."""
    return {
        "system": branches.system.name,
        "parameters": dict(branches.parameters),
        "along": branches.along,
        "window": list(branches.window),
        "branches": _records(branches.branches.reset_index()),
        "events": _records(branches.events),
        "untried": [
            {"branch": untried.branch, "kind": untried.event.kind, branches.along: float(untried.event.point.values[0]),
             "why": untried.why}
            for untried in branches.untried
        ],
    }  # fmt: skip


def _seed(show: Callable[[Progress], None], cell: GivenCell) -> "BranchSeed":
    """Return the orbit from which branches start: of a cell of a store, or of a cell that is solved here.

    ``show`` is called with the progress.
    """
    if cell.store is None:
        record, pairs, settings = cell.resolve()
        prepare_kernels(show, *kernels_for(record, ORBITS))
        show(Progress("solving"))
        return seed_of_point(pairs, record, settings)
    ds = cell.open()
    prepare_kernels(show, *kernels_for(system_of(ds.attrs), ORBITS))
    return seed_of_cell(ds, cell.point)


def _print(branches: BranchTable) -> None:
    """Print a table of the events on the branches, and why each branch ends."""
    cycles = [CYCLE_PERIOD.name] if branches.system.definition.unforced else []
    events = [event for traced in branches.traced for event in traced.run.events]
    rows = [
        (
            str(row["branch"]),
            row["kind"].replace("_", " "),
            f"{row[branches.along]:.12g}",
            *(f"{row[name]:.10g}" for name in cycles),
            orbit_name(event.point.orbit.itinerary, branches.system),
            str(row["unstable"]),
            str(row["leaving"]) if row["leaving"] >= 0 else "",
        )
        for row, event in zip(_records(branches.events), events, strict=True)
    ]
    periods = [name.replace("_", " ") for name in cycles]
    if rows:
        print_table("", ["branch", "event", branches.along, *periods, "orbit", "unstable", "leaving"], rows)
    for number, branch in enumerate(_records(branches.branches)):
        left = f", leaves branch {branch['leaves']}" if branch["leaves"] >= 0 else ""
        traced = branches.traced[number]
        (first, *_, last), name = traced.values, orbit_name(traced.itinerary, branches.system)
        ends = [f"{first:.10g} ({branch['first_end']})", f"{last:.10g} ({branch['last_end']})"]
        reach = " to ".join(ends).replace("_", " ")
        click.echo(f"branch {number}: {name}{left}, {branch['points']} points, {branches.along} {reach}")
    for untried in branches.untried:
        kind, value = untried.event.kind.replace("_", " "), untried.event.point.values[0]
        click.echo(f"not followed: branch {untried.branch}, {kind} at {value:.10g}: {untried.why}")
    click.echo(f"{plural(len(rows), 'event')} on {plural(len(branches.traced), 'branch', 'branches')}")


def _records(frame: "pandas.DataFrame") -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = frame.to_dict("records")
    return rows


def _write(branches: BranchTable, out: Path, look: dict[str, Any]) -> None:
    """Write branches to a file: the points as CSV, everything as JSON, or a picture, by the suffix of ``out``."""
    suffix = out.suffix.lower()
    if suffix == ".csv":
        write_table(out, branches.points)
    elif suffix == ".json":
        with replace_on_success(out) as unfinished:
            unfinished.write_text(to_json(summary(branches) | {"points": _records(branches.points)}) + "\n")
    else:
        render(branches, out, **look)
