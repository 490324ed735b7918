"""The command ``atlas``: its commands put together, and how their errors end.

Heavy imports wait until a command needs them, so that help comes at once.
"""

import sys
from io import TextIOWrapper
from typing import Any

import click

from atlas.cli.branch import branch
from atlas.cli.cell import example, point, portrait, systems
from atlas.cli.compare import compare
from atlas.cli.curves import curves
from atlas.cli.demo import demo
from atlas.cli.explore import explore
from atlas.cli.labels import label
from atlas.cli.measures import measure
from atlas.cli.options import INTERRUPTED, examples
from atlas.cli.pictures import figures, render
from atlas.cli.query import basin_measures, export, extremes, query, regions
from atlas.cli.run import basins, cancel, extend, plan, retry, run, submit
from atlas.cli.saddles import saddles
from atlas.cli.stability import stability
from atlas.cli.store import cite, pack, status, verify
from atlas.errors import InputError, RunError, one_line


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

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The commands in the order of their use, with summaries that are never cut."""
        whole = 1000  # characters
        with formatter.section("Commands"):
            formatter.write_dl([(name, each.get_short_help_str(whole)) for name, each in self.commands.items()])


@click.group(
    "atlas",
    cls=_Group,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=examples(
        "atlas example omega-b > plane.toml",
        "atlas run plane.toml -o plane.zarr",
        "atlas render plane.zarr -o chaos.png",
    ),
)
@click.version_option(package_name="impact-atlas", prog_name="atlas")
def main() -> None:
    """Maps of the dynamics of impacting machines over planes of parameters.

    A SPEC is a TOML file, or the name of an example in the package; a STORE is a folder, a URL or a zip file that holds
    an atlas. Exit codes: 0 done, 1 failed, 2 bad usage or input, 130 interrupted.
    """


for command in (
    demo,
    example,
    plan,
    run,
    submit,
    cancel,
    retry,
    extend,
    basins,
    status,
    verify,
    pack,
    cite,
    query,
    regions,
    extremes,
    basin_measures,
    export,
    compare,
    curves,
    label,
    measure,
    render,
    figures,
    point,
    stability,
    saddles,
    portrait,
    branch,
    explore,
    systems,
):
    main.add_command(command)
