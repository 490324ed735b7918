"""Pictures of results, drawn with Matplotlib, without a display and without pyplot.

What a picture shows is plain data, which figures and pages draw alike: layers, colours, scales and overlays. To add a
kind of map, add a row to ``kinds.py`` and a painter, the function that builds its layers, to ``class_maps.py`` or
``scalar_maps.py``, and name the painter in ``painters.py``. To add an overlay, add its function and its row in
``overlays.py``, and its meaning in ``kinds.py``. The tests then include the kind; ``python -m tests.reference`` lists
what its reference picture shows.
"""

from atlas.render.drawing import figure, portrait, render
from atlas.render.kinds import (
    BASINS,
    CURVES,
    KINDS,
    MAP_OVERLAYS,
    MAPS,
    OVERLAYS,
    SCALAR,
    has_scale,
    required_variables,
)
from atlas.render.options import ScaleOptions
from atlas.render.provenance import FORMATS, check_path

SCALE_OPTION_NAMES = tuple(ScaleOptions.__annotations__)
"""Names of the options of every picture with colour limits."""

__all__ = [
    "BASINS",
    "CURVES",
    "FORMATS",
    "KINDS",
    "MAPS",
    "MAP_OVERLAYS",
    "OVERLAYS",
    "SCALAR",
    "SCALE_OPTION_NAMES",
    "check_path",
    "figure",
    "has_scale",
    "portrait",
    "render",
    "required_variables",
]
