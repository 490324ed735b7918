"""The demo: a plane computed, drawn and counted by the commands that a user would type."""

from pathlib import Path

import click

from atlas.cli.options import examples, print_status

EXAMPLE = "omega-b"


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
        with command.make_context(words[0], words[1:], parent=ctx.parent) as own:
            command.invoke(own)
    print_status(f"the map: {picture}; next: atlas explore, atlas systems, atlas --help")
