"""The store from which a new one takes over cells, and the cells that are solved again."""

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
class Allowance(Variable):
    """A variable that says how much of a setting each cell was given: after a retry, more than the spec says.

    Only stores that a retry made have it; there its fill value is the spec's setting.
    """

    setting: str = ""

    def of_spec(self, spec: Spec) -> int:
        """The amount of a cell that was not retried."""
        return int(getattr(spec.settings, self.setting))


def _allowance(name: str, what: str, setting: str) -> Allowance:
    return Allowance(name, "int32", 0, f"{what}; as in the spec unless retried", "1", sparse=True, setting=setting)


BUDGET = _allowance("budget", "forcing periods that the cell may cost", "max_periods")
SURVIVAL = _allowance("survival", "forcing periods for which chaos may be watched", "survival")
ALLOWANCES = (BUDGET, SURVIVAL)


def allowances_in(spec: Spec) -> tuple[Allowance, ...]:
    """The allowances, each with the spec's amount as its fill value."""
    return tuple(replace(each, fill=each.of_spec(spec)) for each in ALLOWANCES)


@dataclass(frozen=True)
class Retry:
    """Which cells are solved again: those of these ``regimes`` by name, with more of the settings that are not None."""

    regimes: tuple[str, ...]
    max_periods: int | None = None
    survival: int | None = None

    def given(self, allowance: Allowance) -> int:
        """What such a cell is given at least; 0 where the retry gives no more."""
        return int(getattr(self, allowance.setting) or 0)

    def selects(self, stored: Arrays) -> NDArray[np.bool_]:
        """The mask of the cells to solve again."""
        return np.isin(stored[REGIME.name], [each.code for each in REGIMES if each.name in self.regimes])


@dataclass(frozen=True)
class Origin:
    """The store that a new one takes cells over from, by its place and its run, and the cells of it to solve again.

    Without a ``retry`` the new store is an extension, which takes over all cells that were given what the spec says.
    """

    store: str
    run_id: str
    retry: Retry | None = None

    def attributes(self) -> dict[str, str]:
        """As attributes of the new store's root."""
        given = {} if self.retry is None else {"origin_retry": json.dumps(vars(self.retry))}
        return {"origin": self.store, "origin_run_id": self.run_id, **given}

    @classmethod
    def of_attributes(cls, attributes: Mapping[str, Any]) -> "Origin | None":
        """The inverse; None where there is no origin."""
        if "origin" not in attributes:
            return None
        fields = json.loads(attributes.get("origin_retry", "null"))
        retry = None if fields is None else Retry(**{**fields, "regimes": tuple(fields["regimes"])})
        return cls(attributes["origin"], attributes["origin_run_id"], retry)
