"""Errors that a user can correct."""

import re
import reprlib
from collections.abc import Iterable, Mapping

from workers.model.parameter import unknown_name

MAX_MESSAGE_LENGTH = 500
"""Most characters of a message; the middle of a longer one is left out."""

REBUILD_COMMANDS = {
    "curves": "atlas find curves",
    "labels": "atlas attractors label",
    "stability": "atlas attractors measure",
}
"""The commands that make a damaged group of a store anew; a run makes all other groups."""

REPACK_HINT = "pack the atlas again"
"""The remedy for a damaged zip file."""

_short = reprlib.Repr()
_short.maxstring = _short.maxlong = _short.maxother = 60


class InputError(ValueError):
    """Bad input, in one line: what was found and what is valid. The command answers it with exit code 2."""

    def __init__(self, message: str) -> None:
        super().__init__(to_one_line(message))


class RunError(RuntimeError):
    """A run that had to stop although its input was good. The command answers it with exit code 1."""


class NetworkError(OSError):
    """A store at a URL that did not answer within the time it was given, in one line."""


class UnlistedError(OSError):
    """A server that does not list its objects, such as a plain web server."""


_USER, _QUERY = re.compile(r"(\w://)[^/\s]*@"), re.compile(r"(\w://[^\s?]*\?)[^\s)]+")
"""The user and the password of a URL; its query, in which a signature may be."""


def without_secrets(text: str) -> str:
    """The text with ``***`` in place of users, passwords and queries of URLs."""
    return _QUERY.sub(r"\1***", _USER.sub(r"\1***@", text))


def to_one_line(message: str) -> str:
    """The message on one line of bounded length: white space as single blanks, the middle left out where too long.

    Secrets of URLs are left out.
    """
    line = without_secrets(" ".join(message.split()))
    if len(line) <= MAX_MESSAGE_LENGTH:
        return line
    half = (MAX_MESSAGE_LENGTH - 5) // 2
    return f"{line[:half]} ... {line[-half:]}"


def brief_repr(value: object) -> str:
    """A value as Python writes it, shortened so that a message with it can be read."""
    try:
        return _short.repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        return "a whole number of thousands of digits"


class ChunkError(RunError):
    """Chunks of a store that are missing or damaged: ``faults`` describes the damage, by the keys of the chunks."""

    def __init__(self, store: object, faults: Mapping[str, str]) -> None:
        super().__init__(store, faults)  # both, so that it can be pickled
        self.store, self.faults = str(store), dict(faults)

    @property
    def lines(self) -> list[str]:
        """The damaged chunks, a line for each: its key and the damage."""
        return [f"{key} {fault}" for key, fault in self.faults.items()]

    def __str__(self) -> str:
        damage = "; ".join(self.lines)
        if self.store.lower().endswith(".zip"):
            return f"{self.store}: {damage}: {REPACK_HINT}"
        groups = {key.partition("/")[0] for key in self.faults}
        if len(groups) == 1 and groups <= REBUILD_COMMANDS.keys():
            return f"{self.store}: {damage}: {REBUILD_COMMANDS[groups.pop()]} {self.store} makes it anew"
        return f"{self.store}: {damage}: atlas verify --repair {self.store}, then run it again"


def message_of(error: Exception) -> str:
    """The message of a library's error, in one line."""
    return " ".join(str(error).split()) or type(error).__name__


def check_names(kind: str, given: Iterable[object], valid: Iterable[str]) -> None:
    """Raise InputError, naming the nearest known name, at the first that is not known."""
    names = list(valid)
    for name in given:
        if not isinstance(name, str) or name not in names:
            raise InputError(unknown_name(kind, name if isinstance(name, str) else brief_repr(name), names))
