"""Commands that ask a store: status, verify, query."""

import sys
from pathlib import Path
from typing import Any

import click

from atlas.check.verify import verify as verify_store
from atlas.cli.options import (
    input_errors,
    json_option,
    read_bounds,
    read_number,
    read_pairs,
    say,
    store_argument,
    timing_of,
    window_option,
)
from atlas.cli.output import print_table, text, to_json
from atlas.errors import InputError
from atlas.query.open import open_atlas
from atlas.service.progress import reason_lines, reporter
from atlas.service.status import Census, read_status, watch
from atlas.store.store import read_header

WATCH_SECONDS = 2.0
"""Between two looks of ``atlas status --watch``."""


@click.command()
@store_argument
@click.option("--watch", "watching", is_flag=True, help="Until it is complete, or no run is at work on it.")
@json_option
@click.pass_context
def status(ctx: click.Context, store: str, watching: bool, as_json: bool) -> None:
    """How far STORE is: tiles, cells and regimes done, and the run at work on it."""
    header, timing = read_header(store), timing_of(ctx)
    if watching:
        with reporter(sys.stderr) as show:
            for now in watch(Census(header, timing), WATCH_SECONDS):
                show(now.progress)
    found = read_status(header, timing)
    click.echo(to_json(found.as_dict()) if as_json else str(found))


@click.command()
@store_argument
@click.option("--repair", is_flag=True, help="Drop each bad tile, so that atlas run solves it again.")
@click.option(
    "--sample", type=click.IntRange(min=0), metavar="N", default=32, show_default=True, help="Cells to solve again."
)
@json_option
@click.pass_context
def verify(ctx: click.Context, store: str, repair: bool, sample: int, as_json: bool) -> None:
    """Read all of STORE and check it: checksums, completeness, consistency, a sample of cells solved again.

    Exit code 0: complete and fine; 1: something found. For a store that no run is at work on.
    """
    with reporter(sys.stderr) as show:
        report = verify_store(store, sample=sample, repair=repair, on_progress=show)
    click.echo(to_json(report.as_dict()) if as_json else str(report))
    if not report.fine:
        ctx.exit(1)


@click.command()
@store_argument
@click.option("--at", "point", metavar="NAME=VALUE", multiple=True, help="The cell nearest to a point; one per axis.")
@window_option
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="Write the cells of the window to a .csv or .nc (netCDF) file."
)
@json_option
def query(store: str, point: tuple[str, ...], window: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """What STORE holds at a point, or the share of each regime in a window (default: everywhere), or a window's cells.

    Shares are of the area in the axes' own units. Also see: atlas render.
    """
    from atlas.query import queries as questions
    from atlas.query.export import check_path, export
    from atlas.query.reads import counted

    if point and window:
        raise InputError("--at asks for one cell, --window for shares; give one of the two")
    wanted = read_pairs("--at", point, read_number)
    bounds = read_pairs("--window", window, read_bounds)
    if out is not None and point:
        raise InputError("--at prints one cell, --out writes a window; give one of the two")
    found: dict[str, Any]
    with input_errors(), counted() as reads:
        if out is not None:
            check_path(out)
        dataset = open_atlas(store)
        if out is not None:
            say("reading and writing")
            found = {"file": str(out), "cells": export(dataset, out, bounds)}
        else:
            found = questions.at(dataset, wanted) if point else questions.fractions(dataset, bounds)
        why = questions.reasons(dataset, bounds) if {"undetermined", "invalid", "failed"} & found.keys() else {}
    if as_json:
        click.echo(to_json(found | ({"reasons": why} if why else {})))
    elif point or out:
        print_table("", ["", ""], [(name, text(value)) for name, value in found.items()])
    else:
        print_table("", ["", ""], [(name, f"{100 * share:.2f} %") for name, share in found.items()])
        click.echo("".join(f"{line}\n" for line in reason_lines(why)), nl=False)
        say(f"{reads.chunks} chunks read")
