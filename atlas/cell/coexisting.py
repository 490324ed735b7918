"""The attractors of one cell as entries of a list."""

from collections.abc import Iterable, Mapping
from typing import Any

from workers.results import REASON, REGIME, in_words


def attractors_listed(cell: Mapping[str, Any], many: Iterable[str]) -> list[dict[str, Any]]:
    """The attractors of one cell, as entries of all their numbers, regime and reason by name; the largest share first.

    cell   its results by name; those named in ``many`` are arrays (keep, ...), states, spectra and sections among them
    There are none where no initial state is decided.
    """
    names = list(many)
    kept = min(int(cell["attractors"]), len(cell[REGIME.name]))
    return [attractor_in_words({name: cell[name][k].tolist() for name in names}) for k in range(kept)]


def attractor_in_words(values: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of one attractor: regime and reason in words, its shares, the rest."""
    first = ("share", "share_low", "share_high")
    ordered = {name: values[name] for name in first if name in values}
    rest = {name: value for name, value in values.items() if name not in (*first, REGIME.name, REASON.name)}
    return in_words(values) | ordered | rest
