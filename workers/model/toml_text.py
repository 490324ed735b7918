"""TOML files and texts from any source, bounded in size and depth, with errors in one line."""

import re
import tomllib
from pathlib import Path
from typing import Any

MAX_FILE = 1_000_000
"""Maximum size of a file, in bytes: far more than a spec or a system needs, and small beside the memory."""

_DEEP_KEY = re.compile(r"""^[ \t]*+(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""", re.MULTILINE)
"""Pattern of a dotted key with too many parts, since the time of tomllib grows as the square of their number."""


class TomlError(ValueError):
    """Error of a TOML file, in one line without the file's name."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise TomlError if it cannot be read or is not TOML."""
    try:
        if path.is_dir():
            raise TomlError("cannot be read: is a folder")
        if path.exists() and not path.is_file():  # a pipe could block its reader forever
            raise TomlError("cannot be read: not a regular file")
        with path.open("rb") as file:
            content = file.read(MAX_FILE + 1)
        if len(content) > MAX_FILE:
            raise TomlError(f"too large: more than {MAX_FILE} bytes")
        text = content.decode()
    except OSError as error:
        raise TomlError(f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise TomlError(f"not a TOML file: byte {error.start} is not UTF-8 text") from None
    if text.startswith("\ufeff"):
        raise TomlError("not a TOML file: it begins with a byte order mark; save it as UTF-8 without one")
    return parse_toml(text)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a text; raise TomlError if the text is not TOML."""
    if text.startswith("%%"):
        raise TomlError("not a TOML file: it begins with a line of a notebook; leave out the line with %%")
    try:
        if _DEEP_KEY.search(text):
            raise RecursionError
        return tomllib.loads(text)
    except RecursionError:
        raise TomlError("nested too deeply; a definition is tables in tables") from None
    except ValueError as error:  # from tomllib, and from numbers with too many digits
        raise TomlError(f"not a TOML file: {error}") from None
