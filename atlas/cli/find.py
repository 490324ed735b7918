"""Commands that find something in a plane: connected regions, extremes and exact curves."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from atlas.cli.options import (
    examples,
    json_option,
    out_option,
    read_whole,
    store_argument,
    worker_options,
)
from atlas.cli.output import emit, print_table, print_values, text, to_json
from atlas.cli.progress import resumable
from atlas.cli.query import Question, question_options
from atlas.errors import InputError
from atlas.formatting import plural
from atlas.orbits.curves.export import FORMATS, export
from atlas.orbits.curves.settings import CurveSettings
from atlas.query.attractors import select_dominant
from atlas.query.classes import parse_class
from atlas.query.export import check_target, write_table
from atlas.service.options import RunOptions

MAX_ROWS = 40
"""Maximum number of rows of a table that a terminal shows; ``--json`` and ``-o`` give all."""
_PATTERN = ("regime", "period", "impacts")
_list_option = out_option("Write the whole list to a .csv file instead.")
_DEFAULTS = {budget.name: budget.default for budget in fields(CurveSettings)}


def _budget(name: str, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    option = f"--{name.replace('_', '-')}"
    return click.option(option, type=click.IntRange(min=1), default=_DEFAULTS[name], show_default=True, help=text)


@click.command(
    epilog=examples(
        "atlas find regions plane.zarr chaotic", "atlas find regions plane.zarr period --min-cells 10 -o periods.csv"
    )
)
@question_options
@click.argument("class_", metavar="CLASS")
@click.option(
    "--min-cells", type=int, default=1, show_default=True, metavar="N", help="Only regions of N cells or more."
)
@_list_option
@json_option
def regions(question: Question, class_: str, min_cells: int, out: Path | None, as_json: bool) -> None:
    """Connected regions of STORE whose cells have one CLASS: their size, area, centre and bounds.

    CLASS is period=3, impacts=3-2-2 or a regime, such as chaotic; or period, impacts or regime alone, for all values.
    """
    by, equals, value = class_.partition("=")
    if equals and by not in _PATTERN:
        hint = "" if ":" not in value else f"; --window {class_} limits an axis"
        raise InputError(f"{class_}: must be {', '.join(_PATTERN)}, or one of them =VALUE{hint}")
    meant: object = read_whole("period", value) if equals and by == "period" else value if equals else None
    by, meant = parse_class(by, meant)
    if out is not None:
        check_target(out, [".csv"])
    with question.open(counted=out is None and not as_json) as (ds, bounds):
        from atlas.query import connected_regions

        listed = connected_regions.regions(select_dominant(ds), by, meant, bounds, min_cells)
        rows = [connected_regions.flat(region) for region in listed]
        if not _answered({"by": by, "regions": listed}, rows, out, as_json):
            _print_regions(listed, by)


@click.command(
    epilog=examples(
        "atlas find extremes plane.zarr largest", "atlas find extremes plane.zarr max_impact_speed --by period"
    )
)
@question_options
@click.argument("variable")
@click.option("--by", metavar="CLASS", default="regime", show_default=True, help="regime, period or impacts; or all.")
@_list_option
@json_option
def extremes(question: Question, variable: str, by: str, out: Path | None, as_json: bool) -> None:
    """Where a VARIABLE of STORE, such as largest, has its smallest and largest values, in each class of cells."""
    if out is not None:
        check_target(out, [".csv"])
    with question.open(counted=out is None and not as_json) as (ds, bounds):
        from atlas.query.extremes import extremes as find

        rows = find(select_dominant(ds), variable, by, bounds)
        if _answered({"variable": variable, "by": by, "extremes": rows}, rows, out, as_json):
            return
        if not rows:
            click.echo(f"no cell has a value of {variable}")
            return
        columns = [key for key in rows[0] if key != "cells"]
        print_table("", columns, [tuple(text(row[key]) for key in columns) for row in rows])


@click.command("curves", epilog=examples("atlas find curves plane.zarr", "atlas find curves plane.zarr -o curves.csv"))
@store_argument
@out_option("Also write them to this file, .csv or .json.")
@_budget("edges", "Maximum number of edges beside which events are searched.")
@_budget("curves", "Maximum number of curves to follow.")
@_budget("points", "Maximum number of points of all curves.")
@_budget("min_cells", "Minimum number of cells of a region beside which events are searched.")
@worker_options
@json_option
def find_curves(
    ctx: click.Context, /, store: str, out: Path | None, options: RunOptions, as_json: bool, **budget: int
) -> None:
    """Find the exact curves that bound the regions of STORE, a finished plane: bifurcations and grazes of its orbits.

    The curves are written into STORE; stored curves are not computed again. The command prints the share of the
    borders between regions that the curves explain. The same command resumes a search that was stopped.
    """
    from atlas.service import curves  # imports Numba

    if out is not None:
        check_target(out, FORMATS)
    with resumable(ctx, options) as run_options:
        summary = curves.find_curves(store, CurveSettings(**budget), options=run_options)
    if out is not None:
        export(summary.curves, out)
    emit(summary, as_json)


def _print_regions(listed: Sequence[Mapping[str, Any]], by: str) -> None:
    none = "no such region" if not listed else ""
    rows = [
        (
            str(region["label"]),
            str(region[by]),
            str(region["cells"]),
            f"{region['area']:.4g}",
            f"{100 * region['share']:.3g} %",
            *(f"{value:.6g}" for value in region["centre"].values()),
            *(f"{low:.6g} to {high:.6g}" for low, high in region["box"].values()),
            ", ".join(region["cut"]),
        )
        for region in listed[:MAX_ROWS]
    ]
    axes = list(listed[0]["centre"]) if listed else []
    columns = ["", by, "cells", "area", "share", *(f"centre {name}" for name in axes), *axes, "cut by"]
    if rows:
        print_table("", columns, rows)
    if len(listed) > MAX_ROWS:
        rest = sum(region["share"] for region in listed[MAX_ROWS:])
        none = f"and {len(listed) - MAX_ROWS} smaller ones, {100 * rest:.3g} % in all: --json or -o FILE.csv lists them"
    total = sum(region["share"] for region in listed)
    click.echo(none or f"{plural(len(listed), 'region')}, {100 * total:.3g} % in all")


def _answered(message: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], out: Path | None, as_json: bool) -> bool:
    """Write rows to the file of the option -o, or print ``message`` for --json; return False if neither option is
    given.
    """
    if out is not None:
        import pandas as pd

        write_table(out, pd.DataFrame(rows))
        message = {"file": str(out), "rows": len(rows)}
        if not as_json:
            print_values(message)
    if as_json:
        click.echo(to_json(message))
    return out is not None or as_json
