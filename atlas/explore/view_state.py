"""The view state of a page: window, plane, map, overlays, colour limits, and chosen cell.

The controls change it, and the address of the page holds it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from urllib.parse import urlencode

from atlas.errors import InputError, check_names
from atlas.explore.explorer import Explorer
from atlas.explore.lattice import Lattice
from atlas.explore.subject import PlaneParameters, Subject
from atlas.render import MAP_OVERLAYS, MAPS, SCALAR, has_scale, required_variables
from atlas.render.kinds import CURVES as CURVE_KINDS
from atlas.render.kinds import LOGARITHM, NUMBER
from atlas.render.options import AtlasFigureOptions
from workers.results import REGIME

Range = tuple[float, float]
Ends = tuple[float | None, float | None]
"""Lower and upper colour limit; None if the picture chooses the limit."""

FARTHEST = 1e100
"""Maximum absolute value of an axis on a page; its inverse is the minimum value of a logarithmic axis."""
CELL_PLANE = "cell."
"""Beginning of the arguments of an address with the fixed parameters of a cell in another plane."""
CURVES = "curves"
"""The overlay that draws the curves of a store."""

Point = tuple[PlaneParameters, float, float]
Cut = tuple[float, float, float, float]
"""A line over the plane, from (x, y) to (x, y)."""


class FollowedOrbit(NamedTuple):
    """An orbit on the branch of the clicked cell's orbit, which is followed along a parameter.

    along       name of the parameter
    low, high   limits between which the branch has smaller steps
    step        number of solution points along the branch from the cell's own orbit; negative before the orbit
    value       parameter at that solution point, or between it and the next
    """

    along: str
    low: float
    high: float
    step: int
    value: float

    @property
    def text(self) -> str:
        """The orbit as the argument of an address."""
        return ",".join(map(str, self))


ARGUMENTS = (
    "kind", "variable", "log", "overlay", "vmin", "vmax", "cell", "cut", "follow.orbit", "without",
    "axes", "layer", "token",
)  # fmt: skip
"""Names of the arguments of a page's address, besides parameters; ``token`` is the token of the server.

Names with a dot cannot be confused with parameters, which have none; ``cell.NAME`` is the value of a fixed parameter
``NAME`` at the chosen cell, if it lies in another plane.
"""


@dataclass(frozen=True)
class ViewState:
    """All that a link to a view of the explorer restores.

    x, y         limits (low, high) of the axes
    plane        the fixed parameters
    kind         kind of map
    variable     variable of a map of kind SCALAR, which colours cells by a number
    log          True for a logarithmic scale of a map of kind SCALAR
    overlays     names of the overlays, such as lines over the map
    vmin, vmax   colour limits; None for limits that the picture chooses
    cell         clicked point, as its plane and values of both axes; None if there is none
    cut          line of the cut; None if there is none
    follow       orbit on the branch of the clicked cell; None if no orbit is followed
    hidden       kinds of curves that are hidden
    """

    x: Range
    y: Range
    plane: PlaneParameters
    kind: str
    variable: str = ""
    log: bool = False
    overlays: tuple[str, ...] = ()
    vmin: float | None = None
    vmax: float | None = None
    cell: Point | None = None
    cut: Cut | None = None
    follow: FollowedOrbit | None = None
    hidden: tuple[str, ...] = ()

    @property
    def picture(self) -> "ViewState":
        """The view state without the fields that the browser can show by itself, without a new picture."""
        return replace(self, cell=None, cut=None, follow=None, vmin=None, vmax=None, hidden=())

    @property
    def map(self) -> str:
        """The name by which the browser knows the chosen map: its kind, or variable and scale of a SCALAR map."""
        return f"{NUMBER}{self.variable}{LOGARITHM * self.log}" if self.kind == SCALAR else self.kind

    def middle(self, subject: Subject) -> tuple[float, float]:
        """Return the position of the clicked cell if it lies in this plane, else the middle of the window."""
        if self.cell is not None and self.cell[0] == self.plane:
            return self.cell[1:]
        ends = (subject.x.log, *self.x), (subject.y.log, *self.y)
        x, y = (math.sqrt(low * high) if log else 0.5 * (low + high) for log, low, high in ends)
        return x, y

    @property
    def names(self) -> list[str]:
        """The names of the variables that the map needs, and of the regime."""
        variables = [self.variable] if self.kind == SCALAR else required_variables(self.kind)
        return list(dict.fromkeys([*variables, REGIME.name]))

    def visible_overlays(self, subject: Subject) -> tuple[str, ...]:
        """Return the chosen overlays that can be drawn on the view's plane.

        The curves of a store belong to the store's own plane only.
        """
        return tuple(name for name in self.overlays if name != CURVES or self.plane == subject.plane)

    @property
    def curves(self) -> tuple[str, ...] | None:
        """The kinds of curves that may be drawn; None if no kind is hidden."""
        return tuple(kind for kind in CURVE_KINDS if kind not in self.hidden) if self.hidden else None

    def without_curves(self, subject: Subject) -> str:
        """Return the reason why the curves of the store are not drawn: they belong to another plane.

        The reason is empty if the curves belong to the view's plane, or if they are not requested.
        """
        if self.plane == subject.plane or CURVES not in self.overlays:
            return ""
        atlas_values = dict(subject.plane.parameters)
        changes = [
            (name, atlas_values[name], value) for name, value in self.plane.parameters if value != atlas_values[name]
        ]
        atlas_text, view_text = (", ".join(f"{change[0]} = {change[i]:.6g}" for change in changes) for i in (1, 2))
        return f"no curves at {view_text}: a store has curves only of its own plane, {atlas_text}"

    def figure_options(self, limits: Ends = (None, None)) -> AtlasFigureOptions:
        """Return the options with which ``render.figure`` draws the view with these colour limits."""
        look: AtlasFigureOptions = {"vmin": limits[0], "vmax": limits[1]} if has_scale(self.kind) else {}
        look["overlay"] = self.overlays
        if CURVES in self.overlays:
            look["curves"] = self.curves
        if self.kind == SCALAR:
            look["variable"], look["log"] = self.variable, self.log
        return look


def kinds(subject: Subject) -> list[str]:
    """Return the kinds of maps that the subject's variables allow."""
    return [kind for kind in MAPS if subject.variables.keys() >= set(required_variables(kind))] + [SCALAR]


def overlays(subject: Subject) -> list[str]:
    """Return the overlays that may be drawn on the subject's maps."""
    return [name for name in MAP_OVERLAYS if name != CURVES or subject.store is not None]


def followable(subject: Subject) -> list[str]:
    """Return the names of the parameters along which an orbit can be followed, the axes first; no initial states."""
    others = [p.name for p in subject.system.parameters if p.name not in subject.axes]
    return [name for name in (*subject.axes, *others) if name not in subject.system.states]


def initial_view(subject: Subject) -> ViewState:
    """Return the view of a subject's whole plane, with the first kind of map that its variables allow."""
    x, y = ((axis.values[0], axis.values[-1]) for axis in subject.spec.axes[:2])
    return ViewState(x, y, subject.plane, kinds(subject)[0], subject.numbers[0])


def carry_over(subject: Subject, view: ViewState, values: Mapping[str, float], keep_window: bool = False) -> ViewState:
    """Return a view of another subject's whole plane, in the style of an old view as far as possible.

    subject       the other subject
    view          the old view
    values        value of each parameter, by name, for the plane of the new view
    keep_window   True to keep the window of the old view, whose axes are the same

    A view may reach beyond the valid range of a parameter. A parameter whose value is out of range therefore takes the
    value of the subject's plane.
    """
    begun, parameter = initial_view(subject), subject.system.parameter
    ends = (view.vmin, view.vmax) if view.kind in kinds(subject) else (None, None)
    return replace(
        begun,
        plane=PlaneParameters(
            tuple(
                (name, values[name] if parameter(name).admits(values[name]) else plane_value)
                for name, plane_value in begun.plane.parameters
            )
        ),
        x=view.x if keep_window else begun.x,
        y=view.y if keep_window else begun.y,
        vmin=ends[0],
        vmax=ends[1],
        kind=view.kind if view.kind in kinds(subject) else begun.kind,
        variable=view.variable,
        log=view.log,
        hidden=view.hidden,
        overlays=tuple(name for name in view.overlays if name in overlays(subject)),
    )


def from_address(subject: Subject, arguments: Mapping[str, list[bytes]]) -> ViewState:
    """Return the view state that the arguments of an address give.

    Raise InputError, naming the argument, if the subject does not have what the argument names.
    """
    view, texts = initial_view(subject), {name: values[-1].decode() for name, values in arguments.items()}
    # The cell comes after its plane, and the values in which its plane differs come last.
    for name in sorted(texts, key=lambda name: (name.startswith(CELL_PLANE), name == "cell")):
        view = replace(view, **_fields(subject, view, name, texts[name]))
    if view.follow is not None and view.cell is None:
        raise InputError("follow: needs a cell whose orbit is followed")
    return view


def explorer_for_query(explorer: Explorer, arguments: Mapping[str, list[bytes]]) -> Explorer:
    """Return the explorer of the axes and the layer that the arguments of an address name.

    ``explorer`` is that of the address without arguments. Raise InputError if the axes or the layer do not exist.
    """
    texts = {name: values[-1].decode() for name, values in arguments.items()}
    axes = tuple(texts["axes"].split(",")) if "axes" in texts else explorer.subject.axes
    if len(axes) != 2:
        raise InputError(f"axes: found {texts['axes']!r}, must be two parameters, ACROSS,UP")
    return explorer.explorer_for_axes(
        (axes[0], axes[1]), _number("layer", texts["layer"]) if "layer" in texts else None
    )


def place_query(home: Subject, subject: Subject, view: ViewState) -> str:
    """Return the part of an address's query that says what a view shows.

    It holds axes, layer, window, fixed parameters, cell, cut and followed orbit. Only differences from ``home``, the
    subject of the address without a query, are given for axes, layer and parameters.
    """
    x, y = subject.axes
    pairs = [(x, "{!r}:{!r}".format(*view.x)), (y, "{!r}:{!r}".format(*view.y))]
    plane_values = dict(subject.plane.parameters)
    pairs += [(name, repr(value)) for name, value in view.plane.parameters if value != plane_values[name]]
    points = {"cut": view.cut, "cell": view.cell and view.cell[1:]}
    pairs += [(name, ",".join(map(repr, point))) for name, point in points.items() if point is not None]
    if view.cell:
        values = dict(view.plane.parameters)
        pairs += [
            (f"{CELL_PLANE}{name}", repr(value)) for name, value in view.cell[0].parameters if value != values[name]
        ]
        pairs += [("follow.orbit", view.follow.text)] if view.follow else []
    return "&".join(filter(None, [base_query(home, subject), urlencode(pairs, safe=":,")]))


def base_query(home: Subject, subject: Subject) -> str:
    """Return the part of an address's query that names axes and layer, where they differ from those of ``home``."""
    pairs = [("axes", ",".join(subject.axes))] if subject.axes != home.axes else []
    pairs += [("layer", repr(subject.layer_value))] if subject.layer_value != home.layer_value else []
    return urlencode(pairs, safe=",")


def style_query(view: ViewState) -> str:
    """Return the part of an address's query that says how a view is drawn: map, overlays, curves and colour limits.

    The browser may change the style by itself, see ``live/live.mjs``.
    """
    pairs = [("kind", view.kind)]
    if view.kind == SCALAR:
        pairs += [("variable", view.variable)] + ([("log", "1")] if view.log else [])
    lists = {"overlay": view.overlays, "without": view.hidden}
    pairs += [(name, ",".join(listed)) for name, listed in lists.items() if listed]
    pairs += [(name, repr(end)) for name in ("vmin", "vmax") if (end := getattr(view, name)) is not None]
    return urlencode(pairs, safe=":,")


def _fields(subject: Subject, view: ViewState, name: str, value: str) -> dict[str, Any]:
    """Return the fields of a view state, with their new values, that the argument ``name`` of an address changes."""
    (x, y), listed = subject.axes, value.split(",") if value else []
    if name == x:
        return {"x": _range(name, value, subject.x)}
    if name == y:
        return {"y": _range(name, value, subject.y)}
    if name in dict(view.plane.parameters):
        return {"plane": subject.plane_with(view.plane, name, _number(name, value))}
    if name == "kind":
        return {name: _possible(name, [value], kinds(subject))[0]}
    if name == "variable":
        return {name: _possible(name, [value], subject.numbers)[0]}
    if name == "log":
        return {name: value == "1"}
    if name == "overlay":
        return {"overlays": _possible(name, listed, overlays(subject))}
    if name == "without":
        return {"hidden": tuple(sorted(_possible(name, listed, CURVE_KINDS), key=CURVE_KINDS.index))}
    if name == "cell":
        return {name: (view.plane, *_points(subject, name, value, 1))}
    if name.startswith(CELL_PLANE) and view.cell is not None:
        plane, *point = view.cell
        changed = subject.plane_with(plane, name.removeprefix(CELL_PLANE), _number(name, value))
        return {"cell": (changed, *point)}
    if name == "follow.orbit":
        along, _, numbers = value.partition(",")
        check_names("parameter in follow", [along], followable(subject))
        low, high, step, at = _numbers(name, numbers, 4)
        return {"follow": FollowedOrbit(along, low, high, round(step), at)}
    if name == "cut":
        ends = _points(subject, name, value, 2)
        if not (subject.x.parts(ends[0], ends[2]) or subject.y.parts(ends[1], ends[3])):
            raise InputError(f"cut: found {value!r}, must have two distinct ends")
        return {name: ends}
    return {name: _number(name, value)} if name in ("vmin", "vmax") else {}


def _possible(name: str, values: Sequence[str], possible: Sequence[str]) -> tuple[str, ...]:
    """Return the values that an argument of an address lists. Raise InputError unless all are in ``possible``."""
    unknown = [word for word in values if word not in possible]
    if unknown:
        raise InputError(f"{name}: found {unknown[0]!r}; possible: {', '.join(possible)}")
    return tuple(values)


def _number(name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"{name}: found {value!r}, must be a number") from None
    if not math.isfinite(number):
        raise InputError(f"{name}: found {value!r}, must be a finite number")
    return number


def _numbers(name: str, value: str, count: int) -> tuple[float, ...]:
    numbers = tuple(_number(name, part) for part in value.split(","))
    if len(numbers) != count:
        raise InputError(f"{name}: found {value!r}, must be {count} numbers, separated by commas")
    return numbers


def _points(subject: Subject, name: str, value: str, count: int) -> tuple[float, ...]:
    """Return ``count`` points of a plane, x and y of each in turn, from the text of an argument."""
    numbers = _numbers(name, value, 2 * count)
    for k, number in enumerate(numbers):
        _check_reach(name, (subject.x, subject.y)[k % 2], number)
    return numbers


def _check_reach(name: str, lattice: Lattice, value: float) -> None:
    """Raise InputError if a value of an axis is too large, or on a logarithmic axis too small, to be drawn."""
    least = 1.0 / FARTHEST if lattice.log else -FARTHEST
    if not least <= value <= FARTHEST:
        raise InputError(f"{name}: found {value:g}, must be {least:g} to {FARTHEST:g}")


def _range(name: str, value: str, lattice: Lattice) -> Range:
    low, colon, high = value.partition(":")
    ends = _number(name, low), _number(name, high if colon else "")
    if not (ends[0] < ends[1] and (ends[0] > 0 or not lattice.log)):
        raise InputError(f"{name}: found {value!r}, must be LOW:HIGH{' above zero' if lattice.log else ''}")
    for end in ends:
        _check_reach(name, lattice, end)
    if not lattice.parts(*ends):
        raise InputError(f"{name}: found {value!r}, must be wider than rounding")
    return ends
