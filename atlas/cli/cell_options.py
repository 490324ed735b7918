"""The options by which a command gets one cell: a cell of a store, or its system, parameters and settings."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from atlas.cli.options import (
    PLACE,
    Numbers,
    open_selection,
    options_given,
    pairs_option,
    read_number,
    select_option,
    storage_option,
)
from atlas.errors import InputError
from atlas.spec.spec import SETTING_MEANINGS, observable_settings, parse_settings, validate_parameters
from atlas.spec.system import parse_system
from workers import Settings
from workers.attractors.initial_states import MAX_STARTS, AttractorSettings
from workers.model.system import DEFAULT, System
from workers.settings import VALID_WORDS

if TYPE_CHECKING:
    import xarray as xr

Cell: TypeAlias = tuple[System, Numbers, Settings]
"""A cell that is given by its parameters, see ``resolve_cell``."""
system_option = click.option(
    "--system",
    default=DEFAULT,
    show_default=True,
    type=PLACE,
    metavar="SYSTEM",
    help="A name, see: atlas systems; the path of a .toml file; or an example that describes its own system.",
)
starts_option = click.option(
    "--starts",
    type=click.IntRange(1, MAX_STARTS),
    default=AttractorSettings.count,
    show_default=True,
    help="Initial states from which all attractors are found.",
)
at_option = pairs_option(
    "--at", "NAME=VALUE", "With STORE: its cell nearest to a point; one value for each axis.", read_number, "point"
)
set_option = pairs_option(
    "--set", "NAME=VALUE", "A parameter that differs from its default.", read_number, "parameters"
)


def settings_options(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds an option for every field of Settings, except for those in ``without``."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        choices = {name: click.Choice(known) for name, known in VALID_WORDS.items()}
        for field in reversed([field for field in fields(Settings) if field.name not in without]):
            kinds = {int: click.INT, float: click.FLOAT, str: click.STRING}
            kind = choices.get(field.name) or kinds[type(field.default)]
            name = f"--{field.name.replace('_', '-')}"
            words = SETTING_MEANINGS[field.name]
            command = click.option(name, type=kind, default=field.default, show_default=True, help=words)(command)
        return command

    return decorate


def check_cell_options(store: str | None, settings: Iterable[str]) -> None:
    """Check the options of a command about one cell, which is a cell of ``store`` or given by its parameters.

    ``settings`` are the names of the command's options of settings. Raise InputError for an option that is meant for
    the other case.
    """
    wrong = {"point", "select"} if store is None else {"parameters", "system", *settings}
    for option in options_given(click.get_current_context()):
        if option.name in wrong and store is None:
            raise InputError(f"{option.opts[-1]} needs a STORE; to give parameters without a store use --set")
        if option.name in wrong:
            advice = "to choose a cell of a STORE use --at"
            raise InputError(f"{option.opts[-1]} is for a cell without a STORE; {advice}")


def resolve_cell(parameters: Numbers, system: str, solve: Mapping[str, Any]) -> Cell:
    """Return the system, the checked parameters and the settings of a cell from the values of command-line options."""
    settings, record = parse_settings(solve), parse_system(system)
    validate_parameters(record, parameters)
    return record, parameters, observable_settings(settings, record)


@dataclass(frozen=True)
class GivenCell:
    """The cell that a command is about: the cell of a ``store`` nearest to a ``point``, or one given by its parameters.

    store              path, URL or backend; None if the cell is given by its parameters
    point, select      values of --at and --select
    parameters, solve  values of --set, and of the options of the settings
    system             name, or path of a file
    """

    store: Any
    point: Numbers
    select: Numbers
    parameters: Numbers
    system: str
    solve: Mapping[str, Any]

    def resolve(self) -> Cell:
        """Return the system, the checked parameters and the settings of a cell that is given by its parameters."""
        return resolve_cell(self.parameters, self.system, self.solve)

    def open(self) -> "xr.Dataset":
        """Open the store, or the plane or line in it that --select chooses."""
        return open_selection(self.store, self.select)


def cell_options(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds --set, --system and an option for every setting, except for those in ``without``.

    The command receives them as ``cell``, see ``resolve_cell``.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @set_option
        @system_option
        @settings_options(*without)
        @wraps(command)
        def wrapper(parameters: Numbers, system: str, **arguments: Any) -> None:
            solve = {name: arguments.pop(name) for name in SETTING_MEANINGS if name not in without}
            command(cell=resolve_cell(parameters, system, solve), **arguments)

        return wrapper

    return decorate


def given_cell_options(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds the argument STORE, which may be left out, and the options of a cell.

    They are --at and --select for a cell of STORE, else those of ``cell_options``. The command receives a GivenCell.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @click.argument("store", required=False, type=PLACE)
        @storage_option
        @set_option
        @at_option
        @select_option
        @system_option
        @settings_options(*without)
        @wraps(command)
        def wrapper(
            store: Any, point: Numbers, select: Numbers, parameters: Numbers, system: str, **arguments: Any
        ) -> None:
            solve = {name: arguments.pop(name) for name in SETTING_MEANINGS if name not in without}
            check_cell_options(store, solve)
            command(cell=GivenCell(store, point, select, parameters, system, solve), **arguments)

        return wrapper

    return decorate
