"""Classes of cells: by regime, by period of the orbit, or by impact pattern n-p-q."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.argument_checks import check_name
from atlas.errors import InputError, brief_repr, check_names
from atlas.formatting import motion_name
from atlas.query.cell_blocks import CellBlock
from atlas.query.motions import STICKS as ALL_STICKING
from atlas.query.motions import motion_keys
from workers.results import PENDING, PERIODIC, REGIME

if TYPE_CHECKING:
    import xarray as xr

_NEEDED = {REGIME.name: (), "period": ("period",), "impacts": ("period", "impacts_upper", "impacts_lower")}
BY = tuple(_NEEDED)
"""Results by which cells can be classified."""
STICKS = "sticks"
"""Impact pattern of all sticking motions, which have infinitely many impacts."""

_REGIMES = {regime.name: regime.code for regime in REGIME.codes if regime.code != PENDING}


def parse_class(by: str, value: object = None) -> tuple[str, object]:
    """Return the result that classifies cells, and the requested class; None for all classes.

    ``by`` is "regime", "period" or "impacts", or the name of a regime without a ``value``, which requests this regime.
    """
    check_name("by", by)
    if value is None and by in _REGIMES:
        return REGIME.name, by
    check_names("class of cells", [by], (*BY, *_REGIMES))
    return by, value


class CellClassifier:
    """Assigns classes to cells; classes are numbered from 1 in the order in which they occur. ``by`` is one of:

    regime   every regime but pending
    period   period of the orbit in forcing periods, for periodic cells
    impacts  ``n-p-q`` for periodic cells: an orbit of n forcing periods with p impacts at the upper stop and q at the
             lower; "sticks" for all sticking orbits

    ``value`` is the only requested class; None for all. Raise InputError for another ``by``, for a ``value`` that
    ``by`` cannot have, and if the atlas lacks the variables that are needed.
    """

    def __init__(self, ds: "xr.Dataset", by: str, value: object = None) -> None:
        check_names("class of cells", [by], BY)
        self.by, self.names = by, _NEEDED[by]
        for name in self.names:
            if name not in ds:
                raise InputError(f"by {by}: this atlas has no variable {name!r}")
        self._only = None if value is None else _key_of(by, value)
        self._numbers: dict[tuple[int, ...], int] = {}
        if by != REGIME.name:
            self.codes: tuple[int, ...] = (PERIODIC,)
        else:
            self.codes = tuple(_REGIMES.values()) if self._only is None else self._only

    def number(self, block: CellBlock) -> NDArray[np.int32]:
        """Return the class number of every cell of a block; 0 for cells without a class or of a class not requested."""
        counted = np.isin(block.regime, self.codes)
        numbers = np.zeros(block.regime.shape, np.int32)
        keys = self._keys(block, counted)
        if self._only is not None:
            meant = (keys == self._only).all(axis=1)
            counted[counted], keys = meant, keys[meant]
        if keys.size:
            distinct, which = _distinct(keys)
            known = [self._numbers.setdefault(key, len(self._numbers) + 1) for key in distinct]
            numbers[counted] = np.array(known, np.int32)[which]
        return numbers

    def list_classes(self) -> list[tuple[int, Any]]:
        """Return the classes that occur as (number, name), in order of code, period or pattern."""
        return [(number, self._value(key)) for key, number in sorted(self._numbers.items())]

    def _keys(self, block: CellBlock, counted: NDArray[np.bool_]) -> NDArray[np.int64]:
        if self.by == REGIME.name:
            return block.regime[counted].astype(np.int64)[:, None]
        if not counted.any():
            return np.zeros((0, len(self.names)), np.int64)
        values = [block.values[name][counted] for name in self.names]
        return motion_keys(*values) if self.by == "impacts" else np.stack(values, axis=1).astype(np.int64)

    def _value(self, key: tuple[int, ...]) -> Any:
        if self.by == REGIME.name:
            return REGIME.meaning(key[0]).name
        if self.by == "period":
            return key[0]
        return STICKS if key == ALL_STICKING else motion_name(*key)


def _distinct(keys: NDArray[np.int64]) -> tuple[list[tuple[int, ...]], NDArray[np.intp]]:
    """Return the distinct rows of ``keys``, and for each row the index of the distinct row that equals it."""
    if keys.shape[1] == 1:
        distinct, which = np.unique(keys[:, 0], return_inverse=True)
        return [(key,) for key in distinct.tolist()], which
    rows, which = np.unique(keys, axis=0, return_inverse=True)
    return [tuple(row) for row in rows.tolist()], which.reshape(-1)


def _key_of(by: str, value: object) -> tuple[int, ...]:
    """Return the numbers that identify the class which a user named by ``value``: a code, a period, or n, p and q."""
    if by == REGIME.name:
        check_names("regime", [value], _REGIMES)
        return (_REGIMES[str(value)],)
    parts: Sequence[object] = [value]
    if by == "impacts":
        if value == STICKS:
            return ALL_STICKING
        parts = value.split("-") if isinstance(value, str) else value if isinstance(value, tuple) else []
    try:
        key = tuple(int(str(part)) for part in parts)
    except ValueError:
        key = ()
    if len(key) != len(_NEEDED[by]) or key[0] < 1 or min(key) < 0:
        right = "a whole number, 1 or more" if by == "period" else "n-p-q, such as 3-2-2, or sticks"
        raise InputError(f"{by}: found {brief_repr(value)}, must be {right}")
    return key
