"""Maps of what changes from one plane to another of the same cells: by how much a number, or which cells change class.

The atlas drawn has the cells of the second plane, pending where the two were not compared, and in CHANGE the number
there minus the number here, NaN where one has none; of classes 1 where they differ and 0 where they agree.
"""

from dataclasses import replace

import numpy as np
from matplotlib.patches import Patch

from atlas.query.ends import scale_ends
from atlas.query.plane import Plane
from atlas.render import maps, scales, style, words
from atlas.render.kinds import SCALAR, TABLE, Kind, has_scale
from atlas.render.maps import Painted, View
from atlas.render.together import SAME, changed_numbers
from workers.results import LARGEST, PENDING

CHANGE = "change"
"""The variable of such an atlas that holds the changes."""
_CLASSES = {"regions": "impacts"}
"""The kind whose classes are compared where another draws lines."""


def change_of(kind: str, variable: str = "") -> Kind:
    """The kind of map of the changes of this kind, or of a variable: of its numbers if it has a scale."""
    own = TABLE[_CLASSES.get(kind, kind)]
    if has_scale(kind):
        return replace(own, variables=(variable or own.variables[0], CHANGE), paint="change.numbers")
    return replace(own, variables=(*own.variables, CHANGE), paint="change.classes")


def numbers(view: View) -> Painted:
    """By how much the number of each cell rises or falls, on a scale with zero in its middle."""
    plane, name = view.plane, view.kind.variables[0]
    change = np.where(np.isfinite(plane[CHANGE]), plane[CHANGE], np.nan)
    # Rise and fall look alike: the longer half of the scale decides both.
    end = max(map(abs, scale_ends(change)))
    label = words.variable_label(view.ds, name) if view.kind.name == SCALAR else view.kind.scale.label
    if name == LARGEST.name:
        label = r"$\lambda_1$ [per forcing period]"
    norm, without = scales.two_sided(view.page, -end, end), "no such number in one"
    painted = changed_numbers(change, plane.regime == PENDING, norm, f"change of {label}", without)
    bars = [] if np.isnan(change).all() else painted.bars
    return replace(painted, legend=[*painted.legend, *_not_compared(plane)], bars=bars)


def classes(view: View) -> Painted:
    """The cells of another class, in the colours of the class that they have in the second plane."""
    plane, own = view.plane, TABLE[view.kind.name]
    same = (plane.regime != PENDING) & (plane[CHANGE] == 0)
    changed = replace(plane, regime=np.where(same, PENDING, plane.regime).astype(plane.regime.dtype))
    painted: Painted = own.painter(replace(view, kind=own, plane=changed))
    painted.rgba[same] = style.rgb(SAME)
    there = [each for each in painted.legend if each.get_label() != words.name_of(PENDING)]
    agree = [style.swatch(SAME, "the same")] if same.any() else []
    return replace(painted, legend=[*agree, *there, *_not_compared(plane)], over=None, names=())


def _not_compared(plane: Plane) -> list[Patch]:
    """The legend entry of the pending cells of a plane, which are those that were not compared."""
    return [maps.regime_entry(PENDING, "not compared")] if np.any(plane.regime == PENDING) else []
