"""Names reserved by an atlas, invalid for parameters and coordinates of a system."""

from workers.results import result_variables
from workers.settings import Settings

_everything = Settings(exponents="spectrum", method="fixed", section_samples=1)
_KINDS = ((False, False), (True, False), (False, True))  # of atlases: with all attractors, of basins
_RESULTS = [variable for kind in _KINDS for variable in result_variables(_everything, *kind)]
NAMES = frozenset((
    *(name for variable in _RESULTS for name in (variable.name, f"{variable.name}_count", *variable.extra_dims)),
    # groups of a store
    "attractors", "curves", "hosts", "labels", "overviews", "parts", "stability", "tally", "tiles", "zoom",
    # arrays and dimensions of cells, of overviews, of tables and of curves, besides the results
    "budget", "survival", "component", "point",
    "cells", "largest_positive", "regime_share", "regime_shown", "class", "bound",
    "points", "total_share", "branch", "column", "axis", "corner", "curve", "position", "row_size", "first_end",
    "last_end", "corner_after", "corner_curve", "corner_kind", "corner_position",
    # stability measures of cells
    "return_time", "reactivity", "amplification", "amplified_after", "unmeasured", "fatal_shock", "shock_reaches",
    "shock_tried", "margin", "margin_error", "margin_kind", "margin_curve",
    # columns and entries of tables and answers, besides parameters
    "coexisting", "difference", "distance", "event", "extreme", "impacts", "kappa", "kind", "leaving", "multiplier",
    "unstable", "value",
    # arguments of calls and of addresses that take parameters by name as well
    "along", "axes", "cell", "cut", "dpi", "font_size", "height", "layer", "legend", "log", "observe", "overlay",
    "path", "self", "style", "switch_branches", "title", "token", "variable", "vmax", "vmin", "width", "window",
    "without",
))  # fmt: skip


def is_taken(name: str) -> bool:
    """Return True if an atlas reserves the name, also for coarse cells along an axis or their bounds."""
    return name in NAMES or name.endswith(("_bounds", "_coarse"))
