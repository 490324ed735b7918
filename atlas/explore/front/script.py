"""The JavaScript modules of the explorer's page and of the static page, joined into one script each."""

import re
from collections.abc import Iterable, Iterator
from importlib.resources import files

SHARED = ("numbers.mjs", "colors.mjs", "words.mjs", "elements.mjs", "plane.mjs", "key.mjs", "look.mjs", "canvas.mjs")
"""The JavaScript modules of both pages, each after the modules that it imports."""


def program(package: str, *names: str) -> str:
    """Return the modules that both pages share and the modules ``names`` of a package as one script.

    In the script all exports are plain names.
    """
    return "".join(_joined(text) for text in (*_texts(__package__, SHARED), *_texts(package, names)))


def shared_css() -> str:
    """Return the style sheet of what both pages share."""
    return files(__package__).joinpath("page.css").read_text("utf-8")


def _texts(package: str, names: Iterable[str]) -> Iterator[str]:
    return (files(package).joinpath(name).read_text("utf-8") for name in names)


def _joined(module: str) -> str:
    return re.sub(r"^import .*?;\n|^export ", "", module, flags=re.MULTILINE | re.DOTALL)
