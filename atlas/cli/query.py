"""The command that asks a store: a cell, shares, windows of one class, extremes, or the cells of a part as a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from atlas.cli.options import (
    examples,
    input_errors,
    json_option,
    read_bounds,
    read_number,
    read_pairs,
    read_whole,
    say,
    select_option,
    store_argument,
    window_option,
)
from atlas.cli.output import print_attractors, print_table, text, to_json
from atlas.errors import InputError
from atlas.query.attractors import leading
from atlas.query.open import open_atlas
from atlas.query.window import select as selected
from atlas.service.progress import reason_lines
from atlas.text import plural

if TYPE_CHECKING:
    import xarray as xr

SHOWN = 40
"""Rows that a terminal gets to see; ``--json`` and ``-o`` have all."""
_PATTERN = ("regime", "period", "impacts")


@click.command(
    epilog=examples(
        "atlas query plane.zarr --window omega=2:3",
        "atlas query plane.zarr --at omega=3 --at b=0.15",
        "atlas query plane.zarr --windows period=3",
        "atlas query plane.zarr --extremes max_impact_speed --by period",
        "atlas query plane.zarr --window omega=2:3 -o part.csv",
    )
)
@store_argument
@click.option("--at", "point", metavar="NAME=VALUE", multiple=True, help="The cell nearest to a point; one per axis.")
@window_option
@select_option
@click.option(
    "--windows",
    metavar="CLASS",
    help="Connected windows of one class: period=3, impacts=3-2-2, regime=chaotic, or period for all periods.",
)
@click.option("--least", type=int, metavar="CELLS", help="With --windows: only those of so many cells. Default: 1.")
@click.option("--extremes", metavar="VARIABLE", help="Where a variable such as largest is smallest and largest.")
@click.option("--basins", is_flag=True, help="Shares, entropy and boundary of the basins of a plane of initial states.")
@click.option("--by", metavar="CLASS", help="With --extremes: in each regime (default), period, impacts; or plane.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="Write the cells of the window to a .csv or .nc (netCDF) file; windows of a class or extremes to a .csv file.",
)
@json_option
def query(
    store: str,
    point: tuple[str, ...],
    window: tuple[str, ...],
    select: tuple[str, ...],
    windows: str | None,
    least: int | None,
    extremes: str | None,
    basins: bool,
    by: str | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """What STORE holds: the share of each regime, unless another question is asked.

    At a point, in connected windows of one class, or where a variable has its extremes; everywhere, or where --window
    limits the axes. Shares are of the area in the axes' own units. Also see: atlas render.
    """
    from atlas.query.reads import counted

    questions = (("--at", point), ("--windows", windows), ("--extremes", extremes), ("--basins", basins))
    asked = [name for name, given in questions if given]
    if len(asked) > 1:
        raise InputError(f"{asked[0]} and {asked[1]} are two questions; give one of the two")
    if point and window:
        raise InputError("--at asks for one cell, --window for a part of the plane; give one of the two")
    if out is not None and point:
        raise InputError("--at prints one cell, --out writes a window; give one of the two")
    if out is not None and basins:
        raise InputError("--basins prints its answer, -o writes a window; give one of the two")
    if least is not None and not windows:
        raise InputError("--least goes with --windows: it leaves out windows of fewer cells")
    if by is not None and not extremes:
        raise InputError("--by goes with --extremes; windows name their class themselves: --windows period=3")
    wanted, bounds = read_pairs("--at", point, read_number), read_pairs("--window", window, read_bounds)
    plane = read_pairs("--select", select, read_number)
    with input_errors(), counted() as reads:
        ds = selected(open_atlas(store), plane)
        if windows:
            _windows(leading(ds), windows, bounds, 1 if least is None else least, out, as_json)
        elif basins:
            _basins(ds, bounds, as_json)
        elif extremes:
            _extremes(leading(ds), extremes, by or "regime", bounds, out, as_json)
        else:
            _cells(ds, wanted, bounds, out, as_json)
    if not point and out is None and not as_json:
        say(f"{plural(reads.chunks, 'chunk')} read from the store")


def _cells(
    ds: "xr.Dataset", point: dict[str, float], bounds: dict[str, tuple[float, float]], out: Path | None, as_json: bool
) -> None:
    """One cell, the shares in a window, or its cells as a file."""
    from atlas.query import queries as questions
    from atlas.query.export import check_path, export

    found: dict[str, Any]
    if out is not None:
        check_path(out)
    if out is not None:
        say("reading and writing")
        found = {"file": str(out), "cells": export(ds, out, bounds)}
    else:
        found = questions.at(ds, point) if point else dict(questions.fractions(leading(ds), bounds))
    why = questions.reasons(leading(ds), bounds) if {"undetermined", "invalid", "failed"} & found.keys() else {}
    if as_json:
        click.echo(to_json(found | ({"reasons": why} if why else {})))
    elif point or out:
        several = list(found.pop("coexisting", []))
        print_table("", ["", ""], [(name, text(value)) for name, value in found.items()])
        print_attractors(several)
    else:
        print_table("", ["", ""], [(name, f"{100 * share:.2f} %") for name, share in found.items()])
        click.echo("".join(f"{line}\n" for line in reason_lines(why)), nl=False)


def _basins(ds: "xr.Dataset", bounds: dict[str, tuple[float, float]], as_json: bool) -> None:
    """Shares, entropy and boundary of basins."""
    from atlas.query.basins import basins

    found = basins(ds, bounds)
    if as_json:
        click.echo(to_json(found))
        return
    several = found.pop("attractors")
    print_table("", ["", ""], [(name, text(value)) for name, value in found.items()])
    print_attractors(several)


def _windows(
    ds: "xr.Dataset", given: str, bounds: dict[str, tuple[float, float]], least: int, out: Path | None, as_json: bool
) -> None:
    """Connected windows of one class."""
    from atlas.query.connected import windows

    by, equals, value = given.partition("=")
    if by not in _PATTERN:
        hint = "" if ":" not in value else f"; --window {given} limits an axis"
        raise InputError(f"--windows {given}: must be {', '.join(_PATTERN)}, or one of them =VALUE{hint}")
    meant = read_whole("--windows period", value) if equals and by == "period" else value if equals else None
    _check_csv(out)
    found = windows(ds, by, meant, bounds, least)
    if _answered({"by": by, "windows": found}, found, [_flat(each) for each in found], out, as_json):
        return
    none = "no such window" if not found else ""
    rows = [
        (
            str(each["label"]),
            str(each[by]),
            str(each["cells"]),
            f"{each['area']:.4g}",
            f"{100 * each['share']:.3g} %",
            *(f"{value:.6g}" for value in each["centre"].values()),
            *(f"{low:.6g} to {high:.6g}" for low, high in each["box"].values()),
            ", ".join(each["cut"]),
        )
        for each in found[:SHOWN]
    ]
    axes = list(found[0]["centre"]) if found else []
    columns = ["", by, "cells", "area", "share", *(f"centre {name}" for name in axes), *axes, "cut by"]
    if rows:
        print_table("", columns, rows)
    if len(found) > SHOWN:
        rest = sum(each["share"] for each in found[SHOWN:])
        none = f"and {len(found) - SHOWN} smaller ones, {100 * rest:.3g} % in all: --json or -o FILE.csv lists them"
    total = sum(each["share"] for each in found)
    click.echo(none or f"{plural(len(found), 'window')}, {100 * total:.3g} % in all")


def _extremes(
    ds: "xr.Dataset", name: str, by: str, bounds: dict[str, tuple[float, float]], out: Path | None, as_json: bool
) -> None:
    """Where a variable has its smallest and its largest value."""
    from atlas.query.extremes import extremes

    _check_csv(out)
    found = extremes(ds, name, by, bounds)
    if _answered({"variable": name, "by": by, "extremes": found}, found, found, out, as_json):
        return
    if not found:
        click.echo(f"no cell has a value of {name}")
        return
    columns = [key for key in found[0] if key != "cells"]
    print_table("", columns, [tuple(text(each[key]) for key in columns) for each in found])


def _answered(
    message: Mapping[str, Any],
    found: Sequence[Mapping[str, Any]],
    rows: Sequence[Mapping[str, Any]],
    out: Path | None,
    as_json: bool,
) -> bool:
    """Write the rows where a file is asked for, print JSON where that is; False where neither is."""
    if out is not None:
        from atlas.query.export import write_rows

        write_rows(out, rows)
        message = {"file": str(out), "rows": len(found)}
        if not as_json:
            print_table("", ["", ""], [(name, text(value)) for name, value in message.items()])
    if as_json:
        click.echo(to_json(message))
    return out is not None or as_json


def _check_csv(out: Path | None) -> None:
    if out is not None and out.suffix.lower() != ".csv":
        raise InputError(f"{out.name}: a list is written as .csv, found {out.suffix or 'no suffix'}")


def _flat(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A window as one row: a column for each axis of its centre, its cell and its box."""
    row = {key: entry[key] for key in entry if key not in ("centre", "cell", "box", "cut")}
    for key in ("centre", "cell"):
        row |= {f"{key}_{name}": value for name, value in entry[key].items()}
    for name, (low, high) in entry["box"].items():
        row |= {f"{name}_from": low, f"{name}_to": high}
    return row | {"cut": ", ".join(entry["cut"])}
