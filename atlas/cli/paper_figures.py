"""The figures of Li & Tan (2011): their cells and their sweep, computed and drawn."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from atlas.cell.trajectory import cell_orbit
from atlas.errors import InputError, RunError
from atlas.query.open import open_atlas
from atlas.render import FORMATS, render
from atlas.service.options import DEFAULTS, RunOptions
from atlas.service.progress import Progress, prepare_kernels
from atlas.service.run import run
from atlas.spec.spec import Spec
from workers import Settings

if TYPE_CHECKING:
    from distributed import Client

_COMMON = {"R": 0.8, "tau": math.pi}
CELLS = {
    "fig3": {**_COMMON, "mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "b": 0.1},
    "fig4": {**_COMMON, "mu_k": 4.0, "mu_m": 6.0, "zeta": 0.5, "f2": 2.0, "omega": 1.0, "b": 0.2},
    "fig5": {**_COMMON, "mu_k": 2.0, "mu_m": 2.0, "zeta": 0.5, "f2": 5.0, "omega": 3.0, "b": 0.2},
}
"""The parameters of the cells in Figs 3, 4 and 5: two periodic motions and a chaotic one."""

SETTINGS = Settings(tolerance=0.002, max_periods=400_000)
"""Settings for Fig. 5's exponents to the three digits that the paper gives."""

SWEEP = "fig6"
"""Name of the packaged spec of Fig. 6."""


def figures(
    folder: str | Path,
    formats: Sequence[str] = ("png",),
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    settings: Settings = SETTINGS,
    sweep: Spec | None = None,
) -> list[Path]:
    """Draw Figs 3 to 6 of Li & Tan, Chin. Phys. B 20 (2011) 040505, into a folder, and return the paths of the files.

    folder           folder of the files
    formats          suffixes of the picture files
    client, options  client and options of ``atlas.run``
    settings         settings of the cells of Figs 3 to 5
    sweep            spec in place of that of Fig. 6, for fewer cells

    Fig. 6 is computed into ``fig6.zarr`` in the folder; finished tiles are kept. Raise InputError for a folder that
    cannot be written and for an unknown format.
    """
    for name in formats:
        if name not in FORMATS:
            raise InputError(f"unknown format {name!r}; possible: {', '.join(FORMATS)}")
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
    written = []
    prepare_kernels(options.report)
    for name, parameters in CELLS.items():
        options.report(Progress(f"{name}: solving and drawing"))
        orbit = cell_orbit(parameters, settings=settings)
        written += [render(orbit, target / f"{name}.{suffix}") for suffix in formats]
    store = target / f"{SWEEP}.zarr"
    options.report(Progress(f"{SWEEP}: computing the sweep into {store}"))
    summary = run(sweep or Spec.from_toml(SWEEP), store, client, options)
    if summary.failures:
        raise RunError(f"{SWEEP}: tile {summary.failures[0].index} failed: {summary.failures[0].message}")
    options.report(Progress(f"{SWEEP}: drawing"))
    drawn = open_atlas(store)
    written += [render(drawn, target / f"{SWEEP}.{suffix}") for suffix in formats]
    return written
