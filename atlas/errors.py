"""Exceptions of the package, and the form of their messages: one line of bounded length, without secrets."""

import re
import reprlib
from collections.abc import Iterable, Mapping

from workers.model.parameter import unknown_name

MAX_MESSAGE_LENGTH = 500
"""Maximum length of a message, in characters; the middle of a longer message is left out."""

REBUILD_COMMANDS = {
    "curves": "atlas find curves",
    "labels": "atlas attractors label",
    "stability": "atlas attractors measure",
}
"""Commands that rebuild a damaged group of a store, by the name of the group; ``atlas run`` rebuilds all other
groups.
"""

REPACK_HINT = "pack the atlas again"
"""Advice in messages about a damaged zip file."""

_short = reprlib.Repr()
_short.maxstring = _short.maxlong = _short.maxother = 60


class InputError(ValueError):
    """Bad input. The message is one line: what was found and what is valid. The command exits with code 2."""

    def __init__(self, message: str) -> None:
        super().__init__(to_one_line(message))


class RunError(RuntimeError):
    """A run that had to stop although its input was good. The command exits with code 1."""


class NetworkError(OSError):
    """A store at a URL did not respond within the time that the caller waits for it. The message is one line."""


class UnlistedError(OSError):
    """A server, such as a plain web server, cannot list its objects."""


_USER, _QUERY = re.compile(r"(\w://)[^/\s]*@"), re.compile(r"(\w://[^\s?]*\?)[^\s)]+")
"""Patterns in a URL for what may be secret: user and password, and the query, which may contain a signature."""


def without_secrets(text: str) -> str:
    """Return the text with ``***`` in place of users, passwords and queries of URLs."""
    return _QUERY.sub(r"\1***", _USER.sub(r"\1***@", text))


def to_one_line(message: str) -> str:
    """Return the message as one line of at most MAX_MESSAGE_LENGTH characters, without secrets of URLs.

    White space becomes single blanks. The middle of a longer message is left out.
    """
    line = without_secrets(" ".join(message.split()))
    if len(line) <= MAX_MESSAGE_LENGTH:
        return line
    half = (MAX_MESSAGE_LENGTH - 5) // 2
    return f"{line[:half]} ... {line[-half:]}"


def brief_repr(value: object) -> str:
    """Return the repr of a value, shortened so that a message with the value stays readable."""
    try:
        return _short.repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        return "a whole number of thousands of digits"


class ChunkError(RunError):
    """Chunks of a store are missing or damaged. ``faults`` describes the damage by chunk key."""

    def __init__(self, store: object, faults: Mapping[str, str]) -> None:
        super().__init__(store, faults)  # both, so that it can be pickled
        self.store, self.faults = str(store), dict(faults)

    @property
    def lines(self) -> list[str]:
        """One line for each damaged chunk: its key and the damage."""
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
    """Return the message of an error of another library, as one line."""
    return " ".join(str(error).split()) or type(error).__name__


def check_names(kind: str, names: Iterable[object], valid: Iterable[str]) -> None:
    """Raise InputError at the first of ``names`` that is not in ``valid``; the message has the nearest valid name.

    ``kind`` says in the message what the names are, such as "axis".
    """
    valid_names = list(valid)
    for name in names:
        if not isinstance(name, str) or name not in valid_names:
            raise InputError(unknown_name(kind, name if isinstance(name, str) else brief_repr(name), valid_names))
