"""The command that draws an atlas."""

import os
from pathlib import Path
from typing import Any

import click

from atlas.cli.options import (
    PLACE,
    Bounds,
    Numbers,
    examples,
    figure_options,
    input_errors,
    meanings,
    open_selection,
    picture_option,
    print_status,
    select_option,
    storage_option,
    window_option,
)
from atlas.errors import InputError
from atlas.render import CURVES, OVERLAYS, check_path
from atlas.render import render as draw
from atlas.render.kinds import KIND_MEANINGS, OVERLAY_MEANINGS
from atlas.render.request import PictureRequest


@click.command(
    epilog="\n\n".join(
        [
            meanings("Kinds:", KIND_MEANINGS),
            meanings("Overlays:", OVERLAY_MEANINGS),
            meanings("Curves:", {", ".join(CURVES[:4]): "", ", ".join(CURVES[4:]): ""}),
            examples(
                "atlas plot plane.zarr -o chaos.png --overlay grazing",
                "atlas plot plane.zarr -o period.pdf --kind period --window omega=2:3 --width 85mm",
                "atlas plot plane.zarr -o speed.png --variable max_impact_speed",
                "atlas plot up.zarr --against down.zarr -o hysteresis.png",
                "atlas plot sweep.zarr -o phases.png --observe impact_phase:stop",
            ),
        ]
    )
)
@click.argument("stores", nargs=-1, required=True, type=PLACE)
@storage_option
@picture_option
@click.option("--kind", metavar="KIND", help="A kind from the list below; default: by the axes.")
@click.option("--variable", metavar="NAME", help="Map this number of each cell, such as max_impact_speed.")
@click.option("--log", is_flag=True, help="On a logarithmic scale, with --variable.")
@click.option(
    "--observe",
    metavar="NAME",
    help="What a sweep shows in place of section values, such as impact_phase:stop; one of its solve.observe.",
)
@click.option(
    "--overlay",
    type=click.Choice(OVERLAYS),
    multiple=True,
    help="An overlay over a map or a sweep; repeatable.",
)
@click.option("--curves", metavar="KINDS", help="Exact curves of these kinds only, such as fold,graze; or all.")
@click.option("--names/--no-names", default=True, help="Label motions and codimension-two points on the map.")
@click.option("--against", metavar="STORE", type=PLACE, help="A second sweep of the same axis, for hysteresis.")
@window_option
@select_option
@figure_options()
def plot(
    stores: tuple[str, ...],
    out: Path,
    kind: str | None,
    variable: str | None,
    log: bool,
    observe: str | None,
    overlay: tuple[str, ...],
    curves: str | None,
    names: bool,
    against: str | None,
    window: Bounds,
    select: Numbers,
    **look: Any,
) -> None:
    """Draw STORES, or a window of them: a map of two axes, a sweep of one, or the planes of a stack.

    Several stores that differ in a parameter are drawn side by side with the same colour limits, as maps of exponents
    or periods.
    """
    from atlas.query.read_counter import count_chunk_reads

    check_path(out)
    single = {"overlay": overlay, "curves": curves, "no-names": not names, "against": against, "log": log}
    option_names = [name for name, value in {**single, "variable": variable, "observe": observe}.items() if value]
    if len(stores) > 1 and option_names:
        raise InputError(f"--{option_names[0]} takes one STORE, found {len(stores)}")
    of_one: dict[str, Any] = {"overlay": overlay, "curves": curves, "names": names, "variable": variable, "log": log}
    PictureRequest.from_arguments(kind, window, **of_one, observe=observe, **look)  # before stores are read
    with input_errors(), count_chunk_reads() as reads:
        atlases = [open_selection(store, select) for store in stores]
        other = None if against is None else open_selection(against, select)
        print_status("drawing")
        if len(atlases) > 1:
            stems = [os.path.basename(str(store).rstrip("/" + os.sep)) for store in stores]
            draw(atlases, out, kind, window, titles=stems, **look)
        else:
            draw(
                atlases[0], out, kind=kind, window=window, against=other, observe=observe, **of_one, **look
            )  # fmt: skip
    if reads.chunks:
        print_status(str(reads))
    click.echo(str(out))
