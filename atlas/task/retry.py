"""Solving some cells of finished tiles again: failed cells, and cells that more forcing periods may decide."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from atlas.errors import InputError, check_names
from atlas.spec.spec import Spec
from atlas.store.schema import ALLOWANCES, BUDGET, SURVIVAL, Allowance
from workers.results import APERIODIC, CHAOTIC, FAILED, REGIME, REGIMES, UNDETERMINED
from workers.settings import MOST_PERIODS

DECIDED_BY = {UNDETERMINED: BUDGET, CHAOTIC: SURVIVAL, APERIODIC: SURVIVAL}
"""What cells of a regime need more of, for else they come out the same."""
RETRIABLE = {regime.name: regime.code for regime in REGIMES if regime.code in (*DECIDED_BY, FAILED)}

NEEDED = (REGIME.name, *(each.name for each in ALLOWANCES))
"""Of a stored tile, what ``Retry.selects`` looks at."""


@dataclass(frozen=True)
class Retry:
    """Which cells to solve again, ``Retry(("failed",))``, and with which settings; None keeps a setting.

    ``regimes`` are names, "failed" and "undetermined", or codes, which they become. InputError for an unknown name.

    >>> import atlas
    >>> atlas.Retry(("failed", "undetermined"), max_periods=100_000).regimes
    (6, 4)
    """

    regimes: tuple[int | str, ...]
    max_periods: int | None = None
    survival: int | None = None

    @property
    def raises(self) -> tuple[Allowance, ...]:
        """What the cells are given more of."""
        return tuple(each for each in ALLOWANCES if getattr(self, each.setting) is not None)

    def __post_init__(self) -> None:
        check_names("regime to retry", [each for each in self.regimes if isinstance(each, str)], RETRIABLE)
        codes = tuple(RETRIABLE[each] if isinstance(each, str) else each for each in self.regimes)
        object.__setattr__(self, "regimes", codes)

    def selects(self, stored: dict[str, np.ndarray]) -> np.ndarray:
        """Mask of the cells of a stored tile that are to be solved again.

        Only more of a setting changes a result: an undetermined cell needs a larger budget, a chaotic or aperiodic one
        a longer survival. So an interrupted retry resumes where it stopped.
        """
        regime = stored[REGIME.name]
        chosen = np.isin(regime, self.regimes)
        for code, needs in DECIDED_BY.items():
            chosen &= (regime != code) | (stored[needs.name] < self._given(needs))
        return chosen

    def allowances(self, stored: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What each cell is given when it is solved again, by variable: never less than it had."""
        return {each.name: np.maximum(stored[each.name], self._given(each)) for each in ALLOWANCES}

    def _given(self, allowance: Allowance) -> int:
        return int(getattr(self, allowance.setting) or 0)


def checked_retry(spec: Spec, names: str, max_periods: int | None = None, survival: int | None = None) -> Retry:
    """The retry that a user asked for, as ``failed,undetermined``; InputError if it could not change a cell."""
    chosen = [name.strip() for name in names.split(",") if name.strip()]
    check_names("regime to retry", chosen, RETRIABLE)
    if not chosen:
        raise InputError(f"retry: found none, must be one or more of {', '.join(RETRIABLE)}")
    retry = Retry(tuple(RETRIABLE[name] for name in chosen), max_periods, survival)
    for each in retry.raises:
        found, least = getattr(retry, each.setting), each.of_spec(spec)
        if spec.settings.method == "fixed":
            raise InputError(f'{each.setting}: a spec with method = "fixed" has no {each.name} to raise')
        if not least < found <= MOST_PERIODS:
            bounds = f"must exceed the spec's {least} and be at most {MOST_PERIODS}"
            raise InputError(f"{each.setting}: found {found}, {bounds}")
    for name in chosen:
        needs = DECIDED_BY.get(RETRIABLE[name])
        if needs is not None and needs not in retry.raises:
            option = f"--{needs.setting.replace('_', '-')}"
            raise InputError(
                f"retry: {name} cells come out the same within the same {needs.name}; give {option} above "
                f"{needs.of_spec(spec)}"
            )
    if survival is not None and not {CHAOTIC, APERIODIC} & {*retry.regimes}:
        raise InputError(f"survival: is for chaotic and aperiodic cells, found {','.join(chosen)}")
    return retry


def solve_again(
    spec: Spec, cells: dict[str, np.ndarray], stored: dict[str, np.ndarray], retry: Retry
) -> dict[str, np.ndarray]:
    """The arrays of stored cells, with the selected ones solved again.

    ``cells`` holds the parameters of every cell of the tile, each in the tile's shape. Cells are solved from their
    beginning, so that they have the bits of an atlas whose spec has these settings.
    """
    from workers.tile import solve_tile

    mask, allowances = retry.selects(stored), retry.allowances(stored)
    arrays = {name: values.copy() for name, values in stored.items()}
    given = np.stack([allowances[each.name] for each in ALLOWANCES], axis=-1)
    for amounts in np.unique(given[mask], axis=0).tolist():
        chosen = mask & (given == amounts).all(axis=-1)
        amount = dict(zip(ALLOWANCES, amounts, strict=True))
        settings: dict[str, Any] = {each.setting: n for each, n in amount.items()}
        params = {name: values[chosen] for name, values in cells.items()}
        for name, values in solve_tile(spec.record, params, replace(spec.settings, **settings)).items():
            arrays[name][chosen] = values
        for each, n in amount.items():
            arrays[each.name][chosen] = n
    return arrays
