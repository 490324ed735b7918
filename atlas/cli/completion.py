"""Completion by the Tab key: systems, kinds, variables, parameters, axes, classes, files.

``eval "$(_ATLAS_COMPLETE=bash_source atlas)"`` switches it on; zsh_source and fish_source are for these shells. Names
that cannot be known, such as the axes of a store that does not open, are left out without an error.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from atlas.spec.spec import Spec

Completed = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
Names = Callable[[click.Context], Iterable[str]]


def of_names(names: Names, files: bool = False) -> Completed:
    """Return a completion by the names that begin with the word; ``files`` adds files."""

    def complete(ctx: click.Context, parameter: click.Parameter, word: str) -> list[CompletionItem]:
        try:
            items = [CompletionItem(name) for name in names(ctx) if name.startswith(word)]
        except Exception:  # a command line that is still being typed may have any error
            items = []
        return [*items, CompletionItem(word, type="file")] if files else items

    return complete


def systems(ctx: click.Context) -> Iterable[str]:
    """Return the packaged systems."""
    from workers.model.system import system_names

    return system_names()


def examples(ctx: click.Context) -> Iterable[str]:
    """Return the packaged examples."""
    from atlas.spec.examples import example_names

    return example_names()


def parameters(ctx: click.Context) -> Iterable[str]:
    """Return the parameters of the system on the command line, with an equals sign."""
    from atlas.spec.system import parse_system
    from workers.model.system import DEFAULT

    return [f"{parameter.name}=" for parameter in parse_system(ctx.params.get("system") or DEFAULT).parameters]


def axes(ctx: click.Context) -> Iterable[str]:
    """Return the axes of the store on the command line, with an equals sign."""
    return [f"{axis.name}=" for axis in _spec(ctx).axes]


def names_along(ctx: click.Context) -> Iterable[str]:
    """Return the parameters of the store's system; without a store, of the system on the command line."""
    if _store(ctx) is None:
        return [name.removesuffix("=") for name in parameters(ctx)]
    return [parameter.name for parameter in _spec(ctx).system_def.parameters]


def variables(ctx: click.Context) -> Iterable[str]:
    """Return the results of the store's cells."""
    return [variable.name for variable in _spec(ctx).variables]


def kinds(ctx: click.Context) -> Iterable[str]:
    """Return the kinds of pictures."""
    from atlas.render.kinds import KIND_MEANINGS

    return KIND_MEANINGS


def curves(ctx: click.Context) -> Iterable[str]:
    """Return the kinds of curves."""
    from atlas.render.kinds import CURVES

    return ["all", *CURVES]


def classes(ctx: click.Context) -> Iterable[str]:
    """Return the classifications of cells, and the regimes."""
    from atlas.query.classes import BY
    from workers.results import REGIMES

    return [*BY, *(regime.name for regime in REGIMES)]


def nothing(ctx: click.Context) -> Iterable[str]:
    """Return no names, for arguments that are files."""
    return ()


def _store(ctx: click.Context) -> str | None:
    """Return the first store on the command line."""
    given = ctx.params.get("store") or ctx.params.get("stores") or ctx.params.get("subject")
    # After an option without its value click has not yet assigned the arguments.
    return ctx.args[0] if ctx.args else given[0] if isinstance(given, tuple) else given


def _spec(ctx: click.Context) -> "Spec":
    """Return the spec of the first store on the command line."""
    from atlas.spec.spec import Spec
    from atlas.store.store import open_store

    store = str(_store(ctx))
    if Path(store).suffix == ".toml":
        return Spec.from_toml(store)
    return open_store(store).spec
