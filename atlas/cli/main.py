"""The command ``atlas``: its table of commands, and how errors end it.

Heavy imports wait until a command needs them, so that help appears at once and no command waits for another's imports.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click

from atlas.cli.options import INTERRUPTED, examples
from atlas.errors import InputError, RunError, brief_repr, to_one_line
from workers.model.parameter import unknown_name

_Table = Mapping[str, Mapping[str, tuple[str, str]]]
"""Commands by section of the help and by name. Each has the function, as "module:function", and a summary of one line.

Sections and commands are in the order of their use.
"""
_COMMANDS: _Table = {
    "To begin": {
        "demo": ("begin.demo", "Compute, draw and count a plane, in a minute or two."),
        "example": ("begin.example", "Print a packaged spec to start from, or list all."),
        "schema": ("begin.schema", "Print the JSON Schema of a spec, for editors."),
        "systems": ("begin.systems", "List the machines that can be solved, or describe one."),
    },
    "Compute": {
        "plan": ("run.plan", "Estimate the cost of SPEC: cells, bytes, time."),
        "run": ("run.run", "Compute SPEC into a store, or resume an interrupted run."),
        "extend": ("run.extend", "Make a larger or finer atlas of STORE."),
        "retry": ("run.retry", "Solve cells of STORE again, with more periods."),
        "status": ("store.status", "Show the progress of STORE and the run that writes it."),
        "cancel": ("run.cancel", "Stop the run that writes STORE."),
    },
    "Look": {
        "plot": ("pictures.plot", "Draw STORES: maps, sweeps, stacks."),
        "explore": ("explore.explore", "Look anywhere in a plane, in the browser."),
    },
    "Ask": {
        "query": ("query.query", "Print the share of each regime, or one cell."),
        "find": ("main.find", "Find regions, extremes and exact curves."),
        "attractors": ("main.attractors", "Label and measure attractors and their basins."),
        "compare": ("compare.compare", "Compare two stores of the same axes."),
    },
    "One cell": {
        "point": ("cell.point", "Solve one cell and print its results."),
        "portrait": ("cell.portrait", "Draw the motion of one cell."),
        "trace": ("cell.trace", "Print the motion of one cell in time."),
        "branch": ("branch.branch", "Follow the orbit of a cell along a parameter."),
    },
    "Keep": {
        "verify": ("store.verify", "Read all of STORE and check it, or repair it."),
        "pack": ("store.pack", "Pack STORE into one zip file."),
        "export": ("query.export", "Write cells to a CSV or netCDF file."),
        "cite": ("store.cite", "Print BibTeX entries to cite for STORE."),
    },
}
_FIND: _Table = {
    "Commands": {
        "regions": ("find.regions", "Connected regions of cells of one class."),
        "extremes": ("find.extremes", "Where a variable is smallest and largest."),
        "curves": ("find.find_curves", "The exact curves that bound the regions of a plane."),
    }
}
_ATTRACTORS: _Table = {
    "Of a store": {
        "label": ("attractors.label_attractors", "One label per branch, from cell to cell."),
        "measure": ("attractors.measure_attractors", "How stable the attractors of all cells are."),
        "basins": ("query.basin_measures", "Shares, entropy and boundary dimension of basins."),
    },
    "Of one cell": {
        "stability": ("attractors.stability", "How stable each attractor is."),
        "saddles": ("attractors.saddles", "The unstable orbits between the basins."),
    },
}
_MEANT = {
    "draw": "plot", "show": "plot", "render": "plot", "map": "plot", "info": "status", "ask": "query", "at": "query",
    "fractions": "query", "regions": "find regions", "extremes": "find extremes", "curves": "find curves",
    "label": "attractors label", "labels": "attractors label", "measure": "attractors measure",
    "stability": "attractors stability", "saddles": "attractors saddles", "basins": "run", "submit": "run",
    "solve": "run", "compute": "run", "new": "example", "examples": "example", "check": "verify", "repair": "verify",
    "help": "--help",
}  # fmt: skip
"""Words that a newcomer may try in place of a command, with the command that is meant."""


class _Commands(Mapping[str, click.Command]):
    """The commands of a table by name, as click commands. A command's module is imported when the command is looked
    up.
    """

    def __init__(self, table: _Table) -> None:
        self._homes = {name: home for section in table.values() for name, (home, _) in section.items()}

    def __getitem__(self, name: str) -> click.Command:
        module, _, function = self._homes[name].partition(".")
        command: click.Command = getattr(import_module(f"atlas.cli.{module}"), function)
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(self._homes)

    def __len__(self) -> int:
        return len(self._homes)


class _BadInput(click.ClickException):
    """An error that ends the program with one line on stderr and exit code 2."""

    exit_code = 2


def _flush_or_drop(stream: Any) -> None:
    """Write out the buffer of a stream, or drop it if the reader of a pipe has gone: Python would complain at exit."""
    try:
        stream.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _bad_usage(error: click.UsageError) -> _BadInput:
    """Convert click's error about a wrong command line to an error of one line, without the usage text."""
    where = error.ctx.command_path if error.ctx else "atlas"
    return _BadInput(to_one_line(f"{error.format_message().rstrip('.')} (see {where} --help)"))


class _Group(click.Group):
    """A group of commands. Any error ends in one line and an exit code: 1 failed, 2 bad usage or input, 130
    interrupted.
    """

    def __init__(self, name: str, table: _Table, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.commands, self.table = _Commands(table), table  # type: ignore[assignment]  # click declares a dict

    def main(self, *args: Any, **kwargs: Any) -> Any:
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:  # the shell closed it, as by >&-
                setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
            stream = getattr(sys, name)
            # Windows gives a pipe or a file the code page of the language.
            if isinstance(stream, TextIOWrapper) and not stream.isatty() and stream.encoding.lower() != "utf-8":
                stream.reconfigure(encoding="utf-8")
        try:
            return super().main(*args, **kwargs)
        finally:
            for stream in (sys.stdout, sys.stderr):
                _flush_or_drop(stream)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args:  # click shows the help
            return super().parse_args(ctx, args)
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            raise _bad_usage(error) from None
        except BrokenPipeError:
            ctx.exit()

    def invoke(self, ctx: click.Context) -> Any:
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
            return result
        except click.UsageError as error:
            raise _bad_usage(error) from None
        except InputError as error:
            raise _BadInput(str(error)) from None
        except RunError as error:
            raise click.ClickException(str(error)) from None
        except OSError as error:  # a disk or a network that gave up in the middle
            from atlas.platform import is_unread

            if isinstance(error, BrokenPipeError) and is_unread(sys.stdout):
                ctx.exit()
            where = f"{error.filename}: " if error.filename else ""
            raise click.ClickException(f"{where}{error.strerror or error}") from None
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            if args[0] in _MEANT and ctx.parent is None:
                raise InputError(f"unknown command {brief_repr(args[0])}; did you mean 'atlas {_MEANT[args[0]]}'?")
            raise InputError(unknown_name("command", args[0], self.commands))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands of the group into its help, by section, a line each; no command's module is imported."""
        width = max(map(len, self.commands))
        for title, section in self.table.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), summary) for name, (_, summary) in section.items()])


@click.group(
    "find",
    cls=_Group,
    table=_FIND,
    epilog=examples("atlas find regions plane.zarr chaotic", "atlas find curves plane.zarr -o curves.csv"),
)
def find() -> None:
    """Find regions, extremes and exact curves in STORE."""


@click.group(
    "attractors",
    cls=_Group,
    table=_ATTRACTORS,
    epilog=examples("atlas attractors measure plane.zarr", "atlas attractors stability --set omega=4 --set b=0.1"),
)
def attractors() -> None:
    """Label and measure the attractors of STORE and their basins, or those of one cell."""


@click.group(
    "atlas",
    cls=_Group,
    table=_COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=examples(
        "atlas example omega-b > plane.toml",
        "atlas run plane.toml -o plane.zarr",
        "atlas plot plane.zarr -o chaos.png",
    ),
)
@click.version_option(package_name="impact-atlas", prog_name="atlas")
def main() -> None:
    """Maps of the dynamics of impacting machines over planes of parameters.

    SPEC is a TOML file or the name of an example; STORE is a folder, a URL or a zip file that holds an atlas. Exit
    codes: 0 done, 1 failed, 2 bad usage or input, 130 interrupted.
    """
