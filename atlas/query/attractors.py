"""Datasets with all attractors of their cells: select one attractor of every cell, or list all of one cell."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.argument_checks import validate_atlas
from atlas.errors import InputError
from atlas.query.open import handle_of, open_table
from atlas.store.groups import LABELS, group_attributes
from workers.results import ATTRACTOR, LABEL, PENDING, REASON, REGIME, Variable, in_words

if TYPE_CHECKING:
    import xarray as xr


def has_all_attractors(ds: "xr.Dataset") -> bool:
    """Return True if a dataset has all attractors of its cells, along the dimension ``attractor``."""
    return ATTRACTOR in ds.dims


def select_dominant(ds: "xr.Dataset") -> "xr.Dataset":
    """Return the dataset with only one attractor in every cell, the attractor that most initial states reach.

    A dataset with one attractor per cell is returned unchanged.
    """
    return select_attractor(ds, 0) if has_all_attractors(validate_atlas(ds)) else ds


def select_attractor(ds: "xr.Dataset", index: float) -> "xr.Dataset":
    """Return the dataset with only the attractor of rank ``index`` in every cell.

    Rank 0 is the attractor that the largest share of the initial states reaches. Cells with fewer attractors have the
    regime of a cell without a result. Raise InputError if no cell can have an attractor of that rank.
    """
    if not has_all_attractors(ds):
        raise InputError("attractor: this atlas has one attractor per cell; for all, its spec needs [attractors]")
    n_ranks = ds.sizes[ATTRACTOR]
    if index not in range(n_ranks):  # False for infinities and NaN
        raise InputError(f"attractor: found {index:g}, must be a whole number, 0 to {n_ranks - 1}")
    selection = ds.isel({ATTRACTOR: int(index)})
    selection.encoding = dict(ds.encoding)
    return selection.assign_attrs({ATTRACTOR: int(index)})


def select_own(ds: "xr.Dataset") -> "xr.Dataset":
    """Return the dataset with only the attractor, in every cell, that the cell's own initial state reaches.

    The variable ``own_attractor`` is read at once. Cells whose own attractor was not stored have the regime of a cell
    without a result.
    """
    rank = ds["own_attractor"][...].load()  # a copy: ``ds`` must not cache it during a run
    selection = ds.drop_vars("own_attractor").isel({ATTRACTOR: rank.clip(0)})
    selection[REGIME.name] = selection[REGIME.name].where(rank >= 0, PENDING).astype(REGIME.dtype)
    selection.encoding = dict(ds.encoding)
    return selection


def branches(ds: "xr.Dataset") -> "xr.Dataset":
    """Return the table of the branches of orbits to which an atlas's attractors belong, by label, as a loaded dataset.

    Raise InputError if the attractors are not labelled.
    """
    handle = handle_of(ds) if LABEL.name in ds else None
    if handle is None or group_attributes(handle, LABELS) is None:  # the labels of basins are its results
        raise InputError("the attractors of this atlas are not labelled; label them with atlas attractors label")
    return open_table(handle, LABELS).drop_vars(LABEL.name).load()


def list_attractors(cell: "xr.Dataset") -> list[dict[str, Any]]:
    """Return the attractors of one cell as a list of dicts; see ``attractors_listed``.

    ``cell`` is a dataset of one cell.
    """
    many = [str(name) for name in cell.data_vars if ATTRACTOR in cell[name].dims]
    return attractors_listed({name: cell[name].values for name in ("attractors", *many)}, many)


def attractors_listed(cell: Mapping[str, Any], many: Iterable[str]) -> list[dict[str, Any]]:
    """Return the attractors of one cell as a list of dicts, the largest share first.

    cell  results of the cell by name
    many  names of the results that are arrays (keep, ...) over the attractors, such as states, spectra and sections

    Each dict has all values of an attractor by name, with regime and reason in words. The list is empty if no initial
    state is decided.
    """
    names = list(many)
    n_stored = min(int(cell["attractors"]), len(cell[REGIME.name]))
    return [attractor_in_words({name: cell[name][k].tolist() for name in names}) for k in range(n_stored)]


def attractors_solved(cell: Mapping[str, Any], variables: Iterable[Variable]) -> dict[str, Any]:
    """Return the results of a cell whose attractors were searched, with the list ``coexisting`` of the attractors.

    cell        results of the cell by name
    variables   variables of the results

    Without an attractor, the regime and the reason of the cell's own initial state are added, in words.
    """
    many = [variable.name for variable in variables if ATTRACTOR in variable.extra_dims]
    results = {name: np.asarray(values).tolist() for name, values in cell.items() if name not in many}
    listed = attractors_listed(cell, many)
    if not listed:
        results |= in_words({name: cell[name][0] for name in (REGIME.name, REASON.name)})
    return results | {"coexisting": listed}


def attractor_in_words(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of one attractor by name: regime and reason in words, then its shares, then all others."""
    first = ("share", "share_low", "share_high")
    ordered = {name: values[name] for name in first if name in values}
    rest = {name: value for name, value in values.items() if name not in (*first, REGIME.name, REASON.name)}
    return in_words(values) | ordered | rest
