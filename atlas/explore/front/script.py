"""The modules that both pages run, joined into one script, and the style sheet of their keys."""

import re
from importlib.resources import files

SHARED = ("numbers.mjs", "colors.mjs", "plane.mjs", "words.mjs", "key.mjs")
"""The modules of both pages, each after those that it takes something from."""


def program(package: str, *own: str) -> str:
    """The shared modules and those of a package as one script: what they export and import are names of its own."""
    modules = [files(__package__).joinpath(name) for name in SHARED] + [files(package).joinpath(name) for name in own]
    return "".join(_joined(each.read_text("utf-8")) for each in modules)


def looks() -> str:
    """The style sheet of the key of a map."""
    return files(__package__).joinpath("key.css").read_text("utf-8")


def _joined(module: str) -> str:
    return re.sub(r"^import .*?;\n|^export ", "", module, flags=re.MULTILINE | re.DOTALL)
