"""The accessor ``ds.atlas``: queries and pictures of an atlas as methods of its dataset.

The accessor holds nothing but the dataset. ``xarray_engine.py`` registers it with xarray.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import xarray as xr

from atlas.errors import InputError
from atlas.orbits.branches.from_cell import MAX_BRANCHES, observed_of, tree_from
from atlas.orbits.branches.seed import seed_of_cell
from atlas.orbits.branches.table import BranchTable
from atlas.orbits.curves.queries import CurveFrames, curves_of, to_frames
from atlas.query import connected_regions
from atlas.query import queries as query
from atlas.query.attractors import select_dominant
from atlas.query.basins import basin_measures
from atlas.query.cell import read_cell_spec
from atlas.query.compare import Comparison
from atlas.query.extremes import extremes
from atlas.query.window import Window, axis_names
from atlas.render import check_path, figure, portrait
from atlas.render.options import AtlasFigureOptions, FigureOptions, ScaleOptions, accepts_options, split_look
from atlas.spec.spec import given_values
from atlas.spec.system import stored_name

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from atlas.explore.session import ExplorerSession


class PlottableComparison(Comparison):
    """The comparison of two atlases, with a method that draws it."""

    @accepts_options(ScaleOptions)
    def plot(self, path: str | Path | None = None, **look: Unpack[ScaleOptions]) -> "Figure":
        """Return a matplotlib Figure of two maps: differences of exponents, and cells whose regimes differ.

        A notebook shows the figure. It is also written to ``path`` if given: ``plot(width="85mm")``.
        """
        drawn: Figure = figure(self, path=path, **look)
        return drawn


class PlottableBranches(BranchTable):
    """Branches of periodic orbits along a parameter, with a method that draws them."""

    @accepts_options(FigureOptions)
    def plot(self, path: str | Path | None = None, **look: Unpack[FigureOptions]) -> "Figure":
        """Return a matplotlib Figure of the orbits' states over the parameter: stable branches solid, unstable ones
        dashed.

        A state is taken once per forcing period. A notebook shows the figure. It is also written to ``path`` if given:
        ``plot(width="85mm")``.
        """
        drawn: Figure = figure(self, path=path, **look)
        return drawn


def _table(rows: Iterable[Mapping[str, Any]]) -> "pd.DataFrame":
    """Return a pandas data frame of rows, given as mappings by column."""
    import pandas as pd

    return pd.DataFrame(list(rows))


def _series(values: Mapping[str, Any], name: str, index: str, kind: type) -> "pd.Series[Any]":
    """Return a pandas series of values by name.

    name   name of the series
    index  name of its index
    kind   type of the values
    """
    import pandas as pd

    return pd.Series(list(values.values()), pd.Index(list(values), name=index, dtype=object), kind, name)


class AtlasAccessor:
    """Queries and pictures of an atlas that is opened as a dataset.

    In an atlas of all attractors every method but ``at`` uses the attractor with the largest share of each cell;
    ``ds.isel(attractor=1).atlas`` uses the next one. All methods accept any selection of an atlas along its axes. A
    ``window`` limits any axis to the values from low to high, given as (low, high). Raise ``atlas.errors.InputError``,
    with a message of one line, for bad input.
    """

    def __init__(self, ds: xr.Dataset) -> None:
        self._whole, self._ds = ds, select_dominant(ds)

    def __repr__(self) -> str:
        cells = " x ".join(f"{self._ds.sizes[name]} {name}" for name in axis_names(self._ds))
        name = stored_name(self._ds.attrs) or "an unknown system"
        return f"<atlas of {name}: {cells} cells; help(ds.atlas) lists its methods>"

    def at(self, given: "Mapping[str, ArrayLike] | None" = None, /, **points: "ArrayLike") -> xr.Dataset:
        """Return all results of the cells nearest to points, and the distances of the points: ``at(omega=[3, 3.5],
        b=0.15)``.

        Lists give the dimension ``point``. In an atlas of all attractors the results have the dimension ``attractor``.
        See ``queries.nearest_cells``.
        """
        return query.nearest_cells(self._whole, given_values(given, points))

    def is_(self, *regimes: str) -> xr.DataArray:
        """Return the mask of the cells that have one of these regimes: ``ds.largest.where(ds.atlas.is_("chaotic"))``.

        ``ds.regime`` itself holds codes. See ``queries.is_regime``.
        """
        return query.is_regime(self._whole, regimes)

    def where_regime(self, *regimes: str) -> xr.Dataset:
        """Return the atlas with all cells masked that have none of these regimes: ``where_regime("chaotic")``.

        See ``queries.where_regime``.
        """
        return query.where_regime(self._ds, regimes)

    def fractions(self, window: Window | None = None) -> "pd.Series[float]":
        """Return the fraction of the area, in the units of the axes, of each regime. See ``queries.fractions``."""
        return _series(query.fractions(self._ds, window), "fraction", "regime", float)

    def count_reasons(self, window: Window | None = None) -> "pd.Series[int]":
        """Return the number of cells without a certain result, by reason. See ``queries.count_reasons``."""
        return _series(query.count_reasons(self._ds, window), "cells", "reason", int)

    def extremes(self, name: str, by: str = "regime", window: Window | None = None) -> "pd.DataFrame":
        """Return the smallest and largest values of a variable in each regime, period or impact pattern.

        ``by="all"`` takes all cells together. See ``extremes.extremes``.
        """
        return _table(extremes(self._ds, name, by, window))

    def regions(
        self, by: str = "regime", value: object = None, window: Window | None = None, min_cells: int = 1
    ) -> "pd.DataFrame":
        """Return the connected regions of equal regime, period or impacts: ``regions("period", 3)``.

        ``regions("chaotic")`` returns regions of one regime. Each row is a region, the largest first. Columns such as
        ``centre_omega``, ``cell_omega``, ``omega_from`` and ``omega_to`` are its centre, its cell and its window. See
        ``connected_regions.regions``.
        """
        return _table(map(connected_regions.flat, connected_regions.regions(self._ds, by, value, window, min_cells)))

    def labels(
        self, by: str = "regime", value: object = None, window: Window | None = None, min_cells: int = 1
    ) -> xr.DataArray:
        """Return an array with the number of the connected region of each cell, 0 if it is in none.

        The arguments are those of ``regions``. See ``connected_regions.labels``.
        """
        return connected_regions.labels(self._ds, by, value, window, min_cells)

    def basin_measures(self, window: Window | None = None) -> xr.Dataset:
        """Return shares, entropy and dimension of the basins of a plane of initial states.

        The results of the attractors have the dimension ``label``. See ``basins.basins``.
        """
        return basin_measures(self._ds, window)

    def boundary(self, regime: str, other: str | None = None, window: Window | None = None) -> "pd.DataFrame":
        """Return the lines between the cells of a regime and those of another, or of any other: ``boundary("chaotic",
        "periodic")``.

        Each row is a point of a line, with the regimes on both sides. See ``queries.boundary``.
        """
        return query.boundary(self._ds, regime, other, window)

    def per_unit_time(self) -> xr.Dataset:
        """Return the atlas with exponents per unit time, not per forcing period. See ``queries.per_unit_time``."""
        return query.per_unit_time(self._ds)

    def curves(self, kind: str | None = None) -> CurveFrames:
        """Return tables of the curves that ``atlas find curves`` found, of one kind or all: ``curves("fold").points``.

        ``points`` has a row for each point of a curve, ``corners`` for each point of codimension two. See
        ``atlas.orbits.curves.queries.to_frames``.
        """
        return to_frames(curves_of(self._ds), kind)

    def distance_to(
        self, given: Mapping[str, float] | None = None, /, *, kind: str | None = None, **point: float
    ) -> "pd.DataFrame":
        """Return the distances of an operating point to the nearest bifurcations and grazes of its orbit.

        ``distance_to(omega=3, b=0.15, kind="fold")``. The rows are the first events along each axis in both directions,
        of one kind or any, the nearest first. See ``atlas.orbits.curves.distance.distance_to``.
        """
        from atlas.orbits.curves.distance import distance_to  # loads Numba

        return _table(distance_to(self._ds, kind, given_values(given, point)))

    def compare(self, other: xr.Dataset, window: Window | None = None) -> PlottableComparison:
        """Return the comparison of this atlas with another atlas of the same axes.

        The comparison has ``difference``, ``regimes``, ``numbers`` and ``plot()``. See ``compare.Comparison``.
        """
        return PlottableComparison.from_atlases(self._ds, select_dominant(other), window)

    def branch(
        self,
        given: Mapping[str, float] | None = None,
        /,
        *,
        along: str,
        window: tuple[float, float],
        switch_branches: bool = False,
        budget: int = MAX_BRANCHES,
        observe: str | None = None,
        **point: float,
    ) -> PlottableBranches:
        """Follow the periodic orbit of the cell nearest to a point along one parameter, stable and unstable.

        ``branch(omega=3, b=0.15, along="omega", window=(2, 4))`` starts from the stored orbit. See ``atlas.branch``,
        also for the result.
        """
        seed = seed_of_cell(self._ds, given_values(given, point))
        observable = observed_of(seed, observe)
        return PlottableBranches.from_tree(tree_from(seed, along, window, switch_branches, budget), observable)

    @accepts_options(ScaleOptions)
    def plot_side_by_side(
        self, *others: xr.Dataset, kind: str | None = None, window: Window | None = None, **look: Unpack[ScaleOptions]
    ) -> "Figure":
        """Return a Figure of maps of this atlas and of others: ``plot_side_by_side(other, width="85mm")``.

        The maps share their colour limits. ``kind`` is "exponent" or "period", by default the first kind that all
        atlases have.
        """
        drawn: Figure = figure([self._ds, *others], kind, window, **look)
        return drawn

    @accepts_options(AtlasFigureOptions)
    def plot(self, kind: str | None = None, window: Window | None = None, **options: Unpack[AtlasFigureOptions]) -> Any:
        """Return a matplotlib Figure of a map; or draw into ``ax`` and return it, if given.

        ``plot("period", width="85mm", overlay="grazing")``. A notebook shows the figure as the last line of a cell;
        ``savefig`` writes it.

        kind      one of ``atlas.render.KINDS``, by default the first that fits the axes; see ``atlas plot --help``
        window    (low, high) for each axis to limit
        options   the options of the command, with the same names
        """
        return figure(self._whole, kind, window=window, **options)

    def explore(
        self,
        *,
        client: "Client | None" = None,
        scheduler: str | None = None,
        workers: int | None = None,
        tolerance: float | None = None,
        folder: Path | None = None,
        port: int = 0,
        host: str = "127.0.0.1",
    ) -> "ExplorerSession":
        """Open a page in the browser that shows any part of this atlas at any zoom level; a notebook shows the page in
        place.

        ``stop()`` of the result closes the page. The address of the page has a token; only those who have the token can
        open the page.

        client      Dask client whose workers solve cells
        scheduler   address of a Dask cluster whose workers solve cells
        workers     number of local processes that solve cells, by default one per processor
        tolerance   standard error of the exponents of solved cells, by default 0.05
        folder      folder for the specs of new atlases, by default the working directory
        port        port of the page, by default any free one
        host        address on which the page is served
        """
        from atlas.explore.session import explore_dataset
        from atlas.explore.subject import TOLERANCE

        return explore_dataset(
            self._ds, TOLERANCE if tolerance is None else tolerance, client=client, scheduler=scheduler,
            workers=workers, folder=folder, port=port, host=host,
        )  # fmt: skip

    def to_html(self, path: str | Path) -> Path:
        """Write this plane as one HTML file that any browser opens without a server: ``to_html("plane.html")``.

        The file has at most 20 MB: the cells with all their numbers, every kind of map, the curves of the store, the
        spec and citations. See ``atlas.explore.static.page.write_page``.
        """
        from atlas.explore.static.page import write_page

        return write_page(self._whole, path)

    @accepts_options(FigureOptions, others=True)
    def portrait(
        self, given: Mapping[str, float] | None = None, /, *, path: str | Path | None = None, **point: Any
    ) -> "Figure":
        """Return a figure of the motion of the cell nearest to a point, solved anew with the atlas's settings.

        In an atlas of all attractors it shows the attractor with the largest share, or the selected one. The result is
        a matplotlib Figure, which a notebook shows. It is also written to ``path`` if given: ``portrait(omega=3,
        b=0.15, width="85mm")``. See ``atlas.portrait``.
        """
        look, named = split_look(point)
        for name in named:
            if name not in self._ds.coords:
                possible = ", ".join([*axis_names(self._ds), "path", *FigureOptions.__annotations__])
                raise InputError(f"unknown option {name!r}; possible: {possible}")
        if path is not None:
            check_path(path)
        cell = read_cell_spec(self._ds, given_values(given, named))
        return portrait(cell.parameters, system=cell.system, settings=cell.settings, path=path, **look)
