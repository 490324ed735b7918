"""``ds.atlas`` for every dataset of xarray as soon as ``atlas`` and xarray are imported.

xarray takes a while to load, which ``import atlas`` does not wait for: if it comes later, it gets the accessor then.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from atlas.accessor import AtlasAccessor


def register_accessor() -> None:
    """Give datasets the accessor ``atlas``, now or once xarray is imported."""
    if "xarray" in sys.modules:
        _register()
    else:
        sys.meta_path.insert(0, _AfterXarray())


class _AfterXarray(MetaPathFinder):
    """Finds xarray as others do, and registers the accessor after its import."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module's spec if it is xarray: see importlib."""
        if name != "xarray":
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        spec = next((known for finder in others if (known := finder.find_spec(name, path, target))), None)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            execute(module)
            if self in sys.meta_path:
                sys.meta_path.remove(self)
            _register()

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def _register() -> None:
    import xarray

    if not hasattr(xarray.Dataset, "atlas"):
        xarray.register_dataset_accessor("atlas")(_accessor)


def _accessor(ds: Any) -> "AtlasAccessor":
    """The accessor of a dataset, loaded at its first use."""
    from atlas.accessor import AtlasAccessor

    return AtlasAccessor(ds)
