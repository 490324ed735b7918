"""What can go wrong for a reason that the user can remove."""

from collections.abc import Iterable, Mapping

from workers.system import unknown_name


class InputError(ValueError):
    """Bad input, told in one line: what was found and what would do. The command answers it with exit code 2."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


class RunError(RuntimeError):
    """A run that had to stop although its input was good. The command answers it with exit code 1."""


class ChunkError(RunError):
    """Chunks of a store that are missing or damaged: ``faults`` has what is wrong by the chunk's key."""

    def __init__(self, store: object, faults: Mapping[str, str]) -> None:
        super().__init__(store, faults)  # both, so that it can be pickled
        self.store, self.faults = str(store), dict(faults)

    def __str__(self) -> str:
        found = "; ".join(f"{key} {fault}" for key, fault in self.faults.items())
        return f"{self.store}: {found}: atlas verify --repair {self.store}, then run it again"


def one_line(error: Exception) -> str:
    """What an error of a library says, in one line."""
    return " ".join(str(error).split()) or type(error).__name__


def check_names(kind: str, found: Iterable[object], known: Iterable[str]) -> None:
    """Raise InputError, naming the nearest known name, at the first that is not known."""
    names = list(known)
    for name in found:
        if name not in names:
            raise InputError(unknown_name(kind, str(name), names))
