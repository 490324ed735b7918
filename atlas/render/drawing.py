"""One picture of an atlas: the kind that fits it, drawn from what is in view, with what is said about that."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.query.attractors import leading
from atlas.query.queries import fractions
from atlas.query.reads import counted
from atlas.query.window import Window, axis_names, within
from atlas.render.kinds import (
    AXES,
    KINDS,
    MOST_PANELS,
    SCALAR,
    axes_of,
    check_overlays,
    chosen_kind,
    drawn_by,
    scalar_variable,
)
from atlas.spec.spec import MOST_AXES
from workers.results import ATTRACTOR, FAILED, INVALID, LARGEST, PENDING, REGIMES, SECTION, UNDETERMINED

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from atlas.branches.table import Branches
    from atlas.render.page import Page


@dataclass(frozen=True)
class Wanted:
    """What is to be drawn of an atlas, and how; see ``atlas.render.render`` and ``figure``."""

    page: "Page"
    kind: str | None = None
    window: Window | None = None
    overlays: tuple[str, ...] = ()
    curves: tuple[str, ...] | None = None
    names: bool = True
    against: "xr.Dataset | None" = None
    pixels: tuple[int, int] | None = None
    variable: str | None = None
    log: bool = False

    @property
    def is_scalar(self) -> bool:
        """Whether a variable that is named is to be mapped."""
        return self.kind == SCALAR or self.variable is not None or self.log


def draw(ds: "xr.Dataset", wanted: Wanted) -> "Figure":
    """The figure of an atlas; InputError, in one line, for what cannot be drawn of it."""
    every, ds = ds, leading(ds)
    axes, page, window, against = axis_names(ds), wanted.page, wanted.window, wanted.against
    if len(axes) == MOST_AXES:
        return _stack(ds, wanted)
    variable = scalar_variable(ds, wanted.kind, wanted.variable, against) if wanted.is_scalar else None
    kind = SCALAR if variable is not None else chosen_kind(ds, wanted.kind, against, page)
    lines = wanted.overlays
    if wanted.curves is not None and "curves" not in lines and kind != "regions":
        lines = (*lines, "curves")
    check_overlays(ds, lines)
    check_units(ds)
    shown = within(every if kind == "coexistence" else ds, window)
    picture: Figure
    with counted() as reads:
        if len(axes) == 1:
            sweeps = [within(ds, window)] + ([] if against is None else [within(against, window)])
            branches = _branches(sweeps) if "branches" in lines else None
            picture = drawn_by(kind)(shown, *sweeps[1:], page, branches)
        else:
            from atlas.render import maps
            from atlas.render.single import draw_map

            options = maps.Options(lines, page, wanted.pixels, wanted.curves, wanted.names)
            picture = draw_map(kind, shown, options, variable, wanted.log)
    if ds.attrs.get(ATTRACTOR, 0):
        _say_fewer(picture, ds.attrs[ATTRACTOR])
    if max(reads.block) > 1 and page.title:
        _note_coarseness(page.given[0] if page.given else picture.axes[0], shown, reads.block, page)
    page.fit(picture)
    return picture


def _stack(ds: "xr.Dataset", wanted: Wanted) -> "Figure":
    """The planes of a stack as maps on one scale, each under its value of the third axis; a lone plane as it is."""
    kind, page, name, shown = wanted.kind, wanted.page, axis_names(ds)[-1], within(ds, wanted.window)
    rest = {axis: ends for axis, ends in (wanted.window or {}).items() if axis != name}
    count = shown.sizes[name]
    if count == 1:
        return draw(shown.isel({name: 0}), replace(wanted, window=rest))
    first = f"--select {name}={float(shown[name][0]):g}"
    if count > MOST_PANELS:
        raise InputError(f"a stack of {count} planes: at most {MOST_PANELS} are drawn together; pick one by {first}")
    alone = {
        "overlay": wanted.overlays,
        "curves": wanted.curves is not None,
        "against": wanted.against is not None,
        "ax": page.given,
        "variable": wanted.variable,
        "log": wanted.log,
    }
    for what, given in alone.items():
        if given:
            raise InputError(f"{what}: goes with one plane, found a stack of {count}; pick one by {first}")
    if kind in KINDS and axes_of(kind) != 2:
        raise InputError(f"kind {kind!r} draws {AXES[axes_of(kind)]}, found a stack of {count} planes")
    from atlas.render import together

    check_units(ds)
    picture = together.side_by_side([shown.isel({name: k}) for k in range(count)], kind, rest, page=page)
    page.fit(picture)
    return picture


def check_units(ds: "xr.Dataset") -> None:
    """Raise InputError where exponents are in another unit than forcing periods: pictures have no other."""
    units = ds[LARGEST.name].attrs.get("units", LARGEST.units) if LARGEST.name in ds else LARGEST.units
    if units != LARGEST.units:
        raise InputError(f"pictures draw exponents per forcing period, found units {units}; draw the atlas as stored")


def _branches(sweeps: "Sequence[xr.Dataset]") -> "Branches":
    """The branches through sweeps, of an atlas of which sections are drawn."""
    from atlas.branches.sweep import tree_through  # with it Numba
    from atlas.branches.table import Branches

    if any(SECTION.name not in each for each in sweeps):
        raise InputError(
            "overlay 'branches' is drawn over section values, and this atlas holds none; see section_samples"
        )
    return Branches.of(tree_through(sweeps))


def _say_fewer(drawn: "Figure", place: int) -> None:
    """Say in the legends that cells without a result may have too few attractors for this place."""
    for legend in [*drawn.legends, *(ax.get_legend() for ax in drawn.axes)]:
        for label in legend.get_texts() if legend is not None else ():
            if label.get_text() == "pending":
                label.set_text(f"not more than {place}")


def _note_coarseness(ax: "Axes", ds: "xr.Dataset", block: tuple[int, ...], page: "Page") -> None:
    """Say above a map that it is coarser than its atlas, and the exact shares of doubtful cells, too few to be seen."""
    shares = fractions(ds)
    doubtful = [each.name for each in REGIMES if each.code in (PENDING, UNDETERMINED, INVALID, FAILED)]
    least = 1e-4  # less is not worth its digits, but that there is some is
    percent = {name: f"{100 * shares[name]:.2g} %" if shares[name] >= least else "< 0.01 %" for name in shares}
    listed = "".join(f",  {name} {percent[name]}" for name in doubtful if name in percent)
    cells = " × ".join(map(str, block))
    with page.context():
        ax.set_title(f"{ax.get_title('left')}\none cell drawn for {cells} computed{listed}".strip(), loc="left")
