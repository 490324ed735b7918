"""The layout of a figure: its size, type, resolution, legend and colour limits, or the axes given for it."""

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import style as mpl_style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.transforms import ScaledTranslation

from atlas.argument_checks import validate_flag
from atlas.errors import InputError, brief_repr
from atlas.render.looks import Entry
from atlas.render.options import ScaleOptions
from atlas.render.style import DPI, artist, defaults, drawing_context, rc_params
from atlas.render.text_wrap import TITLE, wrap_texts

WIDTH = 7.0
"""Default width of a figure in inches: two columns of a journal."""

_FONT = 10.0
"""Type size in points at the standard width; all type sizes here are relative to it."""
_NARROW, _NARROW_FONT = 85.0 / 25.4, 8.0
"""Width, in inches, of a figure in one column of a journal, and its type size in points."""
_SHOWN_DPI = 144.0
"""Dots per inch of a figure in a notebook; coarse screens show 72 of them per inch of the figure."""
_INCHES = {"mm": 1.0 / 25.4, "cm": 1.0 / 2.54, "in": 1.0}
_PIXELS = (1500, 1100)
"""Size (x, y), in pixels, of a map's plot in a file of the standard layout; all cells larger than a pixel are drawn."""
_LENGTHS = (0.8, 60.0)
"""Minimum and maximum width or height of a figure in inches."""
_BESIDE = 5.0
"""Minimum width in inches of a figure with a legend beside its plot."""


class NotebookFigure(Figure):
    """A figure that a notebook shows by itself, without pyplot or a magic line; threads that draw it take turns."""

    def savefig(self, *value: Any, **options: Any) -> None:
        """Save the figure as Matplotlib does, while no other thread draws."""
        with drawing_context():
            super().savefig(*value, **options)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        width, height = self.get_size_inches()
        data = BytesIO()
        self.savefig(data, format="png", dpi=_SHOWN_DPI)
        # Shown at half of its pixels, for fine screens.
        return data.getvalue(), {"width": round(width * _SHOWN_DPI / 2), "height": round(height * _SHOWN_DPI / 2)}


@dataclass(frozen=True)
class FigureLayout:
    """The layout of a figure.

    width      width in inches
    height     height in inches; None for the default of the picture
    font       type size in points
    dpi        dots per inch
    vmin       lower colour limit; None for the default
    vmax       upper colour limit; None for the default
    title      True if the figure has a title
    explained  True if the figure has a legend
    rc         settings of Matplotlib
    axes       axes to draw into, in place of a new figure
    """

    width: float = WIDTH
    height: float | None = None
    font: float = _FONT
    dpi: float = DPI
    vmin: float | None = None
    vmax: float | None = None
    title: bool = True
    explained: bool = True
    rc: Mapping[str, Any] = field(default_factory=dict)
    axes: tuple[Axes, ...] = ()

    @property
    def scale(self) -> float:
        """The type size relative to the standard layout."""
        return self.font / _FONT

    @property
    def has_side_legend(self) -> bool:
        """True if the figure is wide enough for a legend beside its plot."""
        return self.width >= _BESIDE * self.scale

    @property
    def map_height(self) -> float:
        """Default height of a map in inches."""
        return 1.2 + 0.5 * self.width

    @property
    def map_size(self) -> tuple[float, float]:
        """Nominal width and height of a map's plot in points."""
        return self.plot_size(self.map_height)

    @property
    def map_pixels(self) -> tuple[int, int]:
        """Number of pixels (x, y) of a map's plot; an atlas with more cells is drawn from an overview."""
        dots = self.dpi / DPI
        width, tall = (mine / standard for mine, standard in zip(self.map_size, STANDARD.map_size, strict=True))
        return max(1, round(_PIXELS[0] * width * dots)), max(1, round(_PIXELS[1] * tall * dots))

    def plot_size(self, height: float) -> tuple[float, float]:
        """Return the approximate width and height of the plot in points, before the figure is laid out.

        ``height`` is the default height of the figure in inches.
        """
        if self.axes:
            extent, dots = self.axes[0].get_window_extent(), _root(self.axes[0]).dpi
            return float(extent.width) / dots * 72.0, float(extent.height) / dots * 72.0
        return 0.8 * self.width * 72.0, 0.8 * (self.height or height) * 72.0

    def context(self) -> AbstractContextManager[None]:
        """Return a context with this layout's settings of Matplotlib; its end restores the former settings."""
        settings: Any = rc_params(self.scale)
        if self.axes:  # given axes have a type size already
            settings = {name: settings[name] for name in _OURS}
        else:
            settings = defaults() | settings | {"savefig.dpi": self.dpi}
        return drawing_context(settings | dict(self.rc))

    def figure(self, height: float) -> Figure:
        """Return an empty figure with room for texts outside its axes; ``height`` is its default height in inches."""
        size, dpi = (self.width, self.height or height), self.dpi if self.dpi != DPI else None
        color = self.rc.get("figure.facecolor", "white")
        drawn = NotebookFigure(figsize=size, layout="constrained", facecolor=color, dpi=dpi)
        FigureCanvasAgg(drawn)
        return drawn

    def panels(self, height: float, count: int, title: str) -> tuple[Figure, list[Axes]]:
        """Return a figure with ``count`` plots over one shared axis, and the plots, under a title.

        If the layout has axes, these are the plots. Raise InputError if their number is not ``count``. ``height`` is
        the default height of the figure in inches.
        """
        if self.axes and len(self.axes) != count:
            raise InputError(f"ax: found {len(self.axes)} axes, must be {count}, one for each plot")
        drawn = _root(self.axes[0]) if self.axes else self.figure(height)
        if self.axes and self.explained:
            _make_room(drawn)
        plots = list(self.axes or drawn.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
        if self.title:
            plots[0].set_title(title, loc="left", gid=TITLE)
        return drawn, plots

    def add_title(self, fig: Figure, title: str, **style: Any) -> None:
        """Add a title over all plots of a figure."""
        if self.title:
            size = mpl.rcParams["font.size"]
            fig.suptitle(title, fontsize=size, ha="left", x=0.012, **style).set_gid(TITLE)

    def ends(self, low: float, high: float) -> tuple[float, float]:
        """Return the colour limits: vmin and vmax of the layout, or else ``low`` and ``high``.

        Raise InputError unless the limits increase.
        """
        low = low if self.vmin is None else self.vmin
        high = high if self.vmax is None else self.vmax
        if not low < high:
            raise InputError(f"colour limits: found {low:g} to {high:g}, must increase; give vmin, vmax or both")
        return low, high

    def check_no_limits(self, reason: str) -> None:
        """Raise InputError if colour limits are given for a picture without a colour scale, named by ``reason``."""
        if self.vmin is not None or self.vmax is not None:
            raise InputError(f"{reason}: there are no colour limits for vmin and vmax to set")

    def legend(self, fig: Figure, entries: Sequence[Entry], side_title: str | None = None, **style: Any) -> None:
        """Draw a legend under the plots in as many columns as fit, or to the right if ``side_title`` is a title or "".

        Narrow figures have the legend below. There is no legend without entries, or if ``explained`` of the layout is
        False. A long legend extends a figure of default height instead of shrinking the plot.
        """
        if not (entries and self.explained):
            return
        aside = side_title is not None and (self.has_side_legend or bool(self.axes))
        if side_title:
            style |= {"title": side_title if aside else side_title.replace("\n", " "), "alignment": "left"}
        if aside:
            drawn_legend = self._one_legend(fig, entries, True, {"labelspacing": 0.45, **style})
            self._grow(fig, drawn_legend.get_window_extent().height - fig.bbox.height + 0.1 * fig.dpi)
            return
        room = self.axes[-1].get_window_extent().width if self.axes else fig.bbox.width
        for columns in range(len(entries), 0, -1):
            rows = -(-len(entries) // columns)
            if columns > 1 and -(-len(entries) // rows) != columns:
                continue  # legends fill columns first; equal rows look best
            drawn_legend = self._one_legend(fig, entries, False, {"ncols": columns, **style})
            extent = drawn_legend.get_window_extent()
            if columns == 1 or extent.width <= room - 4.0:
                self._grow(fig, extent.height * (rows - 2) / rows)
                return
            drawn_legend.remove()

    def _one_legend(self, fig: Figure, entries: Sequence[Entry], aside: bool, style: dict[str, Any]) -> Legend:
        host: Any = fig if not self.axes else self.axes[0 if aside else -1]
        location: dict[str, Any]
        if not self.axes:
            location = (
                {"loc": "outside right upper"} if aside else {"loc": "outside lower center", "columnspacing": 1.4}
            )
        elif aside:
            location = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0)}
        else:
            drop = host.transAxes + ScaledTranslation(0.0, -3.4 * self.font / 72.0, _root(host).dpi_scale_trans)
            location = {"loc": "upper left", "bbox_to_anchor": (0, 0), "bbox_transform": drop, "borderaxespad": 0.0}
        legend: Legend = host.legend(handles=[artist(entry) for entry in entries], **location | style)
        return legend

    def _grow(self, fig: Figure, dots: float) -> None:
        if dots > 0.0 and not self.axes and self.height is None:
            fig.set_size_inches(self.width, fig.get_size_inches()[1] + dots / fig.dpi)

    def wrap_texts(self, fig: Figure) -> None:
        """Break labels and titles that are longer than the figure into lines. Axes given by the user are left alone."""
        if not self.axes:
            with self.context():
                wrap_texts(fig)

    def finalize(self, fig: Figure) -> None:
        """Break long texts and lay the figure out, after which its plots have their final size."""
        self.wrap_texts(fig)
        fig.draw_without_rendering()


STANDARD = FigureLayout()


def page(ax: Axes | Iterable[Axes] | None = None, **style: Any) -> FigureLayout:
    """Return the figure layout with the given options, see ``ScaleOptions``.

    ``ax`` are the axes to draw into, for a sweep one for each plot. Raise InputError for an invalid length, size or
    resolution, and for an unreadable style.
    """
    unknown = set(style) - set(ScaleOptions.__annotations__)
    if unknown:
        raise InputError(
            f"unknown option {sorted(unknown)[0]!r}; possible: {', '.join([*ScaleOptions.__annotations__, 'ax'])}"
        )
    wrong = InputError(
        f"ax: found {brief_repr(ax)}, must be matplotlib axes, one or, for a sweep, one for each of its plots"
    )
    try:
        axes = () if ax is None else (ax,) if isinstance(ax, Axes) else tuple(ax)
    except TypeError:
        raise wrong from None
    if any(not isinstance(plot, Axes) for plot in axes):
        raise wrong
    for name in ("width", "height"):
        if axes and style.get(name) is not None:
            raise InputError(f"{name}: the given axes have a size already")
    rc = _style(style.get("style"))
    figsize = rc.pop("figure.figsize", (None, None))
    width = _length("width", style.get("width")) or figsize[0] or WIDTH
    font_size = _number("font_size", style.get("font_size"), positive=True)
    usual = mpl.rcParams["font.size"] if axes else np.interp(width, (_NARROW, WIDTH), (_NARROW_FONT, _FONT))
    font = float(font_size or rc.get("font.size") or usual)
    if font_size:
        rc = {name: value for name, value in rc.items() if name not in _SIZES}
        rc |= {name: rc_params(font / _FONT)[name] for name in _SIZES if axes}
    styled = rc.pop("savefig.dpi", DPI)  # removed: settings of the style override the layout's
    dpi = _number("dpi", style.get("dpi"), positive=True) or (styled if isinstance(styled, float) else DPI)
    if font * dpi / 72.0 < _LEAST_DOTS:
        raise InputError(
            f"dpi: found {dpi:g}, with type of {font:g} points, makes letters of {font * dpi / 72.0:.2g} dots; must "
            f"make them {_LEAST_DOTS:g} or more"
        )
    return FigureLayout(
        width=width,
        height=_length("height", style.get("height")) or (figsize[1] if style.get("width") is None else None),
        font=font,
        dpi=dpi,
        vmin=_number("vmin", style.get("vmin")),
        vmax=_number("vmax", style.get("vmax")),
        title=validate_flag("title", style.get("title", True)),
        explained=validate_flag("legend", style.get("legend", True)),
        rc=rc,
        axes=axes,
    )


def _length(name: str, value: float | str | None) -> float | None:
    """Return a length in inches from a number or from a text with a unit, such as "85mm".

    Raise InputError for any other value.
    """
    if value is None:
        return None
    if isinstance(value, str):
        match = re.fullmatch(r"\s*([+-]?(?:\d+\.?\d*|\.\d+))\s*(mm|cm|in)\s*", value)
        if not match:
            raise InputError(f"{name}: found {brief_repr(value)}, must be a length such as 85mm, 8.5cm or 3.35in")
        value = float(match[1]) * _INCHES[match[2]]
    inches = _number(name, value) or 0.0
    low, high = _LENGTHS
    if not low <= inches <= high:
        raise InputError(
            f"{name}: found {inches:.3g} inches, must be {low:g} to {high:g} inches ({25.4 * low:.0f}mm to "
            f"{25.4 * high:.0f}mm)"
        )
    return inches


def _number(name: str, value: float | None, positive: bool = False) -> float | None:
    """Return an option's value as a finite number, None if it is None.

    With ``positive`` the number must be positive and at most 10 000. Raise InputError for any other value.
    """
    if value is None:
        return None
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name}: found {brief_repr(value)}, must be a number")
    if positive and not 0.0 < number <= 1e4:
        raise InputError(f"{name}: found {number:g}, must be positive and at most 10000")
    return number


CURRENT = "current"
"""Name of the style that consists of the Matplotlib settings changed by the user."""
_LEAST_DOTS = 4.0
"""Minimum size of a letter in dots: an index of an index is half as large and needs a dot."""
_OURS = ("legend.frameon", "legend.handlelength", "legend.handleheight", "hatch.linewidth")
"""Settings of Matplotlib that the layout sets even for given axes."""
_SIZES = tuple(name for name in rc_params(1.0) if name.endswith("size"))


def _style(style: str | Path | None) -> dict[str, Any]:
    """Return the Matplotlib settings of a style, without those of windows and of the figure's layout."""
    if style is None:
        return {}
    if not isinstance(style, str | os.PathLike):
        right = f"must be a style of matplotlib, {CURRENT!r} or the path of a file"
        raise InputError(f"style: found {brief_repr(style)}, {right}")
    settings: Any
    if str(style) == CURRENT:
        of_all: Any = mpl.rcParams
        with drawing_context():
            settings = {name: of_all[name] for name, usual in defaults().items() if of_all[name] != usual}
    elif str(style) in mpl_style.library:
        settings = mpl_style.library[str(style)]
    else:
        if os.path.exists(style) and not os.path.isfile(style) and not os.path.isdir(style):
            raise InputError(f"style {style}: not a regular file")  # reading a device or a pipe may never end
        try:
            settings = mpl.rc_params_from_file(style, use_default_template=False)
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"style {style}: neither a style of matplotlib nor a readable file: {why}") from None
    layout = ("figure.autolayout", "figure.constrained_layout.use", "savefig.bbox", "savefig.format", "backend")
    return {name: settings[name] for name in settings if name not in layout and not name.startswith("figure.subplot")}


def _make_room(fig: Figure) -> None:
    """Give a user's figure without a layout engine room for a legend beside or under its plots.

    Without room the legend would be cut off. The tight engine tolerates a later ``tight_layout`` or
    ``subplots_adjust``. Axes at explicit positions stay there.
    """
    if fig.get_layout_engine() is None and all(ax.get_subplotspec() is not None for ax in fig.axes):
        fig.set_layout_engine("tight")


def _root(ax: Axes) -> Figure:
    root = ax.get_figure(root=True)
    if root is None:
        raise InputError("ax: found axes that belong to no figure any more")
    return root
