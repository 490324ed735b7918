"""Output of commands on stdout: one JSON object, or a table for people."""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import click
import numpy as np

from atlas.formatting import PrintableResult

_WIDE = 10_000
"""Width, in characters, of the lines of a table if stdout is no terminal; no table is wider."""


def to_json(value: Any) -> str:
    """Return the value, converted by ``plain``, as one line of JSON."""
    return json.dumps(plain(value), allow_nan=False)


def plain(value: Any) -> Any:
    """Convert a value to JSON's types: NaN to None, infinities to "inf" and "-inf", arrays and tuples to lists."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def emit(result: PrintableResult, as_json: bool) -> None:
    """Print a result as one JSON object, or as its text."""
    click.echo(to_json(result.as_dict()) if as_json else str(result))


def print_table(title: str, columns: list[str], rows: Iterable[tuple[str, ...]]) -> None:
    """Print a table on stdout, without spaces at the ends of lines; if stdout is no terminal, as wide as necessary."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    terminal = sys.stdout.isatty()  # a notebook asks for colours, but is no terminal
    console = Console(highlight=False, force_terminal=terminal, width=None if terminal else _WIDE)
    table = Table(title=title or None, title_justify="left", box=None, pad_edge=False, show_header=any(columns))
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*map(Text, row))
    with console.capture() as printed:
        console.print(table)
    click.echo("\n".join(line.rstrip() for line in printed.get().splitlines()), color=terminal)


def print_values(values: Mapping[str, Any], listed: str = "") -> None:
    """Print names and values as a table.

    If ``listed`` is the name of a value that is a list of attractors, the list is printed as a second table.
    """
    print_table("", ["", ""], [(name, text(value)) for name, value in values.items() if name != listed])
    several: Sequence[Mapping[str, Any]] = values.get(listed, [])
    if several:
        names = dict.fromkeys(name for one in several for name, value in one.items() if not isinstance(value, list))
        rows = [(name, *(text(one.get(name, "")) for one in several)) for name in names]
        print_table("attractors", ["", *map(str, range(len(several)))], rows)


def text(value: Any) -> str:
    """Return a single result as text for people: numbers to ten digits, yes and no, lists in brackets."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(text, value))}]"
    return str(value)
