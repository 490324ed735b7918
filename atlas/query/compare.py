"""Comparison of two atlases with the same cells: exponents by their difference, regimes by a table of pairs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.plane import Plane
from atlas.query.queries import rate_of
from atlas.query.resample import read_view
from atlas.query.window import Window, axis_names, axis_values, cell_widths, columns, select_window, window_indices
from atlas.spec.points import POINT
from atlas.spec.system import stored_name, stored_system
from workers.model.system import identity
from workers.results import LARGEST, OF_MOTIONS, REGIME, REGIMES

if TYPE_CHECKING:
    import xarray as xr

_CELLS_PER_BLOCK = 1 << 22
"""Maximum number of cells that are read at a time."""
_FIRST = REGIMES[0].code


@dataclass(frozen=True)
class ComparisonStats:
    """The result of a comparison of two atlases, in numbers.

    cells     number of cells of each pair of regimes (first, second), indexed by ``_FIRST + index``
    same      fraction of the area with equal regimes, of the area that is pending in neither atlas; NaN without such
              area
    compared  number of cells whose exponents were compared
    mean      mean difference of the exponents; NaN without compared cells
    size      mean absolute difference; NaN without compared cells
    most      difference with the largest absolute value, and its cell by axis; None without compared cells
    """

    cells: NDArray[np.int64]
    same: float
    compared: int
    mean: float
    size: float
    most: tuple[float, dict[str, float]] | None


@dataclass(frozen=True)
class Comparison:
    """A comparison of two atlases, ``first`` and ``second``, with the same axes.

    differing  fixed parameters that differ, by name, with their values in both
    weights    widths of the cells along each dimension

    Cells are read when they are first needed.
    """

    first: "xr.Dataset"
    second: "xr.Dataset"
    differing: dict[str, tuple[float, float]]
    weights: tuple[NDArray[np.float64], ...]

    @classmethod
    def from_atlases(cls, one: "xr.Dataset", other: "xr.Dataset", window: Window | None = None) -> Self:
        """Return the comparison of two atlases in a window.

        Raise InputError, naming the difference, unless both have the same system and exactly the same axis values.
        Fixed parameters, settings and solver versions may differ.
        """
        _check_cells(one, other)
        slices = window_indices(one, window)
        weights = tuple(cell_widths(one, str(dim))[slices[str(dim)]] for dim in one[REGIME.name].dims)
        pairs = {name: (float(one[name]), float(other[name])) for name in differing_parameters([one, other])}
        return cls(select_window(one, window), select_window(other, window), pairs, weights)

    @property
    def has_exponents(self) -> bool:
        """True if both atlases have exponents."""
        return LARGEST.name in self.first and LARGEST.name in self.second

    def planes(self, pixels: tuple[int, int]) -> list[Plane]:
        """Return the cells of both atlases as planes with the same cells, for a picture of ``pixels`` (x, y).

        They are overviews, which are coarser, if both atlases have overviews of the same size, else all cells.
        """
        names = [LARGEST.name] if self.has_exponents else []
        read = [read_view(ds, names, pixels=pixels) for ds in (self.first, self.second)]
        if read[0][REGIME.name].shape != read[1][REGIME.name].shape:
            read = [read_view(ds, names) for ds in (self.first, self.second)]
        return [Plane.from_dataset(ds, names) for ds in read]

    @cached_property
    def difference(self) -> "xr.DataArray":
        """Return the largest exponent of the second atlas minus that of the first.

        The difference is NaN where an exponent or the class of the motion is unknown. Raise InputError if an atlas has
        no exponents.
        """
        import xarray

        if not self.has_exponents:
            raise InputError("one of the two atlases has no exponents to compare")
        one = self.first[LARGEST.name]
        values = np.concatenate([difference for _, _, _, difference in self._strips()])
        meaning = f"difference of the largest Lyapunov exponents {rate_of(one)}, there minus here"
        attrs = {"long_name": meaning, "units": LARGEST.units}
        coords = {str(dim): one[dim] for dim in one.dims}
        return xarray.DataArray(values, coords, one.dims, "difference", attrs)

    @cached_property
    def regimes(self) -> "xr.DataArray":
        """The number of cells of each pair of regimes that occurs, with dimensions ``first`` and ``second``."""
        import xarray

        cells = self.numbers.cells
        present = np.flatnonzero(cells.sum(axis=0) + cells.sum(axis=1))
        names = [REGIMES[k].name for k in present]
        attrs = {"long_name": "cells by their regimes in both atlases", "units": "1"}
        coords = {"first": names, "second": names}
        return xarray.DataArray(cells[np.ix_(present, present)], coords, ("first", "second"), "regimes", attrs)

    @cached_property
    def numbers(self) -> ComparisonStats:
        """The comparison in numbers, from a single pass over both atlases."""
        count = len(REGIMES)
        cells = np.zeros((count, count), np.int64)
        area = np.zeros((count, count))
        compared, total, size, most = 0, 0.0, 0.0, None
        rest = reduce(np.multiply.outer, self.weights[1:], np.ones(()))
        for first, regimes, other_regimes, difference in self._strips():
            pairs = (count * (regimes - _FIRST) + (other_regimes - _FIRST)).astype(np.intp)
            cells += np.bincount(pairs.ravel(), minlength=count**2).reshape(count, count)
            rows = self.weights[0][first : first + regimes.shape[0]]
            weight = np.multiply.outer(rows, rest).reshape(regimes.shape)
            area += np.bincount(pairs.ravel(), weight.ravel(), count**2).reshape(count, count)
            known = ~np.isnan(difference)
            if known.any():
                values = np.abs(difference[known])
                compared, total, size = (
                    compared + values.size,
                    total + float(difference[known].sum()),
                    size + values.sum(),
                )
                k = int(values.argmax())
                if most is None or values[k] > abs(most[0]):
                    at = np.argwhere(known)[k]
                    most = float(difference[known][k]), self._place(first, at.tolist())
        solved = area[1:, 1:]  # pending comes first
        return ComparisonStats(
            cells,
            float(np.trace(solved) / solved.sum()) if solved.sum() else float("nan"),
            compared,
            total / compared if compared else float("nan"),
            float(size) / compared if compared else float("nan"),
            most,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as the dict that ``atlas compare --json`` prints."""
        names, cells = self.regimes["first"].values.tolist(), self.regimes.values.tolist()
        numbers = self.numbers
        return {
            "parameters": {name: list(pair) for name, pair in self.differing.items()},
            "regimes": {regime: dict(zip(names, row, strict=True)) for regime, row in zip(names, cells, strict=True)},
            "same_share": numbers.same,
            "compared": numbers.compared,
            "mean": numbers.mean,
            "mean_abs": numbers.size,
            "largest": None if numbers.most is None else numbers.most[1] | {"difference": numbers.most[0]},
        }

    def __repr__(self) -> str:
        changed = ", ".join(
            f"{name} {value:g} and {other_value:g}" for name, (value, other_value) in self.differing.items()
        )
        cells = " x ".join(str(weight.size) for weight in reversed(self.weights))
        return f"<Comparison of two atlases of {cells} cells{f', {changed}' if changed else ''}>"

    def _strips(self) -> Iterator[tuple[int, NDArray[np.int8], NDArray[np.int8], NDArray[np.float64]]]:
        """Yield blocks of rows of cells, with the regimes in both atlases and the differences of the exponents.

        Each item is the index of the block's first row, and three arrays (rows, ...): the regimes in the first atlas,
        those in the second, and the exponents of the second minus those of the first.
        """
        regime = self.first[REGIME.name]
        chunk = (regime.encoding.get("chunks") or (1,))[0]
        rows = max(1, _CELLS_PER_BLOCK * regime.shape[0] // max(1, regime.size) // chunk) * chunk
        names = [LARGEST.name] if self.has_exponents else []
        for first in range(0, regime.shape[0], rows):
            part = {regime.dims[0]: slice(first, first + rows)}
            block, other_block = (
                read_view(ds.isel(part), names).transpose(*regime.dims, ...) for ds in (self.first, self.second)
            )  # fmt: skip
            codes = block[REGIME.name].values, other_block[REGIME.name].values
            if names:
                difference = differences(*codes, block[LARGEST.name].values, other_block[LARGEST.name].values)
            else:
                difference = np.full(codes[0].shape, np.nan)
            yield first, *codes, difference

    def _place(self, first: int, at: list[int]) -> dict[str, float]:
        index = dict(zip(self.first[REGIME.name].dims, [at[0] + first, *at[1:]], strict=True))
        coordinates = {name: float(axis_values(self.first, name)[index[name]]) for name in axis_names(self.first)}
        return coordinates | {name: float(axis_values(self.first, name)[index[POINT]]) for name in columns(self.first)}


def differing_parameters(atlases: Sequence["xr.Dataset"]) -> list[str]:
    """Return the names of the fixed parameters that all atlases have and that are not equal in all."""
    fixed = [str(n) for n in atlases[0].coords if all(n in ds.coords and ds[n].ndim == 0 for ds in atlases)]
    numbers = [n for n in fixed if atlases[0][n].dtype.kind in "iuf"]
    return [n for n in numbers if len({float(ds[n]) for ds in atlases}) > 1]


def differences(
    first: NDArray[np.int8], second: NDArray[np.int8], one: NDArray[np.float64], other: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the exponents of a second atlas minus those of a first, cell by cell.

    first, second   regimes of the cells in both atlases
    one, other      exponents of the cells in the first and in the second atlas

    The difference is NaN if a class of motion is unknown or an exponent is not finite.
    """
    known = np.isin(first, list(OF_MOTIONS)) & np.isin(second, list(OF_MOTIONS))
    known &= np.isfinite(one) & np.isfinite(other)
    return np.subtract(other, one, where=known, out=np.full(one.shape, np.nan))


def _check_cells(one: "xr.Dataset", other: "xr.Dataset") -> None:
    """Raise InputError, naming the difference, unless two atlases have the same system, cells and unit of exponents."""
    names, others = axis_names(one), axis_names(other)
    if names != others:
        raise InputError(f"the axes differ: {', '.join(names)} here, {', '.join(others)} there")
    systems = [stored_name(ds.attrs) for ds in (one, other)]
    if systems[0] != systems[1]:
        raise InputError(f"the systems differ: {systems[0]} here, {systems[1]} there")
    both_systems = [stored_system(ds.attrs) for ds in (one, other)]
    definitions = [identity(system.to_resolved()) for system in both_systems if system]
    if len(definitions) == 2 and definitions[0] != definitions[1]:
        raise InputError(f"the systems differ: both are called {systems[0]}, but their definitions differ")
    if columns(one) != columns(other):
        raise InputError(f"the columns differ: {', '.join(columns(one))} here, {', '.join(columns(other))} there")
    for name in (*names, *columns(one)):
        values, other_values = axis_values(one, name), axis_values(other, name)
        if values.size != other_values.size or values[0] != other_values[0] or values[-1] != other_values[-1]:
            ends = [f"{v.size} values from {v[0]:g} to {v[-1]:g}" for v in (values, other_values)]
            what = "column" if name in columns(one) else "axis"
            raise InputError(f"{what} {name} differs: {ends[0]} here, {ends[1]} there")
        if not np.array_equal(values, other_values):
            k = int(np.flatnonzero(values != other_values)[0])
            what = "column" if name in columns(one) else "axis"
            raise InputError(f"{what} {name} differs: value {k + 1} is {values[k]!s} here, {other_values[k]!s} there")
    if LARGEST.name in one and LARGEST.name in other:
        rates = [rate_of(ds[LARGEST.name]) for ds in (one, other)]
        if rates[0] != rates[1]:
            raise InputError(f"the exponents differ in their unit: {rates[0]} here, {rates[1]} there")


def check_same_axis(ds: "xr.Dataset", against: "xr.Dataset") -> None:
    """Raise InputError unless two sweeps, atlases over one axis, have the same points and equal fixed parameters."""
    (name,), others = axis_names(ds), axis_names(against)
    if others != (name,):
        raise InputError(f"the atlases have different axes: {name} and {', '.join(others)}")
    one, two = np.sort(ds[name].values), np.sort(against[name].values)
    if one.shape != two.shape or np.any(one != two):
        raise InputError(
            f"the atlases have different points on {name}: {one.size} from {one[0]:g} to {one[-1]:g}, "
            f"and {two.size} from {two[0]:g} to {two[-1]:g}"
        )
    for key in ds.coords:
        fixed = ds[key].ndim == 0 and ds[key].dtype.kind == "f" and key in against.coords
        if fixed and float(ds[key]) != float(against[key]):
            raise InputError(f"the atlases differ in {key}: {float(ds[key]):g} and {float(against[key]):g}")
