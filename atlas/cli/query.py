"""Commands that query a store: shares of regimes, one cell, connected regions, extremes, basins, an export."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from atlas.argument_checks import validate_suffix
from atlas.cli.options import (
    Bounds,
    Numbers,
    at_option,
    examples,
    input_errors,
    json_option,
    open_selection,
    out_option,
    print_status,
    read_whole,
    select_option,
    store_argument,
    window_option,
)
from atlas.cli.output import print_attractors, print_table, text, to_json
from atlas.errors import InputError
from atlas.formatting import plural
from atlas.query.attractors import select_dominant
from atlas.query.classes import parse_class
from atlas.service.progress import reason_lines
from atlas.spec.laws import law_lines, uses_of_cell
from atlas.spec.system import stored_system

if TYPE_CHECKING:
    import xarray as xr

    from atlas.query.window import Window

MAX_ROWS = 40
"""Maximum number of rows that a terminal shows; ``--json`` and ``-o`` have all."""
_PATTERN = ("regime", "period", "impacts")
_list_option = out_option("Write the whole list to a .csv file instead.")


@click.command(
    epilog=examples("atlas query plane.zarr --window omega=2:3", "atlas query plane.zarr --at omega=3 --at b=0.15")
)
@store_argument
@at_option
@window_option
@select_option
@json_option
def query(store: str, point: Numbers, window: Bounds, select: Numbers, as_json: bool) -> None:
    """Print the share of each regime in STORE or in a window of it; with --at all results of one cell.

    Shares are of the area in the axes' own units. Also see: atlas find, export, plot.
    """
    if point and window:
        raise InputError("--at selects one cell, --window a part of the plane; give only one")
    with _asked(store, select, window, counted=not point and not as_json) as (ds, bounds):
        from atlas.query import queries as questions

        results: dict[str, Any] = (
            questions.nearest_cell(ds, point) if point else dict(questions.fractions(select_dominant(ds), bounds))
        )
        why = (
            questions.count_reasons(select_dominant(ds), bounds)
            if {"undetermined", "invalid", "failed"} & results.keys()
            else {}
        )
        if as_json:
            click.echo(to_json(results | ({"reasons": why} if why else {})))
            return
        if point:
            system = stored_system(ds.attrs)
            used = uses_of_cell(system, results) if system else {}
            _print_values(results, "coexisting")
        else:
            used = questions.laws(select_dominant(ds), bounds)
            shown = [(name, f"{100 * share:.2f} %") for name, share in results.items()]
            print_table("", ["regime", f"share of {_measured(select_dominant(ds))}"], shown)
        click.echo("".join(f"{line}\n" for line in (*reason_lines(why), *law_lines(used))), nl=False)


@click.command(
    epilog=examples(
        "atlas export plane.zarr --window omega=2:3 -o part.csv", "atlas export stack.zarr --select R=0.7 -o plane.nc"
    )
)
@store_argument
@window_option
@select_option
@out_option("The file: .csv, or .nc for netCDF.", required=True)
@json_option
def export(store: str, window: Bounds, select: Numbers, out: Path, as_json: bool) -> None:
    """Write the cells of STORE, or of a window of it, to a CSV or netCDF file."""
    from atlas.query.export import FORMATS, check_writable
    from atlas.query.export import export as write

    validate_suffix(out, FORMATS)
    check_writable(out)
    with _asked(store, select, window) as (ds, bounds):
        print_status("reading and writing")
        message = {"file": str(out), "cells": write(ds, out, bounds)}
        click.echo(to_json(message)) if as_json else _print_values(message)


@click.command("basins", epilog=examples("atlas attractors basins basins.zarr"))
@store_argument
@window_option
@select_option
@json_option
def basin_measures(store: str, window: Bounds, select: Numbers, as_json: bool) -> None:
    """Shares (basin stability), entropy and boundary dimension of the basins in STORE, a plane of initial states."""
    with _asked(store, select, window, counted=not as_json) as (ds, bounds):
        from atlas.query.basins import basins

        measures = basins(ds, bounds)
        click.echo(to_json(measures)) if as_json else _print_values(measures, "attractors")


@click.command(
    epilog=examples(
        "atlas find regions plane.zarr chaotic", "atlas find regions plane.zarr period --min-cells 10 -o periods.csv"
    )
)
@store_argument
@click.argument("class_", metavar="CLASS")
@window_option
@select_option
@click.option(
    "--min-cells", type=int, default=1, show_default=True, metavar="N", help="Only regions of N cells or more."
)
@_list_option
@json_option
def regions(
    store: str,
    class_: str,
    window: Bounds,
    select: Numbers,
    min_cells: int,
    out: Path | None,
    as_json: bool,
) -> None:
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
        _check_list(out)
    with _asked(store, select, window, counted=out is None and not as_json) as (ds, bounds):
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
@store_argument
@click.argument("variable")
@click.option("--by", metavar="CLASS", default="regime", show_default=True, help="regime, period or impacts; or all.")
@window_option
@select_option
@_list_option
@json_option
def extremes(
    store: str,
    variable: str,
    by: str,
    window: Bounds,
    select: Numbers,
    out: Path | None,
    as_json: bool,
) -> None:
    """Where a VARIABLE of STORE, such as largest, has its smallest and largest values, in each class of cells."""
    if out is not None:
        _check_list(out)
    with _asked(store, select, window, counted=out is None and not as_json) as (ds, bounds):
        from atlas.query.extremes import extremes as find

        rows = find(select_dominant(ds), variable, by, bounds)
        if _answered({"variable": variable, "by": by, "extremes": rows}, rows, out, as_json):
            return
        if not rows:
            click.echo(f"no cell has a value of {variable}")
            return
        columns = [key for key in rows[0] if key != "cells"]
        print_table("", columns, [tuple(text(row[key]) for key in columns) for row in rows])


def _measured(ds: "xr.Dataset") -> str:
    """Return what the shares of regimes refer to, since cells of unequal size have unequal weight."""
    from atlas.query.window import axis_names
    from atlas.spec.points import POINT

    names = axis_names(ds)
    return "the points" if names == (POINT,) else ("the length", "the area", "the volume")[len(names) - 1]


def _check_list(out: Path) -> None:
    """Raise InputError unless a list can be written to ``out``."""
    from atlas.query.export import check_writable

    validate_suffix(out, [".csv"])
    check_writable(out)


@contextmanager
def _asked(
    store: str, select: Numbers, window: Bounds, counted: bool = False
) -> Iterator[tuple["xr.Dataset", "Window"]]:
    """Yield the dataset and the window of a query; with ``counted`` print the number of chunks read at the end."""
    from atlas.query import read_counter

    with input_errors(), read_counter.count_chunk_reads() as cost:
        yield open_selection(store, select), window
    if counted:
        print_status(f"{plural(cost.chunks, 'chunk')} read from the store")


def _print_values(values: dict[str, Any], listed: str = "") -> None:
    """Print names and values as a table, and the attractors that the value ``listed`` contains as another."""
    several = list(values.pop(listed, []))
    print_table("", ["", ""], [(name, text(value)) for name, value in values.items()])
    print_attractors(several)


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
    """Write the rows to the file of -o, or print JSON for --json; return False without either option."""
    if out is not None:
        import pandas as pd

        from atlas.query.export import write_table

        write_table(out, pd.DataFrame(rows))
        message = {"file": str(out), "rows": len(rows)}
        if not as_json:
            _print_values(dict(message))
    if as_json:
        click.echo(to_json(message))
    return out is not None or as_json
