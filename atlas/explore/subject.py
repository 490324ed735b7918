"""The subject of an explorer: the plane of a store or of a spec that is explored, and the settings for its cells."""

import math
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, check_names
from atlas.explore.grid_patch import GridPatch, packed
from atlas.explore.lattice import Lattice
from atlas.explore.viewport import TILE_CELLS, CellRange, TileKey, Viewport
from atlas.query.attractors import select_own
from atlas.query.open import open_atlas
from atlas.query.window import select
from atlas.spec.axis import Axis, validate_in_range
from atlas.spec.cells import edges_of, nearest
from atlas.spec.resolved import digest_of
from atlas.spec.spec import MAX_AXES, Spec, validate_parameters
from atlas.store.object_backend import StoreBackend, is_url, open_backend
from atlas.store.store import AtlasStore, open_store
from workers import SOLVER_VERSION, Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.parameter import Parameter
from workers.model.system import System, identity
from workers.results import REASON, REGIME, Variable, empty_results

if TYPE_CHECKING:
    import xarray as xr

Arrays = dict[str, NDArray[Any]]
"""Results of cells, by name of the variable."""

TOLERANCE = 0.05
"""Default tolerance, the standard error of the largest exponent, of cells that the explorer solves.

It is finer than a map can show.
"""
SURVIVAL = 2000
"""Maximum number of forcing periods for which cells that the explorer solves are watched for the end of chaos."""
STARTS = AttractorSettings(keep=16)
"""Settings of the search for attractors of a cell, unless the spec has its own."""
STEPS = 200
"""Number of steps of a slider."""
POINTS = 401
"""Number of points, at level zero, of an axis over a parameter that is fixed in the spec."""


def exploration_settings(settings: Settings, tolerance: float = TOLERANCE, survival: int = SURVIVAL) -> Settings:
    """Return the settings with which the explorer solves cells of an atlas.

    They are the atlas's own settings, with two changes that save time. The tolerance of the exponents is raised to at
    least ``tolerance``. The maximum number of periods watched for chaos, ``survival``, is lowered to at most
    ``survival``. Section states and observables are not stored.
    """
    return replace(
        settings,
        tolerance=max(settings.tolerance, tolerance),
        survival=min(settings.survival, survival),
        section_samples=0,
        observe="",
    )


@dataclass(frozen=True)
class PlaneParameters:
    """The fixed parameters that select a plane of a system: name and value of each parameter that is not an axis.

    Their order is that of the system.
    """

    parameters: tuple[tuple[str, float], ...]

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, float]) -> "PlaneParameters":
        """Return the plane with these fixed parameters, given by name."""
        return cls(tuple(parameters.items()))

    def with_value(self, name: str, value: float) -> "PlaneParameters":
        """Return the plane in which the fixed parameter ``name`` has the value ``value``."""
        return PlaneParameters(
            tuple((parameter, value if parameter == name else old) for parameter, old in self.parameters)
        )


@dataclass(frozen=True, eq=False)
class Subject:
    """The subject of an explorer: a spec of two axes, its store if there is one, and the settings for exploring.

    spec               spec of the plane that is explored
    settings           settings of cells that the explorer solves
    store              handle of the store; None if a spec is explored
    ds                 plane of the store as a dataset, with all stored attractors of its cells; None without a store
    layer              index of the plane in a stack (an atlas of three axes)
    attractors         settings of the spec's search for all attractors of each cell; None without a search
    stack_axis         third axis of a stack; None if there is no stack
    subject_of_layer   returns the subject of the layer at a value of the stack axis
    """

    spec: Spec
    settings: Settings
    store: AtlasStore | None = None
    ds: "xr.Dataset | None" = None
    layer: int = 0
    attractors: AttractorSettings | None = None
    stack_axis: Axis | None = None
    subject_of_layer: "Callable[[float], Subject] | None" = None

    @property
    def all_attractors(self) -> "xr.Dataset | None":
        """The plane of the store with all attractors of its cells; None if they are not stored."""
        return None if self.ds is None or self.attractors is None else self.ds

    def part(self, cells: Mapping[str, Any]) -> "xr.Dataset":
        """Return cells of the store as a dataset, each with the attractor that its own initial state reaches.

        ``cells`` gives the indices of the cells along axes, by the axes' names. If a run is filling the store, the
        cells are read as they are at this moment.
        """
        assert self.ds is not None
        part = self.ds.isel(cells)
        return part if self.all_attractors is None else select_own(part)

    @property
    def starts(self) -> AttractorSettings:
        """Settings of the search for all attractors of a cell."""
        return STARTS if self.attractors is None else self.attractors

    @property
    def can_search_attractors(self) -> bool:
        """True if attractors of the cells can be searched from many initial states."""
        return self.settings.method == "adaptive"

    @property
    def system(self) -> System:
        """The system whose cells are explored."""
        return self.spec.system_def

    @cached_property
    def x(self) -> Lattice:
        """The points of the horizontal axis at all zoom levels."""
        return Lattice(self.spec.axes[0])

    @cached_property
    def y(self) -> Lattice:
        """The points of the vertical axis at all zoom levels."""
        return Lattice(self.spec.axes[1])

    @property
    def axes(self) -> tuple[str, str]:
        """The names of the horizontal and the vertical axis."""
        x, y = (axis.name for axis in self.spec.axes)
        return x, y

    @property
    def layer_value(self) -> float | None:
        """The value of the stack axis at this plane; None if there is no stack."""
        return None if self.stack_axis is None else self.stack_axis.values[self.layer]

    def with_axes(self, axes: tuple[str, str], layer: float | None = None) -> "Subject":
        """Return the subject of the same system over other axes, or of another layer of a stack.

        axes    names of the axes across and up; other parameters have the middle values of the present axes
        layer   value of the stack axis; None for the present layer

        Over other axes there is no store. Raise InputError if the axes are not two different parameters, or if the
        stack does not have the layer.
        """
        if layer is not None and layer != self.layer_value:
            if self.stack_axis is None or self.subject_of_layer is None or layer not in self.stack_axis.values:
                known = "none" if self.stack_axis is None else ", ".join(f"{v:g}" for v in self.stack_axis.values)
                raise InputError(f"layer: found {layer:g}; possible: {known}")
            return self.subject_of_layer(layer).with_axes(axes)
        if axes == self.axes:
            return self
        check_names("axis", axes, [parameter.name for parameter in self.system.parameters])
        if axes[0] == axes[1]:
            raise InputError(f"axes: found {axes[0]} twice, must be two parameters")
        spec_axes = {axis.name: axis for axis in self.spec.axes}
        middle = {name: axis.values[len(axis) // 2] for name, axis in spec_axes.items()}
        values = validate_parameters(self.system, middle | self.spec.parameters)
        new_axes = {name: spec_axes.get(name) or own_axis(self.system.parameter(name), values[name]) for name in axes}
        fixed = {name: values[name] for name in (*middle, *self.spec.parameters) if name not in axes}
        spec = Spec(self.system, new_axes, fixed, self.spec.settings)
        return replace(self, spec=spec, store=None, ds=None)

    @cached_property
    def plane(self) -> PlaneParameters:
        """The fixed parameters of the spec."""
        return PlaneParameters.from_parameters(self.spec.parameters)

    @property
    def name(self) -> str:
        """The name of the store, or of the system if there is no store."""
        return self.spec.system if self.store is None else os.path.basename(str(self.store.backend).rstrip("/"))

    @property
    def has_same_settings(self) -> bool:
        """True if explored cells equal those of the atlas, since settings and solver version are the same.

        Always False for an atlas of all attractors.
        """
        settings = replace(self.spec.settings, section_samples=0, observe="")
        same_solver = self.store is not None and self.store.solver_version == SOLVER_VERSION
        return same_solver and self.all_attractors is None and settings == self.settings

    def digest(self, plane: PlaneParameters) -> str:
        """Return a digest of all that decides explored cells of a plane.

        These are the system, the axes, the fixed parameters ``plane``, the settings and the solver version.
        """
        axes = [[axis.name, axis.values] for axis in self.spec.axes]
        solve = dict(vars(self.settings))
        rest = {"parameters": dict(plane.parameters), "axes": axes, "solve": solve, "solver": SOLVER_VERSION}
        return digest_of(identity(self.system.to_resolved()) | rest)

    def plane_with(self, plane: PlaneParameters, name: str, value: float) -> PlaneParameters:
        """Return the plane in which the fixed parameter ``name`` has the value ``value``.

        Raise InputError if the plane does not have the parameter, or if the value is out of range.
        """
        if name not in dict(plane.parameters):
            raise InputError(f"{name} is no parameter of this plane; possible: {', '.join(dict(plane.parameters))}")
        return plane.with_value(name, validate_in_range(self.system.parameter(name), value))

    def point(self, values: Mapping[str, float]) -> tuple[PlaneParameters, float, float]:
        """Return the plane, and the point (x, y) in it, of a cell with these parameters: the inverse of ``values``."""
        x, y = (values[name] for name in self.axes)
        return PlaneParameters(tuple((name, values[name]) for name, _ in self.plane.parameters)), x, y

    @cached_property
    def variables(self) -> dict[str, Variable]:
        """The variables (arrays of results) of explored cells, by name."""
        return {variable.name: variable for variable in self.system.variables(self.settings)}

    @property
    def numbers(self) -> list[str]:
        """The names of the variables that hold one number per cell, without the regime and its reason."""
        coded = REGIME.name, REASON.name
        return [name for name, variable in self.variables.items() if not variable.extra_dims and name not in coded]

    def without_results(self, names: Collection[str], shape: tuple[int, int]) -> Arrays:
        """Return arrays of ``shape`` for the variables ``names``, by name, filled as for unsolved cells."""
        return empty_results(tuple(self.variables[name] for name in names), shape, self.spec.extra_sizes)

    def values(self, plane: PlaneParameters, x: float, y: float) -> dict[str, float]:
        """Return the values of all parameters, by name, of the cell at (x, y) of a plane."""
        return dict(plane.parameters) | dict(zip(self.axes, (x, y), strict=True))

    def viewport(self, x: tuple[float, float], y: tuple[float, float], pixels: tuple[int, int]) -> Viewport:
        """Return the ranges of visible cells of a window.

        x, y     limits (low, high) of the axes
        pixels   width and height of the window, in pixels

        Their zoom levels are the deepest whose cells are not finer than pixels.
        """
        return Viewport(CellRange.from_window(self.x, *x, pixels[0]), CellRange.from_window(self.y, *y, pixels[1]))

    def points(self, x: CellRange, y: CellRange) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the values of the horizontal and of the vertical axis at ranges of cells."""
        return self.x.values(x.level, x.index), self.y.values(y.level, y.index)

    def valid_mask(self, along: int, level: int, first: int, count: int) -> NDArray[np.bool_]:
        """Return which cells of consecutive tiles have a valid value of an axis, as a mask (count, TILE_CELLS).

        along   axis, 0 across or 1 up
        level   zoom level of the tiles
        first   index of the first tile
        count   number of tiles
        """
        lattice, cells = (self.x, self.y)[along], CellRange(level, first * TILE_CELLS, count * TILE_CELLS)
        values = lattice.values(level, cells.index)
        return np.reshape(self.system.parameter(lattice.axis.name).admits(values), (count, TILE_CELLS))

    def grid(self, plane: PlaneParameters, x: Iterable[float], y: Iterable[float], mask_bits: bytes = b"") -> GridPatch:
        """Return, as a job's argument, the cells of a plane at the values ``x`` and ``y`` of the axes.

        ``mask_bits`` is the packed mask (y, x) of the cells to solve; empty for all cells.
        """
        across, up = ((name, tuple(map(float, values))) for name, values in zip(self.axes, (x, y), strict=True))
        return GridPatch(self.system, dict(plane.parameters), self.settings, across, up, mask_bits)

    def patch(self, plane: PlaneParameters, key: TileKey, missing: NDArray[np.bool_]) -> GridPatch:
        """Return, as a job's argument, the cells of a tile that are to be solved; ``missing`` (y, x) is their mask."""
        return self.grid(plane, *self.points(key.columns, key.rows), packed(missing))


def subject_of(
    source: str | StoreBackend | AtlasStore, view: Mapping[str, float] | None = None, tolerance: float = TOLERANCE
) -> Subject:
    """Return the subject, the plane to explore, that a user names.

    source      a store, a spec by file or name, or the handle of a store
    view        value of the stack axis that selects a plane of a stack; by default the first plane
    tolerance   least tolerance, the standard error of the largest exponent, of explored cells

    Raise InputError if there is no plane to explore.
    """
    if isinstance(source, AtlasStore):
        return _subject(source.spec, source, open_atlas(source), view or {}, tolerance)
    backend = None if str(source).endswith(".toml") else open_backend(source)
    if backend is not None and (backend.exists("zarr.json") or is_url(source) or backend.local is None):
        return subject_of(open_store(backend), view, tolerance)
    return _subject(Spec.from_toml(str(source)), None, None, view or {}, tolerance)


def _subject(
    spec: Spec, handle: AtlasStore | None, ds: "xr.Dataset | None", view: Mapping[str, float], tolerance: float
) -> Subject:
    if spec.points or len(spec.axes) < 2:
        what = "a table of points" if spec.points else f"one axis ({spec.axes[0].name})"
        raise InputError(f"explore shows a plane, found {what}")
    if spec.continuation is not None:
        raise InputError("a continued sweep cannot be explored: each cell depends on the cells before it")
    if spec.basins:
        raise InputError("explore cannot show basins; remove [attractors] from the spec")
    layer, settings, attractors = 0, exploration_settings(spec.settings, tolerance), spec.attractors
    third, original = None, (spec, handle, ds)

    def of_layer(value: float) -> Subject:
        return _subject(*original, {original[0].axes[-1].name: value}, tolerance)

    if len(spec.axes) == MAX_AXES:
        third = spec.axes[-1]
        if set(view) - {third.name}:
            raise InputError(f"--select picks a plane of {third.name}: {', '.join(f'{v:g}' for v in third.values)}")
        points = np.array(third.values)
        edges = edges_of(points, third.scale == "log")
        layer = nearest(third.name, points, edges, view.get(third.name, third.values[0]))
        value = third.values[layer]
        if ds is not None:
            ds = select(ds, {third.name: value})
        axes = {axis.name: axis for axis in spec.axes[:2]}
        spec = Spec(spec.system_def, axes, spec.parameters | {third.name: value}, spec.settings)
    elif view:
        raise InputError(f"--select picks a plane of a stack, found a plane of {', '.join(spec.dims)}")
    if attractors is None:
        return Subject(spec, settings, handle, ds, layer, stack_axis=third, subject_of_layer=of_layer)
    alone = Spec(spec.system_def, {axis.name: axis for axis in spec.axes}, spec.parameters, spec.settings)
    return Subject(alone, settings, handle, ds, layer, attractors, third, of_layer)


def own_axis(parameter: Parameter, value: float) -> Axis:
    """Return an axis for a parameter that the spec fixes at ``value``: evenly spaced points over the slider's range."""
    return Axis(parameter.name, tuple(np.linspace(*slider_range(parameter, value), POINTS).tolist()))


def slider_range(parameter: Parameter, value: float) -> tuple[float, float]:
    """Return the ends (low, high) of a parameter's slider.

    They are the ends of the parameter's valid range where finite, else a distance beyond its default and ``value``. An
    end that the valid range excludes is not reached.
    """
    reach = max(abs(value), abs(parameter.default), 0.5)
    low = parameter.low if math.isfinite(parameter.low) else min(value, parameter.default) - reach
    high = parameter.high if math.isfinite(parameter.high) else max(value, parameter.default) + reach
    inset = (high - low) / STEPS
    low += inset if parameter.low_open and low == parameter.low else 0.0
    high -= inset if parameter.high_open and high == parameter.high else 0.0
    return min(low, value), max(high, value)
