"""The choice of a page, from its controls and its address: window, plane, kind, overlays, scale."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, urlencode

from atlas.errors import InputError, check_names
from atlas.explore.explorer import Explorer
from atlas.explore.lattice import Lattice
from atlas.explore.subject import PlaneParameters, Subject
from atlas.render import MAP_OVERLAYS, MAPS, SCALAR, has_scale, required_variables
from atlas.render.kinds import CURVES as CURVE_KINDS
from atlas.render.kinds import LOGARITHM, NUMBER
from atlas.render.options import AtlasFigureOptions
from workers.results import LARGEST, REGIME

Range = tuple[float, float]
Ends = tuple[float | None, float | None]
"""Of a scale; None is an end that a picture chooses for itself."""

FARTHEST = 1e100
"""Greatest size of a value of an axis that a page shows, and the inverse of the least one on a logarithmic axis."""
CURVES = "curves"
"""The overlay that draws what a store keeps."""
CHART = "regions"
"""The kind of picture that is drawn of curves alone, which no page has."""

Point = tuple[PlaneParameters, float, float]
Cut = tuple[float, float, float, float]
"""A line over the plane, from (x, y) to (x, y)."""


class FollowedOrbit(NamedTuple):
    """The orbit of the cell clicked, followed along a parameter, in smaller steps between two values of it.

    step    points of the branch from the cell's own orbit on
    value   the parameter there, or between that point and the next
    """

    along: str
    low: float
    high: float
    step: int
    value: float


ARGUMENTS = (
    "kind", "variable", "log", "overlay", "vmin", "vmax", "cell", "cut", "follow.orbit", "without",
    "axes", "layer", "token",
)  # fmt: skip
"""The arguments of an address besides parameters, whose names have no dot; ``token`` is the server's."""


@dataclass(frozen=True)
class ViewState:
    """A choice. ``variable`` and ``log`` go with kind SCALAR; ends of the scale that are None are chosen for one.

    cell   the point that was clicked
    cut    the line that was drawn
    follow the orbit of that point which is followed
    hidden the kinds of curves that are left out
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
        """The choice as far as the browser needs something for it."""
        return replace(self, cell=None, cut=None, follow=None, vmin=None, vmax=None, hidden=())

    @property
    def map(self) -> str:
        """The name of its map among all that a page has."""
        return f"{NUMBER}{self.variable}{LOGARITHM * self.log}" if self.kind == SCALAR else self.kind

    def middle(self, subject: Subject) -> tuple[float, float]:
        """The cell that was clicked in its plane, or else the middle of the window."""
        if self.cell is not None and self.cell[0] == self.plane:
            return self.cell[1:]
        ends = (subject.x.log, *self.x), (subject.y.log, *self.y)
        x, y = (math.sqrt(low * high) if log else 0.5 * (low + high) for log, low, high in ends)
        return x, y

    @property
    def names(self) -> list[str]:
        """The variables that it draws."""
        own = [self.variable] if self.kind == SCALAR else required_variables(self.kind)
        return list(dict.fromkeys([*own, *([LARGEST.name] if "isolines" in self.overlays else []), REGIME.name]))

    def visible_overlays(self, subject: Subject) -> tuple[str, ...]:
        """The overlays that its plane has."""
        return tuple(name for name in self.overlays if name != CURVES or self.plane == subject.plane)

    @property
    def curves(self) -> tuple[str, ...] | None:
        """The kinds of curves that may be drawn; None for all."""
        return tuple(kind for kind in CURVE_KINDS if kind not in self.hidden) if self.hidden else None

    def without_curves(self, subject: Subject) -> str:
        """Why its curves belong to another plane; empty if they belong to its own, or if it has none."""
        if self.plane == subject.plane or CURVES not in self.overlays:
            return ""
        own = dict(subject.plane.parameters)
        changes = [(name, own[name], value) for name, value in self.plane.parameters if value != own[name]]
        there, here = (", ".join(f"{change[0]} = {change[i]:.6g}" for change in changes) for i in (1, 2))
        return f"no curves at {here}: a store has curves of its own plane alone, {there}"

    def figure_options(self, limits: Ends = (None, None)) -> AtlasFigureOptions:
        """How its picture looks with these ends of its scale, as options of ``render.figure``."""
        look: AtlasFigureOptions = {"vmin": limits[0], "vmax": limits[1]} if has_scale(self.kind) else {}
        look["overlay"] = self.overlays
        if CURVES in self.overlays:
            look["curves"] = self.curves
        if self.kind == SCALAR:
            look["variable"], look["log"] = self.variable, self.log
        return look


STYLE_FIELDS = "kind", "variable", "log", "overlays", "hidden", "vmin", "vmax"
"""The fields that say how a plane looks."""


def kinds(subject: Subject) -> list[str]:
    """The kinds of maps whose variables the subject has."""
    return [kind for kind in MAPS if kind != CHART and subject.variables.keys() >= set(required_variables(kind))] + [
        SCALAR
    ]


def overlays(subject: Subject) -> list[str]:
    """The lines that may be drawn over its maps."""
    without = {CURVES: subject.store is None, "isolines": LARGEST.name not in subject.variables}
    return [name for name in MAP_OVERLAYS if not without.get(name, False)]


def followable(subject: Subject) -> list[str]:
    """The parameters along which an orbit can be followed, the axes first."""
    others = [p.name for p in subject.system.parameters if p.name not in subject.axes]
    return [name for name in (*subject.axes, *others) if name not in subject.system.states]


def initial_view(subject: Subject) -> ViewState:
    """The whole plane, drawn as the first kind that there is."""
    x, y = ((axis.values[0], axis.values[-1]) for axis in subject.spec.axes[:2])
    return ViewState(x, y, subject.plane, kinds(subject)[0], subject.numbers[0])


def carry_over(subject: Subject, view: ViewState, values: Mapping[str, float]) -> ViewState:
    """The whole plane of another subject at these values, drawn as the old choice as far as it can be.

    A parameter whose value is out of its range, as in the margin of a view, has that of the subject's own plane.
    """
    begun, parameter = initial_view(subject), subject.system.parameter
    return replace(
        begun,
        plane=PlaneParameters(
            tuple(
                (name, values[name] if parameter(name).admits(values[name]) else own)
                for name, own in begun.plane.parameters
            )
        ),
        kind=view.kind if view.kind in kinds(subject) else begun.kind,
        variable=view.variable,
        log=view.log,
        hidden=view.hidden,
        overlays=tuple(name for name in view.overlays if name in overlays(subject)),
    )


def from_address(subject: Subject, arguments: Mapping[str, list[bytes]]) -> ViewState:
    """The choice of an address; InputError, which names the argument, if the subject does not have it."""
    chosen, given = initial_view(subject), {name: values[-1].decode() for name, values in arguments.items()}
    for name in sorted(given, key=lambda name: name == "cell"):  # which lies in the plane that others choose
        chosen = replace(chosen, **_fields(subject, chosen, name, given[name]))
    if chosen.follow is not None and chosen.cell is None:
        raise InputError("follow: needs a cell, whose orbit is followed")
    return chosen


def explorer_for_query(explorer: Explorer, arguments: Mapping[str, list[bytes]]) -> Explorer:
    """The explorer of the axes and of the layer that an address asks for; InputError where there is none."""
    given = {name: values[-1].decode() for name, values in arguments.items()}
    axes = tuple(given["axes"].split(",")) if "axes" in given else explorer.subject.axes
    if len(axes) != 2:
        raise InputError(f"axes: found {given['axes']!r}, must be two parameters, ACROSS,UP")
    return explorer.explorer_for_axes(
        (axes[0], axes[1]), _number("layer", given["layer"]) if "layer" in given else None
    )


def place_query(home: Subject, subject: Subject, view: ViewState) -> str:
    """Where it is: axes, window, plane, and what stands on that, in the query of an address that asks for it.

    An address without a query asks for ``home``.
    """
    x, y = subject.axes
    pairs = [("axes", f"{x},{y}")] if subject.axes != home.axes else []
    pairs += [("layer", repr(subject.layer_value))] if subject.layer_value != home.layer_value else []
    pairs += [(x, "{!r}:{!r}".format(*view.x)), (y, "{!r}:{!r}".format(*view.y))]
    own = dict(subject.plane.parameters)
    pairs += [(name, repr(value)) for name, value in view.plane.parameters if value != own[name]]
    points: dict[str, tuple[float, ...] | None] = {"cut": view.cut}
    if view.cell and view.cell[0] == view.plane:
        points["cell"] = view.cell[1:]
    pairs += [(name, ",".join(map(repr, point))) for name, point in points.items() if point is not None]
    if "cell" in points and view.follow:
        pairs.append(("follow.orbit", ",".join(map(str, view.follow))))
    return urlencode(pairs, safe=":,")


def style_query(view: ViewState) -> str:
    """How it looks, which the browser may change by itself: see ``live.mjs``."""
    pairs = [("kind", view.kind)]
    if view.kind == SCALAR:
        pairs += [("variable", view.variable)] + ([("log", "1")] if view.log else [])
    lists = {"overlay": view.overlays, "without": view.hidden}
    pairs += [(name, ",".join(listed)) for name, listed in lists.items() if listed]
    pairs += [(name, repr(end)) for name in ("vmin", "vmax") if (end := getattr(view, name)) is not None]
    return urlencode(pairs, safe=":,")


def apply_style_query(subject: Subject, view: ViewState, query: str) -> ViewState:
    """The choice with the look of a query; InputError, which names the argument, if the subject does not have it."""
    plain = replace(view, log=False, overlays=(), hidden=(), vmin=None, vmax=None)
    for name, value in parse_qsl(query):
        plain = replace(plain, **_fields(subject, plain, name, value))
    return plain


def _fields(subject: Subject, view: ViewState, name: str, value: str) -> dict[str, Any]:
    """The fields of a choice that an argument of an address changes."""
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
    if name == "follow.orbit":
        along, _, numbers = value.partition(",")
        check_names("parameter in follow", [along], followable(subject))
        low, high, step, at = _numbers(name, numbers, 4)
        return {"follow": FollowedOrbit(along, low, high, round(step), at)}
    if name == "cut":
        ends = _points(subject, name, value, 2)
        if not (subject.x.parts(ends[0], ends[2]) or subject.y.parts(ends[1], ends[3])):
            raise InputError(f"cut: found {value!r}, which begins and ends at one point")
        return {name: ends}
    return {name: _number(name, value)} if name in ("vmin", "vmax") else {}


def _possible(name: str, given: Sequence[str], possible: Sequence[str]) -> tuple[str, ...]:
    """The values of an argument, checked to be possible."""
    unknown = [word for word in given if word not in possible]
    if unknown:
        raise InputError(f"{name}: found {unknown[0]!r}; possible: {', '.join(possible)}")
    return tuple(given)


def _number(name: str, value: str) -> float:
    try:
        given = float(value)
    except ValueError:
        raise InputError(f"{name}: found {value!r}, must be a number") from None
    if not math.isfinite(given):
        raise InputError(f"{name}: found {value!r}, must be a finite number")
    return given


def _numbers(name: str, value: str, count: int) -> tuple[float, ...]:
    numbers = tuple(_number(name, part) for part in value.split(","))
    if len(numbers) != count:
        raise InputError(f"{name}: found {value!r}, must be {count} numbers, separated by commas")
    return numbers


def _points(subject: Subject, name: str, value: str, count: int) -> tuple[float, ...]:
    """Points of a plane, x and y of each."""
    numbers = _numbers(name, value, 2 * count)
    for k, number in enumerate(numbers):
        _check_reach(name, (subject.x, subject.y)[k % 2], number)
    return numbers


def _check_reach(name: str, lattice: Lattice, value: float) -> None:
    """InputError unless a value of an axis is near enough to be drawn."""
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
