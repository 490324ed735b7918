"""What is explored: a plane of a store or of a spec, the settings of exploring, and other planes beside it."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import InputError
from atlas.explore.lattice import Lattice
from atlas.explore.patch import Patch, packed
from atlas.explore.view import TileKey
from atlas.query.attractors import own
from atlas.query.open import open_atlas
from atlas.query.window import select
from atlas.spec.axis import admitted
from atlas.spec.resolved import digest_of
from atlas.spec.spec import MOST_AXES, Spec
from atlas.store.location import is_url, place_of
from atlas.store.store import Header, read_header
from workers import SOLVER_VERSION, Settings
from workers.attractors.starts import Starts
from workers.model.system import System, identity

if TYPE_CHECKING:
    import xarray as xr

TOLERANCE = 0.05
"""Standard error of the largest exponent that exploring asks for: finer than a map can show."""
SURVIVAL = 2000
"""Forcing periods for which exploring watches chaos."""
STARTS = Starts(keep=16)
"""From which initial states the attractors of a cell are sought, unless the spec says."""


def exploring(settings: Settings, tolerance: float = TOLERANCE, survival: int = SURVIVAL) -> Settings:
    """The settings of exploring an atlas with these settings: not more exact than they are, and as coarse as asked."""
    return replace(
        settings,
        tolerance=max(settings.tolerance, tolerance),
        survival=min(settings.survival, survival),
        section_samples=0,
    )


@dataclass(frozen=True)
class Plane:
    """One plane of a system: the parameters that are no axes, as pairs in the system's order."""

    parameters: tuple[tuple[str, float], ...]

    @classmethod
    def of(cls, parameters: Mapping[str, float]) -> "Plane":
        """The plane of these parameters."""
        return cls(tuple(parameters.items()))

    def moved(self, name: str, value: float) -> "Plane":
        """The plane with another value of one parameter."""
        return Plane(tuple((each, value if each == name else old) for each, old in self.parameters))


@dataclass(frozen=True, eq=False)
class Subject:
    """What a page shows: a spec of two axes, its store where it has one, and how its depths are solved.

    stored     the header of the store; None where a spec is explored that has none
    ds         the plane of the store as a dataset
    layer      the number of that plane in a stack
    attractors from which initial states the spec seeks all attractors of a cell; None where it does not
    every      that plane with all attractors of its cells, where the store has them; ``ds`` has the motion from each
               cell's own initial state
    """

    spec: Spec
    settings: Settings
    stored: Header | None = None
    ds: "xr.Dataset | None" = None
    layer: int = 0
    attractors: Starts | None = None
    every: "xr.Dataset | None" = None

    @property
    def starts(self) -> Starts:
        """From which initial states all attractors of a cell are sought."""
        return STARTS if self.attractors is None else self.attractors

    @property
    def header(self) -> Header | None:
        """The header of a store that cells of this program can be kept in."""
        return self.stored if self.stored is not None and self.stored.solver_version == SOLVER_VERSION else None

    @property
    def system(self) -> System:
        """The system."""
        return self.spec.record

    @cached_property
    def x(self) -> Lattice:
        """The points of the horizontal axis."""
        return Lattice(self.spec.axes[0])

    @cached_property
    def y(self) -> Lattice:
        """The points of the vertical axis."""
        return Lattice(self.spec.axes[1])

    @cached_property
    def plane(self) -> Plane:
        """The plane of the spec itself."""
        return Plane.of(self.spec.parameters)

    @property
    def name(self) -> str:
        """What is explored, in a word."""
        return self.spec.system if self.stored is None else os.path.basename(str(self.stored.place).rstrip("/"))

    @property
    def same_settings(self) -> bool:
        """Whether cells of the atlas itself are what exploring would make of them."""
        asked = replace(self.spec.settings, section_samples=0)
        return self.header is not None and self.every is None and asked == self.settings

    def digest(self, plane: Plane) -> str:
        """The digest of a plane and of how it is explored: system, axes, fixed parameters, settings, solver."""
        axes = [[axis.name, axis.values] for axis in self.spec.axes]
        solve = {name: value for name, value in vars(self.settings).items()}
        rest = {"parameters": dict(plane.parameters), "axes": axes, "solve": solve, "solver": SOLVER_VERSION}
        return digest_of(identity(self.system.resolved()) | rest)

    def moved(self, plane: Plane, name: str, value: float) -> Plane:
        """The plane with another value of a parameter; InputError for what is no parameter or out of its range."""
        if name not in dict(plane.parameters):
            raise InputError(f"{name} is no parameter of this plane; possible: {', '.join(dict(plane.parameters))}")
        return plane.moved(name, admitted(self.system.parameter(name), value))

    def patch(self, plane: Plane, key: TileKey, known: np.ndarray | None = None) -> Patch:
        """What it takes to solve a tile, less the cells that are known."""
        (x, across), (y, up) = (
            (self.spec.axes[0].name, self.x.values(key.level_x, key.index_x())),
            (self.spec.axes[1].name, self.y.values(key.level_y, key.index_y())),
        )
        wanted = b"" if known is None else packed(~known)
        sides = (x, tuple(across.tolist())), (y, tuple(up.tolist()))
        return Patch(self.system, dict(plane.parameters), self.settings, *sides, wanted)

    def spec_of(self, plane: Plane, x: Any, y: Any, settings: Settings | None = None) -> Spec:
        """The spec of cells at these values of the axes."""
        names = (axis.name for axis in self.spec.axes)
        axes = {
            name: {"values": np.asarray(values), "scale": axis.scale}
            for name, axis, values in zip(names, self.spec.axes, (x, y), strict=True)
        }
        return Spec(self.system, axes, dict(plane.parameters), settings or self.settings)


def subject_of(given: str, chosen: Mapping[str, float] | None = None, tolerance: float = TOLERANCE) -> Subject:
    """The subject that a user names: a store, or else a spec by its file or its name.

    ``chosen`` picks the plane of a stack, by default the first. InputError for what has no plane to be explored.
    """
    place = None if given.endswith(".toml") else place_of(given)
    if place is not None and (place.exists("zarr.json") or is_url(given) or place.local is None):
        header = read_header(place)
        ds = open_atlas(given)
        return _subject(header.spec, header, ds, chosen or {}, tolerance)
    return _subject(Spec.from_toml(given), None, None, chosen or {}, tolerance)


def _subject(
    spec: Spec, header: Header | None, ds: "xr.Dataset | None", chosen: Mapping[str, float], tolerance: float
) -> Subject:
    if spec.points or len(spec.axes) < 2:
        what = "a table of points" if spec.points else f"one axis ({spec.axes[0].name})"
        raise InputError(f"explore shows a plane, found {what}")
    if spec.continuation is not None:
        raise InputError("a continued sweep cannot be explored: each cell of it depends on those before it")
    if spec.basins:
        raise InputError("explore shows one motion a cell, found basins; take [attractors] out of the spec")
    layer, settings, attractors = 0, exploring(spec.settings, tolerance), spec.attractors
    if len(spec.axes) == MOST_AXES:
        third = spec.axes[-1]
        value = chosen.get(third.name, third.values[0])
        if ds is not None:
            ds = select(ds, {third.name: value})
        if set(chosen) - {third.name} or value not in third.values:
            raise InputError(f"--select picks a plane of {third.name}: {', '.join(f'{v:g}' for v in third.values)}")
        layer = third.values.index(value)
        axes = {axis.name: axis for axis in spec.axes[:2]}
        spec = Spec(spec.record, axes, spec.parameters | {third.name: value}, spec.settings)
    elif chosen:
        raise InputError(f"--select picks a plane of a stack, found a plane of {', '.join(spec.dims)}")
    if attractors is None:
        return Subject(spec, settings, header, ds, layer)
    alone = Spec(spec.record, {axis.name: axis for axis in spec.axes}, spec.parameters, spec.settings)
    return Subject(alone, settings, header, None if ds is None else own(ds), layer, attractors, ds)
