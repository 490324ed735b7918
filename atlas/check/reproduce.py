"""Solving stored cells again and comparing: to the bit on the machine that solved them, else within errors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from atlas.spec.spec import Spec
from atlas.store.origin import ALLOWANCES
from atlas.task.solving import solve_apart
from workers.results import BEYOND_TABLE, CHAOTIC, LABEL, PERIODIC, REGIME, leading

ERRORS = 5.0
"""Largest difference of the largest exponents of two machines, in errors of both solutions."""
ROUNDING = 1e-9
"""What may lie between them besides, relative to them or absolutely where they are small."""


@dataclass(frozen=True)
class Sample:
    """A cell taken out of a stored tile: its index in the atlas, and its results, each of a one-cell block's shape."""

    cell: tuple[int, ...]
    tile: tuple[int, ...]
    stored: Mapping[str, np.ndarray]

    @property
    def regime(self) -> int:
        """The stored regime's code."""
        return int(self.stored[REGIME.name].flat[0])


def solve_again(spec: Spec, sample: Sample) -> Mapping[str, np.ndarray]:
    """The results of the cell as they come out now, in the stored ones' shapes."""
    block = tuple(slice(i, i + 1) for i in sample.cell)
    allowed = ALLOWANCES if spec.attractors is None else ()  # others cannot be retried
    given: dict[str, Any] = {each.setting: int(sample.stored[each.name].item()) for each in allowed}
    arrays = solve_apart(spec, spec.cell_params(block), replace(spec.settings, **given))
    if spec.basins:  # what lies beyond the table gets its label when all cells are known
        beyond = arrays[LABEL.name] == BEYOND_TABLE
        arrays[LABEL.name] = np.where(beyond, sample.stored[LABEL.name], arrays[LABEL.name])
    return arrays


def unequal(stored: Mapping[str, np.ndarray], again: Mapping[str, np.ndarray]) -> str:
    """How two solutions of a cell differ in any bit; empty where they do not."""
    names = [name for name, values in again.items() if name in stored and stored[name].tobytes() != values.tobytes()]
    return _in_words(stored, again, names)


def beyond_error(spec: Spec, stored: Mapping[str, np.ndarray], again: Mapping[str, np.ndarray]) -> str:
    """How two solutions of a cell by different machines differ by more than their errors allow; empty where not.

    The regime has to be the same, an orbit's period and symmetry too, and the largest exponent within the errors. Of
    all attractors that holds for the first.
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
    """A cell by its parameters: ``omega = 2.5, b = 0.1``; of a table by its row too."""
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
        names = {each.code: each.name for each in REGIME.codes}
        return ", ".join(names.get(code, str(code)) for code in values.ravel().tolist())
    flat = values.ravel().tolist()
    shown = [f"{value!r}" if not isinstance(value, float) or math.isfinite(value) else f"{value}" for value in flat[:4]]
    return shown[0] if len(flat) == 1 else f"[{', '.join(shown)}{', ...' if len(flat) > 4 else ''}]"
