"""Solving some cells of finished tiles again: those that failed, or that a larger budget may decide."""

from dataclasses import dataclass, replace

import numpy as np

from atlas.errors import InputError, check_names
from atlas.spec.spec import Spec
from atlas.store.schema import BUDGET
from workers.results import FAILED, REGIME, REGIMES, UNDETERMINED
from workers.settings import MOST_PERIODS

RETRIABLE = {regime.name: regime.code for regime in REGIMES if regime.code in (UNDETERMINED, FAILED)}

NEEDED = (REGIME.name, BUDGET.name)
"""Of a stored tile, what ``Retry.selects`` looks at."""


@dataclass(frozen=True)
class Retry:
    """Which cells to solve again, ``Retry(("failed",))``, and the budget they get, None for the one they had.

    ``regimes`` are names, "failed" and "undetermined", or codes, which they become. InputError for an unknown name.
    """

    regimes: tuple[int | str, ...]
    max_periods: int | None = None

    def __post_init__(self) -> None:
        check_names("regime to retry", [each for each in self.regimes if isinstance(each, str)], RETRIABLE)
        codes = tuple(RETRIABLE[each] if isinstance(each, str) else each for each in self.regimes)
        object.__setattr__(self, "regimes", codes)

    def selects(self, stored: dict[str, np.ndarray]) -> np.ndarray:
        """Mask of the cells of a stored tile that are to be solved again.

        An undetermined cell comes out the same within the budget that it had, so it needs a larger one; so an
        interrupted retry resumes where it stopped.
        """
        regime, budget = stored[REGIME.name], stored[BUDGET.name]
        worth = (regime != UNDETERMINED) | (budget < (self.max_periods or 0))
        return np.isin(regime, self.regimes) & worth

    def budgets(self, stored: dict[str, np.ndarray]) -> np.ndarray:
        """Forcing periods that each cell may cost when it is solved again: never fewer than it had."""
        return np.maximum(stored[BUDGET.name], self.max_periods or 0)


def checked_retry(spec: Spec, names: str, max_periods: int | None) -> Retry:
    """The retry that a user asked for, as ``failed,undetermined``; InputError where it could not change a cell."""
    chosen = [name.strip() for name in names.split(",") if name.strip()]
    check_names("regime to retry", chosen, RETRIABLE)
    if not chosen:
        raise InputError(f"retry: found none, must be one or more of {', '.join(RETRIABLE)}")
    settings = spec.settings
    if max_periods is not None and settings.method == "fixed":
        raise InputError('max_periods: a spec with method = "fixed" has no budget to raise')
    if max_periods is not None and not settings.max_periods < max_periods <= MOST_PERIODS:
        bounds = f"must exceed the spec's {settings.max_periods} and be at most {MOST_PERIODS}"
        raise InputError(f"max_periods: found {max_periods}, {bounds}")
    if "undetermined" in chosen and max_periods is None:
        raise InputError(
            "retry: undetermined cells come out the same within the same budget; give --max-periods above "
            f"{settings.max_periods}"
        )
    return Retry(tuple(RETRIABLE[name] for name in chosen), max_periods)


def solve_again(
    spec: Spec, cells: dict[str, np.ndarray], stored: dict[str, np.ndarray], retry: Retry
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A stored tile with the selected cells solved again: its arrays, and the mask of those cells.

    ``cells`` holds the parameters of every cell of the tile, each in the tile's shape.
    """
    from workers.tile import solve_cells

    mask, budgets = retry.selects(stored), retry.budgets(stored)
    arrays = {name: values.copy() for name, values in stored.items()}
    for budget in np.unique(budgets[mask]).tolist():
        chosen = mask & (budgets == budget)
        solution = solve_cells(
            spec.system,
            {name: values[chosen] for name, values in cells.items()},
            replace(spec.settings, max_periods=budget),
        )
        for name, values in solution.arrays.items():
            arrays[name][chosen] = values
        arrays[BUDGET.name][chosen] = budget
    return arrays, mask
