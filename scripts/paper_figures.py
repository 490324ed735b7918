"""Figs 3 to 6 of Li & Tan, Chin. Phys. B 20 (2011) 040505: an example of cells and a sweep, computed and drawn.

Fig. 6 is computed into fig6.zarr in the folder; finished tiles are kept. With --light the cells are solved coarsely,
and the sweep has every two hundredth of its cells.

Usage: python -m scripts.paper_figures FOLDER [--format pdf] [--light]
"""

import argparse
from pathlib import Path

import atlas
from scripts.published.entries.li_tan_2011 import CELLS, SETTINGS


def main() -> None:
    """Draw the figures into a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--format", default="png")
    parser.add_argument("--light", action="store_true")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    spec = atlas.Spec.from_toml("fig6")
    settings = SETTINGS
    if given.light:
        axis = spec.axes[0]
        spec = atlas.Spec(spec.system, {axis.name: list(axis.values[::200])}, spec.parameters, spec.settings)
        settings = atlas.Settings(tolerance=0.1)
    for name, parameters in CELLS.items():
        atlas.portrait(parameters, settings=settings, path=given.folder / f"{name}.{given.format}")
    store = given.folder / "fig6.zarr"
    atlas.run(spec, store)
    atlas.open(store).atlas.plot().savefig(given.folder / f"fig6.{given.format}")


if __name__ == "__main__":
    main()
