"""Solve stored cells again and compare the results: to the bit on the same kind of host, else within their errors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from atlas.spec.spec import Spec
from atlas.store.origin import ALLOWANCES
from atlas.task.solve_block import solve_independent
from workers.results import BEYOND_TABLE, CHAOTIC, LABEL, PERIODIC, REGIME, leading

ERRORS = 5.0
"""Maximum difference, in standard errors of both solutions, between the largest exponents of one cell on two hosts."""
ROUNDING = 1e-9
"""Additional difference that is admitted, relative to the exponents, or absolute if they are below 1."""


@dataclass(frozen=True)
class SampledCell:
    """A stored cell that is to be solved again.

    cell    index of the cell in the atlas
    tile    index of its tile
    stored  its results, as arrays over a block of one cell
    """

    cell: tuple[int, ...]
    tile: tuple[int, ...]
    stored: Mapping[str, np.ndarray]

    @property
    def regime(self) -> int:
        """The code of the stored regime."""
        return int(self.stored[REGIME.name].flat[0])


def solve_again(spec: Spec, sample: SampledCell) -> Mapping[str, np.ndarray]:
    """Solve a sampled cell again, and return its results in the shapes of the stored results."""
    block = tuple(slice(i, i + 1) for i in sample.cell)
    allowed = ALLOWANCES if spec.attractors is None else ()  # atlases of all attractors cannot be retried
    allowance_settings: dict[str, Any] = {
        allowance.setting: int(sample.stored[allowance.name].item()) for allowance in allowed
    }
    arrays = solve_independent(spec, spec.cell_params(block), replace(spec.settings, **allowance_settings))
    if spec.basins:  # attractors beyond the table get their labels once all cells are known
        beyond = arrays[LABEL.name] == BEYOND_TABLE
        arrays[LABEL.name] = np.where(beyond, sample.stored[LABEL.name], arrays[LABEL.name])
    return arrays


def find_bit_differences(stored: Mapping[str, np.ndarray], again: Mapping[str, np.ndarray]) -> str:
    """Compare stored results of a cell with the results of solving it again, bit by bit.

    Return a text about the differences; empty if there are none.
    """
    names = [name for name, values in again.items() if name in stored and stored[name].tobytes() != values.tobytes()]
    return _in_words(stored, again, names)


def find_differences_beyond_error(spec: Spec, stored: Mapping[str, np.ndarray], again: Mapping[str, np.ndarray]) -> str:
    """Compare stored results of a cell with the results of solving it again on another host, within their errors.

    Return a text about the differences; empty if there are none. The regimes must be the same, for an orbit also the
    period and whether it sticks. The largest exponents must agree within their errors. In an atlas of all attractors
    the first attractors are compared.
    """
    dims = stored["periods_used"].ndim
    stored, again = (leading(spec.variables, arrays, dims) for arrays in (stored, again))
    regime = stored[REGIME.name].item()
    names = [REGIME.name] if regime != again[REGIME.name].item() else []
    if regime == PERIODIC:
        names += [name for name in ("period", "sticks") if stored[name].item() != again[name].item()]
    if "largest" in again and not names and regime <= CHAOTIC:
        values = [(float(one["largest"].item()), float(one["error"].item())) for one in (stored, again)]
        (first, first_error), (second, second_error) = values
        room = ERRORS * (first_error + second_error) + ROUNDING * max(1.0, abs(first))
        if first != second and not abs(first - second) <= room:
            names.append("largest")
    return _in_words(stored, again, names)


def place_in(spec: Spec, cell: tuple[int, ...]) -> str:
    """Return the parameters of a cell as text: ``omega = 2.5, b = 0.1``; for a table of points also the row."""
    columns = [f"{name} = {values[cell[0]]!r}" for name, values in spec.points.items()]
    if columns:
        return f"point {cell[0]}: {', '.join(columns)}"
    pairs = zip(spec.axes, reversed(cell), strict=True)
    return ", ".join(f"{axis.name} = {axis.values[i]!r}" for axis, i in pairs)


def _in_words(stored: Mapping[str, np.ndarray], again: Mapping[str, np.ndarray], names: list[str]) -> str:
    parts = [f"{name} {_text(name, stored[name])}, solved again {_text(name, again[name])}" for name in names[:3]]
    return "; ".join(parts + ([f"and {len(names) - 3} more"] if len(names) > 3 else []))


def _text(name: str, values: Any) -> str:
    if name == REGIME.name:
        names = {known.code: known.name for known in REGIME.codes}
        return ", ".join(names.get(code, str(code)) for code in values.ravel().tolist())
    flat = values.ravel().tolist()
    texts = [f"{value!r}" if not isinstance(value, float) or math.isfinite(value) else f"{value}" for value in flat[:4]]
    return texts[0] if len(flat) == 1 else f"[{', '.join(texts)}{', ...' if len(flat) > 4 else ''}]"
