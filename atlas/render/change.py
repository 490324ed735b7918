"""Maps of what changes from one plane to another of the same cells: by how much a number, or which cells change class.

The atlas drawn has the cells of the second plane, pending where the two were not compared, and in CHANGE the number
there minus the number here, NaN where one has none; of classes 1 where they differ and 0 where they agree.
"""

from dataclasses import replace

import numpy as np

from atlas.query.ends import scale_ends
from atlas.render import maps, scales, style, words
from atlas.render.kinds import SCALAR, TABLE, Kind, has_scale
from atlas.render.maps import Bar, Painted, View
from atlas.render.together import DIFFERENCE, SAME, WITHOUT
from workers.results import LARGEST, PENDING

CHANGE = "change"
"""The variable of such an atlas that holds the changes."""
_CLASSES = {"regions": "impacts"}
"""The kind whose classes are compared where another draws lines."""


def compares_numbers(kind: str) -> bool:
    """Whether maps of a kind are compared by the difference of their number, not by their classes."""
    return kind == SCALAR or has_scale(kind)


def change_of(kind: str, variable: str = "") -> Kind:
    """The kind of map that shows the changes of a map of this kind, or of a variable."""
    own = TABLE[_CLASSES.get(kind, kind)]
    if compares_numbers(kind):
        return replace(own, variables=(variable or own.variables[0], CHANGE), paint="change.numbers")
    return replace(own, variables=(*own.variables, CHANGE), paint="change.classes")


def numbers(view: View) -> Painted:
    """By how much the number of each cell rises or falls, on a scale with zero in its middle."""
    plane, name = view.plane, view.kind.variables[0]
    change = plane[CHANGE]
    known, compared = np.isfinite(change), plane.regime != PENDING
    end = max(map(abs, scale_ends(change)))
    # Rise and fall look alike: the longer half of the scale decides both.
    norm = scales.two_sided(view.page, -end, end)
    rgba = DIFFERENCE(norm(np.where(known, change, 0.0)), bytes=True)
    rgba[~known] = style.rgb(WITHOUT)
    legend = [style.swatch(WITHOUT, "no such number in one")] if np.any(~known & compared) else []
    label = words.variable_label(view.ds, name) if view.kind.name == SCALAR else view.kind.scale.label
    if name == LARGEST.name:
        label = r"$\lambda_1$ [per forcing period]"
    bars = [Bar(DIFFERENCE, norm, change[known], f"change of {label}")] if known.any() else []
    return _not_compared(Painted(rgba, [*legend, *maps.paint_regimes(rgba, plane.regime, ~compared)], bars))


def classes(view: View) -> Painted:
    """The cells of another class, in the colours of the class that they have in the second plane."""
    plane, compared = view.plane, view.plane.regime != PENDING
    same = compared & (plane[CHANGE] == 0)
    own = TABLE[view.kind.name]
    changed = replace(plane, regime=np.where(same, PENDING, plane.regime).astype(plane.regime.dtype))
    painted: Painted = own.painter(replace(view, kind=own, plane=changed))
    painted.rgba[same] = style.rgb(SAME)
    legend = [each for each in painted.legend if each.get_label() != words.name_of(PENDING) or not compared.all()]
    agree = [style.swatch(SAME, "the same")] if same.any() else []
    return _not_compared(replace(painted, legend=[*agree, *legend], over=None, names=()))


def _not_compared(painted: Painted) -> Painted:
    """What was painted, whose legend calls pending cells what they are here."""
    for entry in painted.legend:
        if entry.get_label() == words.name_of(PENDING):
            entry.set_label("not compared")
    return painted
