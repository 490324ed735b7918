"""The connection of xarray to this package: the engine ``atlas`` and the accessor ``ds.atlas``.

The module is an entry point of ``xarray.backends``, and is loaded after xarray once ``atlas`` is imported, see
``accessing.py``. It loads nothing but xarray; functions of this package are loaded at their first use.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import xarray
from xarray.backends import BackendEntrypoint

if TYPE_CHECKING:
    from atlas.accessor import AtlasAccessor


class AtlasBackendEntrypoint(BackendEntrypoint):
    """The engine of ``xarray.open_dataset(store, engine="atlas")``, which opens a store in the way of
    ``atlas.open``.
    """

    description = "Open atlases of impacting machines, with every chunk of a finished tile checked"
    open_dataset_parameters = ("filename_or_obj", "drop_variables", "storage_options")

    def open_dataset(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        storage_options: Mapping[str, Any] | None = None,
    ) -> xarray.Dataset:
        """Return the atlas of a store as a dataset, without the variables in ``drop_variables``.

        Other arguments and errors are those of ``atlas.open``.
        """
        from atlas.query.open import open_atlas

        ds = open_atlas(filename_or_obj, storage_options=storage_options)
        names = [drop_variables] if isinstance(drop_variables, str) else drop_variables or []
        return ds.drop_vars(names, errors="ignore")


def _accessor(ds: Any) -> "AtlasAccessor":
    """Return the object that ``ds.atlas`` gives for a dataset."""
    from atlas.accessor import AtlasAccessor

    return AtlasAccessor(ds)


xarray.register_dataset_accessor("atlas")(_accessor)
