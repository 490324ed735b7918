"""The command ``atlas``: its commands put together, and how their errors end.

Heavy imports wait until a command needs them, so that help comes at once and no command waits for another's imports.
"""

import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click

from atlas.cli.options import INTERRUPTED, examples
from atlas.errors import InputError, RunError, one_line, shown
from workers.model.parameter import unknown_name

_HOMES = {
    "demo": "demo", "example": "cell", "schema": "cell", "plan": "run", "run": "run", "submit": "run",
    "cancel": "run", "retry": "run", "extend": "run", "basins": "run", "status": "store", "verify": "store",
    "pack": "store", "cite": "store", "query": "query", "regions": "query", "extremes": "query",
    "basin-measures": "query", "export": "query", "compare": "compare", "find-curves": "curves",
    "label-attractors": "labels", "measure-attractors": "measures", "plot": "pictures", "figures": "pictures",
    "point": "cell", "stability": "stability", "saddles": "saddles", "portrait": "cell", "branch": "branch",
    "explore": "explore", "systems": "cell",
}  # fmt: skip
"""The commands in the order of their use, each with its module."""
_MEANT = {
    "draw": "plot", "show": "plot", "render": "plot", "map": "plot", "info": "status", "ask": "query", "at": "query",
    "fractions": "query", "curves": "find-curves", "label": "label-attractors", "labels": "label-attractors",
    "measure": "measure-attractors", "attractors": "point", "solve": "run", "compute": "run", "new": "example",
    "examples": "example", "check": "verify", "repair": "verify", "help": "--help",
}  # fmt: skip
"""Words for a command that a newcomer may try first."""


class _Commands(Mapping[str, click.Command]):
    """The commands by name; looking one up imports its module."""

    def __getitem__(self, name: str) -> click.Command:
        command: click.Command = getattr(import_module(f"atlas.cli.{_HOMES[name]}"), name.replace("-", "_"))
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(_HOMES)

    def __len__(self) -> int:
        return len(_HOMES)


class _BadInput(click.ClickException):
    """One line on stderr, exit code 2."""

    exit_code = 2


def _bad_usage(error: click.UsageError) -> _BadInput:
    """What click says of a wrong command line, without the usage before it."""
    where = error.ctx.command_path if error.ctx else "atlas"
    return _BadInput(one_line(f"{error.format_message().rstrip('.')} (see {where} --help)"))


class _Group(click.Group):
    """Commands whose errors end in one line: 1 failed, 2 bad usage or input, 130 interrupted."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        for stream in (sys.stdout, sys.stderr):
            # Windows gives a pipe or a file the code page of the language.
            if isinstance(stream, TextIOWrapper) and not stream.isatty() and stream.encoding.lower() != "utf-8":
                stream.reconfigure(encoding="utf-8")
        return super().main(*args, **kwargs)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args:  # click shows the help
            return super().parse_args(ctx, args)
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            raise _bad_usage(error) from None

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            raise _bad_usage(error) from None
        except InputError as error:
            raise _BadInput(str(error)) from None
        except RunError as error:
            raise click.ClickException(str(error)) from None
        except OSError as error:  # a disk or a network that gave up in the middle
            where = f"{error.filename}: " if error.filename else ""
            raise click.ClickException(f"{where}{error.strerror or error}") from None
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            if args[0] in _MEANT:
                raise InputError(f"unknown command {shown(args[0])}; did you mean 'atlas {_MEANT[args[0]]}'?")
            raise InputError(unknown_name("command", args[0], self.commands))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The commands in the order of their use, with summaries that are never cut."""
        whole = 1000  # characters
        with formatter.section("Commands"):
            formatter.write_dl([(name, each.get_short_help_str(whole)) for name, each in self.commands.items()])


@click.group(
    "atlas",
    cls=_Group,
    commands=_Commands(),
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

    A SPEC is a TOML file, or the name of an example in the package; a STORE is a folder, a URL or a zip file that holds
    an atlas. Exit codes: 0 done, 1 failed, 2 bad usage or input, 130 interrupted.
    """
