"""The origin of a store: an older store whose cells it takes over, and a request for cells that are solved again."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.spec.spec import Spec
from workers.results import REGIME, REGIMES, Variable

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class BudgetVariable(Variable):
    """A variable with the budget of each cell: the limit, in forcing periods, of the work spent on the cell.

    The budget is a setting of the spec, unless a retry has raised it for some cells. Only stores made by a retry have
    the variable. Its fill value there is the setting of the spec.
    """

    setting: str = ""

    def from_spec(self, spec: Spec) -> int:
        """Return the budget of a cell that was not retried: the setting of the spec."""
        return int(getattr(spec.settings, self.setting))


def _allowance(name: str, meaning: str, setting: str) -> BudgetVariable:
    return BudgetVariable(
        name, "int32", 0, f"{meaning}; as in the spec unless retried", "1", sparse=True, setting=setting
    )


BUDGET = _allowance("budget", "forcing periods that the cell may cost", "max_periods")
SURVIVAL = _allowance("survival", "forcing periods for which chaos may be watched", "survival")
ALLOWANCES = (BUDGET, SURVIVAL)


def budget_variables(spec: Spec) -> tuple[BudgetVariable, ...]:
    """Return the variables of both budgets, ``budget`` and ``survival``, with the settings of the spec as fill
    values.
    """
    return tuple(replace(allowance, fill=allowance.from_spec(spec)) for allowance in ALLOWANCES)


@dataclass(frozen=True)
class RetryRequest:
    """A request to solve all cells of the named ``regimes`` again, with those other settings that are not None."""

    regimes: tuple[str, ...]
    max_periods: int | None = None
    survival: int | None = None

    def least_budget(self, allowance: BudgetVariable) -> int:
        """Return the budget, in forcing periods, that the retry gives to the selected cells; 0 if it does not raise
        it.
        """
        return int(getattr(self, allowance.setting) or 0)

    def selects(self, stored: Arrays) -> NDArray[np.bool_]:
        """Return the mask of the cells to solve again, from the stored results of cells."""
        return np.isin(stored[REGIME.name], [regime.code for regime in REGIMES if regime.name in self.regimes])


@dataclass(frozen=True)
class Origin:
    """The origin of a new store: the older store whose cells it takes over.

    store   name of the older store, see ``sibling_name``
    run_id  identifier of the run that created the older store
    retry   which cells are solved again; None for an extension, which takes over all cells that no retry has solved
    """

    store: str
    run_id: str
    retry: RetryRequest | None = None

    def attributes(self) -> dict[str, str]:
        """Return the attributes by which the new store's root records its origin."""
        retry_attribute = {} if self.retry is None else {"origin_retry": json.dumps(vars(self.retry))}
        return {"origin": self.store, "origin_run_id": self.run_id, **retry_attribute}

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> "Origin | None":
        """Return the origin that the attributes of a store's root record; None if the store has none."""
        if "origin" not in attributes:
            return None
        fields = json.loads(attributes.get("origin_retry", "null"))
        retry = None if fields is None else RetryRequest(**{**fields, "regimes": tuple(fields["regimes"])})
        return cls(attributes["origin"], attributes["origin_run_id"], retry)
