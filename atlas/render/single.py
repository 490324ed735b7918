"""The way from a kind to its map, the same for all: read, paint, frame, draw, overlays, bars, legend, names."""

import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from atlas.render import impacts, maps, names, overlays, scales
from atlas.render.kinds import TABLE, drawn_by


def draw_map(
    kind: str, ds: xr.Dataset, options: maps.Options = maps.PLAIN, variable: str | None = None, log: bool = False
) -> Figure:
    """The map of a kind as a figure, with its overlays; ``variable`` and ``log`` are those of the kind "scalar".

    InputError where the atlas does not hold what it draws.
    """
    row, page = TABLE[kind], options.page
    if row.paint.endswith(".figure"):  # it draws more than cells
        return drawn_by(kind)(ds, options)
    variables = row.variables if variable is None else scales.checked(ds, variable)
    plane = overlays.read(ds, variables, kind, options, row.lacking)
    painted: maps.Painted = drawn_by(kind)(maps.View(row, ds, plane, page, variable or "", log))
    with page.context():
        drawn, ax = maps.frame(ds, page)
        entries: list[Artist] = [*maps.lay(ax, plane, painted, options), *overlays.draw(ax, ds, plane, options)]
        scales.draw_bars(drawn, [ax], painted.bars, page)
        page.legend(drawn, entries, beside=painted.beside)
        if painted.names and options.names:
            page.fit(drawn)
            drawn.draw_without_rendering()  # from here on the plot has its size
            names.in_regions(ax, plane, painted.names, [impacts.LABEL_SIZE * page.scale])
    return drawn
