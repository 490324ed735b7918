"""Pictures as files: formats, and writing one with its provenance."""

from pathlib import Path
from typing import TYPE_CHECKING

from atlas.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from atlas.render.page import Page
    from atlas.render.provenance import Provenance

FORMATS = ("png", "svg", "pdf")
"""What a picture can be written as, chosen by the file's suffix."""


def check_path(path: str | Path) -> None:
    """InputError unless the suffix is that of a picture: to be asked before long work."""
    target_of(path)


def target_of(path: str | Path) -> tuple[Path, str]:
    """The file of a picture and its format; InputError for a suffix that is none."""
    target = Path(path)
    suffix = target.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        found = f"found {target.suffix!r}" if suffix else "found none"
        raise InputError(f"{target.name}: the suffix chooses the format, {found}; possible: .{', .'.join(FORMATS)}")
    return target, suffix


def save(drawn: "Figure", target: Path, suffix: str, provenance: "Provenance", page: "Page") -> None:
    """Write a figure with its provenance; InputError where that cannot be."""
    from atlas.render.provenance import metadata

    try:
        with page.context():
            drawn.savefig(target, format=suffix, metadata=metadata(provenance, suffix))
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
