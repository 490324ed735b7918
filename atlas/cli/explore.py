"""The command that opens the explorer."""

import sys
import time
import webbrowser

import click

from atlas.cli.options import (
    INTERRUPTED,
    check_workers,
    examples,
    interruptible,
    read_number,
    read_pairs,
    say,
    scheduler_option,
    select_option,
    timing_of,
    workers_option,
)
from atlas.cli.progress import reporter
from atlas.service.progress import prepare_kernels

PACKAGED = "omega-b"
"""What is explored where nothing is named."""
GB = 10**9


@click.command(epilog=examples("atlas explore", "atlas explore plane.zarr", "atlas explore plane.toml"))
@click.argument("subject", metavar="[STORE|SPEC]", default=PACKAGED)
@select_option
@scheduler_option
@workers_option
@click.option("--tolerance", type=float, help="Of the cells that are explored; default: 0.05.")
@click.option("--keep/--no-keep", default=True, help="Keep explored cells in STORE, in its group zoom.")
@click.option(
    "--limit",
    type=click.FloatRange(min=0.0),
    default=0.25,
    show_default=True,
    help="GB to keep at most; then the oldest go.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the page; default: any free one.")
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Of the page; on any other its address has a token."
)
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser.")
@click.pass_context
def explore(
    ctx: click.Context,
    subject: str,
    select: tuple[str, ...],
    scheduler: str | None,
    workers: int | None,
    tolerance: float | None,
    keep: bool,
    limit: float,
    port: int,
    host: str,
    browser: bool,
) -> None:
    """Look anywhere in the plane of STORE, or of SPEC, at any depth, in the browser.

    What is in view and not known is computed, coarse first. Default: the example omega-b. Ctrl-C ends it.
    """
    from atlas.explore.session import explore as start
    from atlas.explore.subject import TOLERANCE

    check_workers(scheduler, workers)
    chosen = read_pairs("--select", select, read_number)
    if scheduler is None:
        with reporter(sys.stderr) as show:
            prepare_kernels(show)
    try:
        with interruptible():
            running = start(
                subject,
                chosen,
                scheduler=scheduler,
                workers=workers,
                tolerance=TOLERANCE if tolerance is None else tolerance,
                keep=keep,
                most_bytes=round(limit * GB),
                port=port,
                host=host,
                timing=timing_of(ctx),
            )
            try:
                if running.explorer.keeper.header is not None:
                    say(f"explored cells are kept in its group zoom, {limit:g} GB at most; --no-keep keeps none")
                click.echo(running.url)
                if running.place != running.url:
                    say(f"by the proxy of JupyterHub: {running.place}")
                if browser:
                    webbrowser.open(running.url)
                while True:
                    time.sleep(3600)  # which Ctrl-C ends on every system
            finally:
                running.stop()
    except KeyboardInterrupt:
        say("ended")
        ctx.exit(INTERRUPTED)
