"""Commands that ask a store: shares of regimes, one cell, basins, an export."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from atlas.cli.cell_options import at_option
from atlas.cli.options import (
    Bounds,
    Numbers,
    examples,
    input_errors,
    json_option,
    open_selection,
    out_option,
    print_status,
    select_option,
    store_argument,
    window_option,
)
from atlas.cli.output import print_table, print_values, to_json
from atlas.errors import InputError
from atlas.formatting import plural
from atlas.query.attractors import select_dominant
from atlas.service.progress import reason_lines
from atlas.spec.laws import law_lines, uses_of_cell
from atlas.spec.system import stored_system

if TYPE_CHECKING:
    import xarray as xr

    from atlas.query.window import Window


@dataclass(frozen=True)
class Question:
    """A question to a store: the store, values of --select, and the window of --window."""

    store: Any
    select: Numbers
    window: Bounds

    @contextmanager
    def open(self, counted: bool = False) -> Iterator[tuple["xr.Dataset", "Window"]]:
        """Open the store, and yield the selected dataset and the window.

        With ``counted`` print the number of chunks read at the end.
        """
        from atlas.query import read_counter

        with input_errors(), read_counter.count_chunk_reads() as cost:
            yield open_selection(self.store, self.select), self.window
        if counted:
            print_status(f"{plural(cost.chunks, 'chunk')} read from the store")


def question_options(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with STORE, --window and --select; the command receives a Question."""

    @store_argument
    @window_option
    @select_option
    @wraps(command)
    def wrapper(store: Any, select: Numbers, window: Bounds, **arguments: Any) -> None:
        command(question=Question(store, select, window), **arguments)

    return wrapper


@click.command(
    epilog=examples("atlas query plane.zarr --window omega=2:3", "atlas query plane.zarr --at omega=3 --at b=0.15")
)
@question_options
@at_option
@json_option
def query(question: Question, point: Numbers, as_json: bool) -> None:
    """Print the share of each regime in STORE or in a window of it; with --at all results of one cell.

    Shares are of the area in the axes' own units. Also see: atlas find, export, plot.
    """
    if point and question.window:
        raise InputError("--at selects one cell, --window a part of the plane; give only one")
    with question.open(counted=not point and not as_json) as (ds, bounds):
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
            print_values(results, "coexisting")
        else:
            used = questions.laws(select_dominant(ds), bounds)
            rows = [(name, f"{100 * share:.2f} %") for name, share in results.items()]
            print_table("", ["regime", f"share of {_measured(select_dominant(ds))}"], rows)
        click.echo("".join(f"{line}\n" for line in (*reason_lines(why), *law_lines(used))), nl=False)


@click.command(
    epilog=examples(
        "atlas export plane.zarr --window omega=2:3 -o part.csv", "atlas export stack.zarr --select R=0.7 -o plane.nc"
    )
)
@question_options
@out_option("The file: .csv, or .nc for netCDF.", required=True)
@json_option
def export(question: Question, out: Path, as_json: bool) -> None:
    """Write the cells of STORE, or of a window of it, to a CSV or netCDF file."""
    from atlas.query.export import FORMATS, check_target
    from atlas.query.export import export as write

    check_target(out, FORMATS)
    with question.open() as (ds, bounds):
        print_status("reading and writing")
        message = {"file": str(out), "cells": write(ds, out, bounds)}
        click.echo(to_json(message)) if as_json else print_values(message)


@click.command("basins", epilog=examples("atlas attractors basins basins.zarr"))
@question_options
@json_option
def basin_measures(question: Question, as_json: bool) -> None:
    """Shares (basin stability), entropy and boundary dimension of the basins in STORE, a plane of initial states."""
    with question.open(counted=not as_json) as (ds, bounds):
        from atlas.query.basins import basins

        measures = basins(ds, bounds)
        click.echo(to_json(measures)) if as_json else print_values(measures, "attractors")


def _measured(ds: "xr.Dataset") -> str:
    """Return a text about what the shares of regimes refer to: cells of unequal size count by their area."""
    from atlas.query.window import axis_names
    from atlas.spec.points import POINT

    names = axis_names(ds)
    return "the points" if names == (POINT,) else ("the length", "the area", "the volume")[len(names) - 1]
