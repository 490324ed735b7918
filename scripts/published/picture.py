"""Drawing and writing of the entries' pictures, with provenance as for every picture."""

from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.figure import Figure

import atlas
from atlas.render.provenance import Provenance, metadata, provenance_of, provenance_of_values
from atlas.render.style import rc_params

DPI = 150
Bounds = Mapping[str, tuple[str, Callable[[float], float]]]
COLORS = ("#0a6ebd", "#e8701a", "#00785a", "#8a1c7c")
"""Colours of lines, also distinct without red or green receptors."""


def in_house_style(draw: Callable[[Path], None]) -> Callable[[Path], None]:
    """Draw lines in the type and the line widths of all other pictures."""

    @wraps(draw)
    def styled(path: Path) -> None:
        settings: Any = rc_params(1.0) | {"axes.prop_cycle": cycler(color=COLORS)}
        with mpl.rc_context(settings):
            draw(path)

    return styled


def save(figure: Figure, path: Path, title: str, spec: Mapping[str, Any]) -> None:
    """Write a figure of numbers computed by this process, with all that decides them."""
    _write(figure, path, provenance_of_values(title, spec))


def plane_with_bounds(path: Path, example: str, bounds: Bounds) -> None:
    """Draw the periods of a packaged plane, and over it x at each y of some bounds, by label: line style, function."""
    with TemporaryDirectory() as folder:
        store = Path(folder) / f"{example}.zarr"
        atlas.run(atlas.Spec.from_toml(example), store)
        ds = atlas.open(store)
        figure = ds.atlas.plot("period", width="5in")
        ax = figure.axes[0]
        values = ds[ds["period"].dims[0]].values
        y = np.linspace(float(values[0]), float(values[-1]), 400)
        for label, (style, bound) in bounds.items():
            ax.plot([bound(value) for value in y], y, style, color="black", lw=1.5, label=label, scalex=False)
        name = ax.xaxis.label
        font = {"family": name.get_fontfamily(), "size": 0.9 * name.get_fontsize()}
        figure.set_figheight(figure.get_figheight() + 0.3)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=len(bounds), prop=font)
        _write(figure, path, provenance_of(ds))


def _write(figure: Figure, path: Path, provenance: Provenance) -> None:
    figure.savefig(path, dpi=DPI, metadata=metadata(provenance, path.suffix.removeprefix(".")))
