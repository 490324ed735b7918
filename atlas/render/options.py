"""The options of pictures as keyword arguments of functions, with the same names as in the commands."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypedDict, TypeVar

from atlas.errors import InputError, brief_repr

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


P = ParamSpec("P")
T = TypeVar("T")


class FigureOptions(TypedDict, total=False):
    """Options of every picture: size, type, resolution, title, legend and style."""

    width: Annotated[
        float | str | None,
        'width of the picture: inches as a number, or a text such as "85mm", "8.5cm" or "3.35in"; default: 7 in',
    ]
    height: Annotated[float | str | None, "height of the picture, in the same form; default: by the width"]
    font_size: Annotated[float | None, "type size in points; default: by the width"]
    dpi: Annotated[float | None, "dots per inch; default: 300"]
    title: Annotated[bool, "show the fixed parameters above the picture"]
    legend: Annotated[bool, "show a legend"]
    style: Annotated[
        str | Path | None, 'a matplotlib style: a file, a name of matplotlib\'s own, or "current" for your rcParams'
    ]


class ScaleOptions(FigureOptions, total=False):
    """Options of every picture with colour limits."""

    vmin: Annotated[float | None, "lower colour limit, or lower limit of the exponents in a sweep"]
    vmax: Annotated[float | None, "upper limit, likewise"]


class _AtlasOnlyOptions(TypedDict, total=False):
    """Further options of a picture of one atlas."""

    overlay: Annotated[str | Sequence[str], "overlays of a map or a sweep, one or several of OVERLAYS"]
    curves: Annotated[
        str | Sequence[str] | None, 'kinds of exact curves to draw, of CURVES, "fold,graze" or a list; default: all'
    ]
    names: Annotated[bool, "label points, motions and lines on a map"]
    against: Annotated["xr.Dataset | None", "a second sweep of the same axis, for hysteresis"]
    variable: Annotated[str | None, "the variable to map, such as max_impact_speed"]
    observe: Annotated[str | None, "the observable that a sweep shows in place of section values: impact_phase:stop"]
    log: Annotated[bool, "use a logarithmic norm, with variable"]
    ax: Annotated[
        "Axes | Sequence[Axes] | None",
        "matplotlib axes to draw into, for a sweep one for each of its plots; they are returned",
    ]


class AtlasFigureOptions(_AtlasOnlyOptions, ScaleOptions, total=False):
    """Options of a picture of one atlas."""


def split_look(named: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the options of a picture among keyword arguments, and the other arguments."""
    look = {name: value for name, value in named.items() if name in FigureOptions.__annotations__}
    return look, {name: value for name, value in named.items() if name not in look}


def names_in(option: str, value: object) -> tuple[str, ...]:
    """Return the names in an option: one, or several in a list or separated by commas. Raise InputError otherwise."""
    if isinstance(value, str):
        return tuple(value.split(","))
    names = tuple(value) if isinstance(value, Iterable) else (value,)
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"{option}: found {brief_repr(value)}, must be a name or a list of names")
    return names


_DEFAULTS: dict[str, Any] = {"overlay": (), "names": True, "log": False, "title": True, "legend": True}


def accepts_options(options: type, others: bool = False) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Return a decorator for a function with ``**options: Unpack[options]``, which adds the options to its signature.

    The options also appear in the function's docstring. A call with another option raises InputError with all possible
    options, unless the function takes ``others``.
    """
    annotations: dict[str, Any] = options.__annotations__

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)
        parameters = signature.parameters.values()
        named_parameters = [
            parameter for parameter in parameters if parameter.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        rest = [parameter for parameter in parameters if parameter not in named_parameters and others]
        possible = [parameter.name for parameter in named_parameters if parameter.name != "self"] + [*annotations]

        @wraps(function)
        def call(*args: P.args, **options: P.kwargs) -> T:
            unknown = [name for name in options if name not in possible]
            if unknown and not others:
                raise InputError(f"unknown option {unknown[0]!r}; possible: {', '.join(possible)}")
            return function(*args, **options)

        added = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=_DEFAULTS.get(name), annotation=kind.__origin__
            )
            for name, kind in annotations.items()
        ]
        call.__signature__ = signature.replace(parameters=[*named_parameters, *added, *rest])  # type: ignore[attr-defined]
        listed = "\n".join(f"    {name:9} {kind.__metadata__[0]}" for name, kind in annotations.items())
        call.__doc__ = f"{inspect.getdoc(function)}\n\nOptions::\n\n{listed}\n"
        return call

    return decorate
