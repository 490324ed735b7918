"""The command that follows the orbit of a cell along one parameter."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from atlas.arguments import checked_suffix
from atlas.cli import completion
from atlas.cli.completion import of_names
from atlas.cli.options import (
    asked_cell,
    at_option,
    check_cell_options,
    examples,
    input_errors,
    json_option,
    look_options,
    maybe_store_argument,
    opened,
    read_number,
    read_pairs,
    select_option,
    set_option,
    settings_options,
    system_option,
)
from atlas.cli.output import print_table, to_json
from atlas.cli.progress import reporter
from atlas.orbits.branches.branch import MOST, observed_of, tree_from
from atlas.orbits.branches.seed import seed_of_cell, seed_of_point
from atlas.orbits.branches.table import Branches, orbit_name
from atlas.query.export import write_rows, written_whole
from atlas.render import FORMATS, LOOK, render
from atlas.service.progress import Progress, prepare_kernels
from atlas.spec.system import system_of
from atlas.task.compile import OBSERVED, ORBITS, kernels_for
from atlas.text import plural
from workers.results import CYCLE_PERIOD

if TYPE_CHECKING:
    import pandas

    from atlas.orbits.branches.seed import Seed

TABLES = ("csv", "json")
"""What branches can be written as, besides pictures."""


@click.command(
    epilog=examples(
        "atlas branch --set b=0.15 --set omega=3.5 --along omega --from 2 --to 4",
        "atlas branch plane.zarr --at omega=3.5 --at b=0.15 --along b --from 0.1 --to 0.5 -o branch.png",
    )
)
@maybe_store_argument
@click.option(
    "--along",
    required=True,
    metavar="NAME",
    shell_complete=of_names(completion.names_along),
    help="The parameter along which to follow the orbit.",
)
@click.option("--from", "low", type=float, required=True, metavar="VALUE", help="Its lower end.")
@click.option("--to", "high", type=float, required=True, metavar="VALUE", help="Its upper end.")
@set_option
@at_option
@select_option
@system_option
@click.option(
    "--switch-branches", is_flag=True, help="Follow the branches from period doublings and symmetry breakings too."
)
@click.option(
    "--observe",
    metavar="NAME",
    help="What a picture shows in place of section values and a file has besides, such as impact_phase:stop.",
)
@click.option("--budget", type=click.IntRange(min=1), default=MOST, show_default=True, help="Branches followed in all.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help=f"Write the points to a .csv file, everything to .json, or a picture: .{', .'.join(FORMATS)}.",
)
@json_option
@look_options("vmin", "vmax")
@settings_options("exponents", "section_samples", "observe", "observe_values")
def branch(
    store: str | None,
    along: str,
    low: float,
    high: float,
    given: tuple[str, ...],
    point: tuple[str, ...],
    select: tuple[str, ...],
    system: str,
    switch_branches: bool,
    budget: int,
    observe: str | None,
    out: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Follow the periodic orbit of a cell along one parameter, where it is stable and where it is not.

    The cell is one of STORE, by --at, or is solved here, by --set. Prints the events on the way: folds, symmetry
    breakings, period doublings, Neimark-Sacker points, grazes, lost impacts and contacts, onset and end of stick, each
    located to 1e-10 or better. Of a machine without a force it follows cycles and equilibria, with their Hopf points.
    """
    if out is not None:
        checked_suffix(out, [f".{name}" for name in (*TABLES, *FORMATS)])
    look = {name: options.pop(name) for name in LOOK if name in options}
    with input_errors(), reporter(sys.stderr) as show:
        seed = _seed(show, store, given, point, select, system, options)
        observable = observed_of(seed, observe)
        if observable is not None:
            prepare_kernels(show, *kernels_for(seed.system, OBSERVED))
        show(Progress("following"))
        found = Branches.of(tree_from(seed, along, (low, high), switch_branches, budget), observable)
        if out is not None:
            _write(found, out, look)
    message = {"file": str(out)} if out is not None else {}
    if as_json:
        click.echo(to_json(message | summary(found)))
        return
    _print(found)
    if out is not None:
        click.echo(str(out))


def summary(found: Branches) -> dict[str, Any]:
    """Branches as plain values, without their points."""
    return {
        "system": found.system.name,
        "parameters": dict(found.parameters),
        "along": found.along,
        "window": list(found.window),
        "branches": _records(found.branches.reset_index()),
        "events": _records(found.events),
        "untried": [
            {"branch": each.branch, "kind": each.event.kind, found.along: float(each.event.point.values[0]),
             "why": each.why}
            for each in found.untried
        ],
    }  # fmt: skip


def _seed(
    show: Callable[[Progress], None],
    store: str | None,
    given: tuple[str, ...],
    point: tuple[str, ...],
    select: tuple[str, ...],
    system: str,
    options: dict[str, Any],
) -> "Seed":
    """The orbit of the requested cell."""
    check_cell_options(store)
    at = read_pairs("--at", point, read_number)
    if store is None:
        record, pairs, settings = asked_cell(given, system, options)
        prepare_kernels(show, *kernels_for(record, ORBITS))
        show(Progress("solving"))
        return seed_of_point(pairs, record, settings)
    ds = opened(store, read_pairs("--select", select, read_number))
    prepare_kernels(show, *kernels_for(system_of(ds.attrs), ORBITS))
    return seed_of_cell(ds, at)


def _print(found: Branches) -> None:
    """A table of events, and how each branch ends."""
    cycles = [CYCLE_PERIOD.name] if found.system.definition.unforced else []
    events = [event for traced in found.traced for event in traced.run.events]
    rows = [
        (
            str(each["branch"]),
            each["kind"].replace("_", " "),
            f"{each[found.along]:.12g}",
            *(f"{each[name]:.10g}" for name in cycles),
            orbit_name(event.point.orbit.itinerary, found.system),
            str(each["unstable"]),
            str(each["leaving"]) if each["leaving"] >= 0 else "",
        )
        for each, event in zip(_records(found.events), events, strict=True)
    ]
    if rows:
        print_table(
            "",
            [
                "branch",
                "event",
                found.along,
                *(name.replace("_", " ") for name in cycles),
                "orbit",
                "unstable",
                "leaving",
            ],
            rows,
        )
    for number, each in enumerate(_records(found.branches)):
        left = f", leaves branch {each['leaves']}" if each["leaves"] >= 0 else ""
        traced = found.traced[number]
        (first, *_, last), name = traced.values, orbit_name(traced.itinerary, found.system)
        ends = [f"{first:.10g} ({each['first_end']})", f"{last:.10g} ({each['last_end']})"]
        reach = " to ".join(ends).replace("_", " ")
        click.echo(f"branch {number}: {name}{left}, {each['points']} points, {found.along} {reach}")
    for event in found.untried:
        kind, value = event.event.kind.replace("_", " "), event.event.point.values[0]
        click.echo(f"not followed: branch {event.branch}, {kind} at {value:.10g}: {event.why}")
    click.echo(f"{plural(len(rows), 'event')} on {plural(len(found.traced), 'branch', 'branches')}")


def _records(frame: "pandas.DataFrame") -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = frame.to_dict("records")
    return found


def _write(found: Branches, out: Path, look: dict[str, Any]) -> None:
    """The points as CSV, everything as JSON, or a picture."""
    suffix = out.suffix.lower()
    if suffix == ".csv":
        write_rows(out, _records(found.points))
    elif suffix == ".json":
        with written_whole(out) as unfinished:
            unfinished.write_text(to_json(summary(found) | {"points": _records(found.points)}) + "\n")
    else:
        render(found, out, **look)
