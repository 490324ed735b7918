"""The packaged examples of specs, as TOML text and by name."""

import os
from collections.abc import Mapping
from importlib import resources

from atlas.errors import InputError
from workers.model.parameter import unknown_name
from workers.model.system import System
from workers.model.toml_text import parse_toml


def example_names() -> list[str]:
    """Return the names of the packaged examples."""
    folder = resources.files("atlas").joinpath("examples")
    if not folder.is_dir():
        return []
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def example_text(name: str) -> str:
    """Return the packaged example of this name as TOML; raise InputError with the nearest name if there is none."""
    names = example_names()
    if name not in names:
        raise InputError(unknown_name("example", name, names))
    return resources.files("atlas").joinpath("examples", f"{name}.toml").read_text(encoding="utf-8")


def example_system(name: str) -> System | None:
    """Return the system that a packaged example defines in its own text; None if it uses a packaged system or is
    unknown.
    """
    table = parse_toml(example_text(name))["system"] if name in example_names() else None
    return System.from_mapping(table) if isinstance(table, Mapping) else None


def packaged_text(name: str) -> str:
    """Return the text of a packaged example that is named where a file is expected.

    Raise InputError if there is neither a file nor an example of this name.
    """
    if name.endswith(".toml") or "/" in name or os.sep in name:
        raise InputError("no such file")
    try:
        return example_text(name)
    except InputError as error:
        raise InputError(f"no such file, and {error}") from None
