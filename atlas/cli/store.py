"""Commands about a store as a whole: status, verify, pack, cite."""

import sys
from pathlib import Path

import click

from atlas.check.verify import verify as verify_store
from atlas.cli.options import examples, interruptible, json_option, store_argument, timing_of
from atlas.cli.output import emit
from atlas.cli.progress import reporter
from atlas.query.open import open_atlas
from atlas.service.pack import pack as pack_store
from atlas.service.status import StatusReader, read_status, watch
from atlas.spec.citation import bibtex, software_version
from atlas.store.store import open_store

WATCH_SECONDS = 2.0
"""Seconds between two snapshots of ``atlas status --watch``."""


@click.command(epilog=examples("atlas status plane.zarr --watch"))
@store_argument
@click.option("--watch", "watching", is_flag=True, help="Repeat until STORE is complete, or no run writes it.")
@json_option
@click.pass_context
def status(ctx: click.Context, store: str, watching: bool, as_json: bool) -> None:
    """Print the progress of STORE: finished tiles, cells and regimes, and the run that writes it."""
    handle, timing = open_store(store), timing_of(ctx)
    if watching:
        with reporter(sys.stderr) as show:
            for now in watch(StatusReader(handle, timing), WATCH_SECONDS):
                show(now.progress)
    final = read_status(handle, timing)
    emit(final, as_json)


@click.command(epilog=examples("atlas verify plane.zarr --sample 100"))
@store_argument
@click.option("--repair", is_flag=True, help="Drop each faulty tile, so that atlas run solves it again.")
@click.option(
    "--sample", type=click.IntRange(min=0), metavar="N", default=32, show_default=True, help="Cells to solve again."
)
@json_option
@click.pass_context
def verify(ctx: click.Context, store: str, repair: bool, sample: int, as_json: bool) -> None:
    """Read all of STORE and check it: checksums, completeness, consistency, a sample of cells solved again.

    Exit code 0: complete and fine; 1: something found. Do not verify a store while a run writes it.
    """
    with reporter(sys.stderr) as show:
        report = verify_store(store, sample=sample, repair=repair, on_progress=show)
    emit(report, as_json)
    if not report.is_sound:
        ctx.exit(1)


@click.command(epilog=examples("atlas pack plane.zarr plane.zip"))
@store_argument
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--force", is_flag=True, help="Replace FILE if it exists.")
@json_option
@click.pass_context
def pack(ctx: click.Context, store: str, file: Path, force: bool, as_json: bool) -> None:
    """Pack STORE into one zip FILE, which every reading command and plain xarray can open.

    Do not pack a store while a run writes it. STORE stays as it is.
    """
    with interruptible(), reporter(sys.stderr) as show:
        packed = pack_store(store, file, force, show, timing_of(ctx))
    emit(packed, as_json)


@click.command(epilog=examples("atlas cite plane.zarr > atlas.bib"))
@store_argument
def cite(store: str) -> None:
    """Print BibTeX of what to cite for STORE: the software that computed it, the method, the sources of its machine."""
    handle = open_store(store)
    version = software_version(str(open_atlas(handle).attrs.get("software", "")))
    click.echo(bibtex(handle.spec.system_def, version, handle.solver_version))
