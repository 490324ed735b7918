"""The attractors of one cell as entries of a list."""

from collections.abc import Mapping
from typing import Any

from workers.results import REASON, REGIME, in_words


def attractor_in_words(values: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of one attractor: regime and reason in words, its shares, the rest."""
    first = ("share", "share_low", "share_high")
    ordered = {name: values[name] for name in first if name in values}
    rest = {name: value for name, value in values.items() if name not in (*first, REGIME.name, REASON.name)}
    return in_words(values) | ordered | rest
