"""Atlases of all attractors: one attractor of every cell as a dataset, and all of one cell as a list."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import validate_atlas
from atlas.errors import InputError
from atlas.query.open import handle_of, open_table
from atlas.store.groups import LABELS, group_attributes
from workers.results import ATTRACTOR, LABEL, PENDING, REASON, REGIME, in_words

if TYPE_CHECKING:
    import xarray as xr


def has_all_attractors(ds: "xr.Dataset") -> bool:
    """Whether a dataset has all attractors of its cells."""
    return ATTRACTOR in ds.dims


def select_dominant(ds: "xr.Dataset") -> "xr.Dataset":
    """The attractor with the largest share in every cell; a dataset of one attractor a cell is itself."""
    return select_attractor(ds, 0) if has_all_attractors(validate_atlas(ds)) else ds


def select_attractor(ds: "xr.Dataset", index: float) -> "xr.Dataset":
    """The attractor at that place in every cell, 0 for the one with the largest share.

    A cell with fewer is as without a result. InputError for a place that does not exist.
    """
    if not has_all_attractors(ds):
        raise InputError("attractor: this atlas has one attractor per cell; for all, its spec needs [attractors]")
    kept = ds.sizes[ATTRACTOR]
    if index not in range(kept):  # as no infinity and no NaN is
        raise InputError(f"attractor: found {index:g}, must be a whole number, 0 to {kept - 1}")
    made = ds.isel({ATTRACTOR: int(index)})
    made.encoding = dict(ds.encoding)
    return made.assign_attrs({ATTRACTOR: int(index)})


def own(ds: "xr.Dataset") -> "xr.Dataset":
    """Of a dataset of all attractors the one that each cell's own initial state reaches; which one is read at once.

    A cell whose attractor is not among those kept has the regime of a cell without a result.
    """
    place = ds["own_attractor"][...].load()  # not within ``ds``, which would keep them while a run goes on
    made = ds.drop_vars("own_attractor").isel({ATTRACTOR: place.clip(0)})
    made[REGIME.name] = made[REGIME.name].where(place >= 0, PENDING).astype(REGIME.dtype)
    made.encoding = dict(ds.encoding)
    return made


def branches(ds: "xr.Dataset") -> "xr.Dataset":
    """The branches of an atlas whose attractors are labelled, by their labels, as a dataset, read.

    InputError where they are not.
    """
    handle = handle_of(ds) if LABEL.name in ds else None
    if handle is None or group_attributes(handle, LABELS) is None:  # the labels of basins are its results
        raise InputError("the attractors of this atlas are not labelled; label them with atlas attractors label")
    return open_table(handle, LABELS).drop_vars(LABEL.name).load()


def list_attractors(cell: "xr.Dataset") -> list[dict[str, Any]]:
    """The attractors of one cell, read: see ``attractors_listed``."""
    many = [str(name) for name in cell.data_vars if ATTRACTOR in cell[name].dims]
    return attractors_listed({name: cell[name].values for name in ("attractors", *many)}, many)


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
