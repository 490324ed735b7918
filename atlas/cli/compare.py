"""The command that compares two atlases."""

from pathlib import Path
from typing import Any

import click

from atlas.cli.options import (
    PLACE,
    Bounds,
    examples,
    figure_options,
    input_errors,
    json_option,
    out_option,
    print_status,
    store_argument,
    window_option,
)
from atlas.cli.output import print_table, to_json
from atlas.errors import InputError
from atlas.formatting import plural
from atlas.query.open import open_atlas
from atlas.render import check_path, render
from atlas.render.request import PictureRequest


@click.command(epilog=examples("atlas compare plane.zarr other.zarr -o difference.png"))
@store_argument
@click.argument("other", type=PLACE)
@window_option
@out_option("Draw both maps of the comparison; the suffix chooses the format.")
@json_option
@figure_options()
def compare(store: str, other: str, window: Bounds, out: Path | None, as_json: bool, **look: Any) -> None:
    """Compare STORE with OTHER, of the same axes: cells by their regimes in both, differences of exponents.

    Differences are OTHER's minus STORE's.
    """
    from atlas.query.attractors import select_dominant
    from atlas.query.compare import Comparison

    option_names = [
        f"no-{name}" if value is False else name for name, value in look.items() if value not in (None, True)
    ]
    if out is not None:
        check_path(out)
        PictureRequest.from_arguments(**look)
    elif option_names:
        raise InputError(f"--{option_names[0].replace('_', '-')} needs -o, the picture")
    with input_errors():
        compared = Comparison.from_atlases(
            select_dominant(open_atlas(store)), select_dominant(open_atlas(other)), window
        )
        message = compared.as_dict()
        if out is not None:
            print_status("drawing")
            render(compared, out, **look)
    if as_json:
        click.echo(to_json(message | ({} if out is None else {"file": str(out)})))
        return
    for name, (in_store, in_other) in compared.differing.items():
        click.echo(f"{name}: {in_store:g} in {store}, {in_other:g} in {other}")
    names = list(message["regimes"])
    rows = [(in_store, *(str(message["regimes"][in_store][in_other]) for in_other in names)) for in_store in names]
    print_table(f"cells: rows by {store}, columns by {other}", ["", *names], rows)
    click.echo(f"the same regime: {100 * message['same_share']:.2f} % of the area")
    most = compared.numbers.most
    if most is not None:
        where = ", ".join(f"{name} = {value:.6g}" for name, value in most[1].items())
        click.echo(
            f"exponents of {plural(message['compared'], 'cell')}: mean difference {message['mean']:.4g}, "
            f"mean size {message['mean_abs']:.4g}, largest {most[0]:.4g} at {where}"
        )
    if out is not None:
        click.echo(str(out))
