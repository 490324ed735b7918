"""The table of painters: for each kind of map the function that makes its layers, as plain data."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import xarray as xr

from atlas.render import class_maps, scalar_maps, text
from atlas.render.layers import MapLayers, MapView
from workers.results import ATTRACTOR, PENDING

PAINTERS: Mapping[str, Callable[..., MapLayers]] = {
    "exponent": scalar_maps.exponent, "period": class_maps.period, "impacts": class_maps.motions,
    "combined": scalar_maps.combined, "attractors": class_maps.attractors, "labels": class_maps.labels,
    "basins": class_maps.basins, "scalar": scalar_maps.scalar,
}  # fmt: skip
"""For each kind of map, the function that returns the layers of the map."""


def layers_of(view: MapView, **options: Any) -> MapLayers:
    """Return the layers of a map, whose legend names regimes in the words of the atlas's system."""
    return with_legend_notes(PAINTERS[view.kind.name](view, **options), view.ds)


def with_legend_notes(layers: MapLayers, ds: xr.Dataset) -> MapLayers:
    """Return the layers of a map with a legend that names regimes in the words of the atlas's system.

    If the atlas shows, say, the third attractor of each cell, the legend says of cells without a result that they may
    have fewer attractors.
    """
    labels = {meaning.code: meaning.text for meaning in text.regime(ds).codes}
    if ds.attrs.get(ATTRACTOR, 0):
        labels[PENDING] = f"not more than {ds.attrs[ATTRACTOR]}"
    legend = [entry if entry.regime is None else replace(entry, label=labels[entry.regime]) for entry in layers.legend]
    return replace(layers, legend=legend)
