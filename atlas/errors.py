"""What can go wrong for a reason that the user can remove."""

from collections.abc import Iterable

from workers.system import unknown_name


class InputError(ValueError):
    """Bad input, told in one line: what was found and what would do. The command answers it with exit code 2."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


class RunError(RuntimeError):
    """A run that had to stop although its input was good. The command answers it with exit code 1."""


class NetworkError(OSError):
    """A store at a URL that did not answer for as long as it was waited for, in one line."""


def check_names(kind: str, found: Iterable[object], known: Iterable[str]) -> None:
    """Raise InputError, naming the nearest known name, at the first that is not known."""
    names = list(known)
    for name in found:
        if name not in names:
            raise InputError(unknown_name(kind, str(name), names))
