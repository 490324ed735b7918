"""Commands to begin with: the demo, packaged examples and systems, the schema of a spec."""

import json
import textwrap
from pathlib import Path

import click

from atlas.cli.options import PLACE, examples, json_option, print_status
from atlas.cli.output import print_table, to_json
from atlas.spec.equation import equation_of
from atlas.spec.examples import example_names, example_text
from atlas.spec.json_schema import spec_schema
from atlas.spec.laws import step_lines
from atlas.spec.system import parse_system, unused_lines
from workers.model.system import System, find_system, system_names

EXAMPLE = "omega-b"
"""Name of the packaged example that the demo computes."""


@click.command(epilog=examples("atlas demo", "atlas demo my-folder"))
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), default="demo")
@click.pass_context
def demo(ctx: click.Context, folder: Path) -> None:
    """Compute the packaged omega x b plane into FOLDER, by default demo, draw it and print its regimes.

    The demo takes about a minute and a half on two processors, most of it to compile the kernels once. After an
    interruption the same command resumes.
    """
    store, picture = str(folder / f"{EXAMPLE}.zarr"), str(folder / f"{EXAMPLE}.png")
    for words in (["run", EXAMPLE, "-o", store], ["plot", store, "-o", picture], ["query", store]):
        print_status(f"$ atlas {' '.join(words)}")
        assert ctx.parent is not None
        group = ctx.parent.command
        assert isinstance(group, click.Group)
        command = group.commands[words[0]]
        with command.make_context(words[0], words[1:], parent=ctx.parent) as context:
            command.invoke(context)
    print_status(f"the map: {picture}; next: atlas explore, atlas systems, atlas --help")


@click.command(epilog=examples("atlas systems", "atlas systems two-mass", "atlas systems my-machine.toml"))
@click.argument("name", required=False, type=PLACE)
@json_option
def systems(name: str | None, as_json: bool) -> None:
    """List the systems that can be solved, or describe one: its NAME, or the path of a .toml file."""
    if name is not None:
        system = parse_system(name)
        click.echo(to_json(system.table())) if as_json else _print_system(system)
        return
    records = [find_system(known) for known in system_names()]
    if as_json:
        titles = {record.name: record.title for record in records}
        click.echo(to_json({"systems": titles, "examples": example_names()}))
        return
    print_table("", ["system", ""], [(record.name, record.title) for record in records])
    click.echo(f"\nexamples: {', '.join(example_names())}")
    click.echo("details: atlas systems NAME")


@click.command(epilog=examples("atlas example omega-b > plane.toml"))
@click.argument("name", required=False)
def example(name: str | None) -> None:
    """Print the packaged example NAME, a spec to start from, as a TOML file; without NAME list all examples."""
    if name is not None:
        click.echo(example_text(name), nl=False)
        return
    # The first comment of an example begins with its title and a colon.
    firsts = {key: " ".join(example_text(key).split("\n\n")[0].replace("#", " ").split()) for key in example_names()}
    print_table("", ["example", ""], [(key, first.partition(":")[0]) for key, first in firsts.items()])
    click.echo("\nprint one: atlas example NAME")


@click.command(epilog=examples("atlas schema > atlas.schema.json"))
def schema() -> None:
    """Print the JSON Schema of a spec, by which editors of TOML complete and check it."""
    click.echo(json.dumps(spec_schema(), indent=1))


def _print_system(system: System) -> None:
    """Print a description of a system: title, equation, picture, parameters, results of its own, source and usual
    axes.
    """
    click.echo(f"{system.name}: {system.title}")
    for part in (equation_of(system), system.picture):
        if part.strip():
            click.echo(f"\n{textwrap.indent(textwrap.dedent(part.strip(chr(10))), '    ')}")
    click.echo()
    rows = [(p.name, p.meaning, p.unit, p.formula or f"{p.default:g}", p.range) for p in system.parameters]
    print_table("", ["parameter", "meaning", "unit", "default", "valid"], rows)
    if system.own_variables:
        click.echo()
        print_table("", ["result", "meaning", "unit"], [(v.name, v.long_name, v.units) for v in system.own_variables])
    for line in (*step_lines(system), *unused_lines(system)):
        click.echo(f"\n{line}")
    if system.source:
        click.echo(f"\nsource: {system.source}")
    if system.axes:
        click.echo(f"usual axes: {', '.join(f'{name} {low:g} to {high:g}' for name, low, high in system.axes)}")
