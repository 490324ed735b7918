"""The command that opens the explorer, or writes the page of an atlas."""

import sys
import time
import webbrowser
from pathlib import Path

import click

from atlas.cli.options import (
    INTERRUPTED,
    PLACE,
    Bounds,
    Numbers,
    examples,
    input_errors,
    interruptible,
    open_selection,
    options_given,
    out_option,
    pairs_option,
    print_status,
    read_bounds,
    scheduler_option,
    select_option,
    storage_option,
    timing_of,
    workers_option,
)
from atlas.cli.progress import reporter
from atlas.errors import InputError
from atlas.service.progress import prepare_kernels

PACKAGED = "omega-b"
"""Name of the packaged example that the explorer opens by default."""


@click.command(
    epilog=examples(
        "atlas explore",
        "atlas explore plane.zarr",
        "atlas explore plane.toml",
        "atlas explore plane.zarr -o plane.html",
    )
)
@click.argument("subject", metavar="[STORE|SPEC]", default=PACKAGED, type=PLACE)
@storage_option
@select_option
@out_option("Write the cells of STORE as one .html file that opens without a server, and end.")
@pairs_option("--window", "NAME=LOW:HIGH", "With -o: only this window of an axis.", read_bounds)
@scheduler_option
@workers_option
@click.option("--tolerance", type=float, help="Tolerance of the explored cells; default: 0.05.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page; default: any free port.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Host of the page, whose address has a token.")
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser.")
@click.pass_context
def explore(
    ctx: click.Context,
    subject: str,
    select: Numbers,
    out: Path | None,
    window: Bounds,
    scheduler: str | None,
    workers: int | None,
    tolerance: float | None,
    port: int,
    host: str,
    browser: bool,
) -> None:
    """Look anywhere in the plane of STORE, or of SPEC, at any zoom level, in the browser.

    Unknown visible cells are computed, coarse first. Default: the example omega-b. Ctrl-C ends the explorer.
    """
    if out is not None:
        write(ctx, subject, select, window, out)
        return
    if window:
        raise InputError("--window needs -o; the page in the browser zooms")
    from atlas.explore.session import explore as start
    from atlas.explore.subject import TOLERANCE

    def prepare() -> None:
        if scheduler is None:
            with reporter(sys.stderr) as show:
                prepare_kernels(show)

    try:
        with interruptible():
            running = start(
                subject,
                select,
                scheduler=scheduler,
                workers=workers,
                tolerance=TOLERANCE if tolerance is None else tolerance,
                port=port,
                host=host,
                timing=timing_of(ctx),
                prepare=prepare,
            )
            try:
                click.echo(running.url)
                if running.proxied_url != running.url:
                    print_status(f"through the proxy of JupyterHub: {running.proxied_url}")
                if browser:
                    webbrowser.open(running.url)
                while True:
                    time.sleep(3600)  # Ctrl-C ends a sleep on every system
            finally:
                running.stop()
    except KeyboardInterrupt:
        print_status("ended")
        ctx.exit(INTERRUPTED)


def write(ctx: click.Context, subject: str, selection: Numbers, window: Bounds, out: Path) -> None:
    """Write an atlas as one HTML page, for ``atlas explore -o``.

    Raise InputError for an option that only applies to the explorer in the browser.
    """
    for option in options_given(ctx):
        if option.name not in ("subject", "storage_option", "select", "window", "out"):
            name = "/".join([option.opts[-1], *option.secondary_opts])
            raise InputError(f"{name} is for the explorer in the browser; with -o go --select and --window")
    from atlas.explore.static.page import FORMATS, write_page
    from atlas.formatting import byte_size
    from atlas.query.export import check_target
    from atlas.query.window import select_window
    from atlas.spec.examples import example_names

    if str(subject).endswith(".toml") or subject in example_names():
        run = f"atlas run {subject} -o {Path(subject).stem}.zarr"
        raise InputError(f"{subject}: -o takes a store, found a spec; compute it first: {run}")
    with input_errors():
        check_target(out, FORMATS)
        ds = select_window(open_selection(subject, selection), window)
        print_status("reading and drawing")
        written = write_page(ds, out)
    print_status(byte_size(written.stat().st_size))
    click.echo(str(written))
