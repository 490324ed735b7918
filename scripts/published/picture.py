"""How pictures of entries are written: with the words of provenance that every picture of these pages has."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from atlas.render.provenance import Provenance, computed_here, metadata, provenance_of

DPI = 150


def save(figure: Figure, path: Path, title: str, spec: Mapping[str, Any]) -> None:
    """Write a figure of numbers that this process has computed, from all that decides them."""
    _write(figure, path, computed_here(title, spec))


def finish(figure: Figure, path: Path, ds: Any, legend: Axes) -> None:
    """Write a figure of an atlas, with a legend of the lines added to one of its axes."""
    legend.legend(loc="upper right", fontsize="small", framealpha=0.9)
    _write(figure, path, provenance_of(ds))


def _write(figure: Figure, path: Path, provenance: Provenance) -> None:
    figure.savefig(path, dpi=DPI, metadata=metadata(provenance, path.suffix.removeprefix(".")))
