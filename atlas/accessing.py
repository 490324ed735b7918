"""Register the accessor ``ds.atlas`` of xarray datasets as soon as both ``atlas`` and xarray are imported.

Loading xarray takes a while, so ``import atlas`` does not load xarray. If xarray is imported later, an import hook
registers the accessor then.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

ENGINE = "atlas.xarray_engine"
"""Name of the module that registers the accessor when it is imported."""


def register_accessor() -> None:
    """Register the accessor ``atlas`` of datasets, now or once xarray is imported."""
    if "xarray" in sys.modules:
        import_module(ENGINE)
    else:
        sys.meta_path.insert(0, _AfterXarray())


class _AfterXarray(MetaPathFinder):
    """Import hook that finds xarray by the other finders and registers the accessor after the import."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the import spec of the module xarray, by which Python loads it; None for other modules. See
        ``importlib``.
        """
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
            import_module(ENGINE)

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec
