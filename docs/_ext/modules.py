"""Tables of all modules, each with the first sentence of its docstring, in place of ``<!-- modules: FOLDER -->``.

Usage: python docs/_ext/modules.py [WORD...]     the modules whose lines have all these words
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("workers", "atlas", "scripts", "tests/support")
PLACE = re.compile(r"^<!-- modules: ([\w/]+) -->$", re.MULTILINE)


def sentence(file: Path) -> str:
    """The first sentence of a module's docstring, on one line."""
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return re.split(r"(?<=[.?])\s", " ".join(text.partition("\n\n")[0].split()))[0]


def packages(folder: str) -> Iterator[tuple[Path, list[Path]]]:
    """Each package of a folder with its modules, sorted by name; a package without modules of its own is left out."""
    files = sorted((ROOT / folder).rglob("*.py"))
    for package in sorted({file.parent for file in files}):
        modules = [file for file in files if file.parent == package and file.name != "__init__.py"]
        if modules:
            yield package, modules


def tables(folder: str) -> str:
    """The packages of a folder as sections in Markdown, each a table of its modules."""
    parts = []
    for package, modules in packages(folder):
        head = package / "__init__.py"
        rows = [f"| `{file.name}` | {escaped(sentence(file))} |" for file in modules]
        said = escaped(sentence(head)) if head.exists() else ""
        title = f"#### `{package.relative_to(ROOT)}/`"
        parts.append("\n".join([title, "", said, "", "| file | holds |", "|---|---|", *rows]))
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Text of a docstring as Markdown: code in single backticks, nothing else with a meaning."""
    return re.sub(r"``(.+?)``|([|*_$<>])", lambda found: f"`{found[1]}`" if found[1] else f"\\{found[2]}", text)


def main(words: list[str]) -> None:
    """Print the modules whose lines have all the words."""
    for folder in FOLDERS:
        for _, modules in packages(folder):
            for file in modules:
                line = f"{file.relative_to(ROOT)}  {sentence(file)}"
                if all(word.lower() in line.lower() for word in words):
                    print(line)


def fill(app: "Sphinx", name: str, source: list[str]) -> None:
    """What Sphinx calls with the text of each page before it is parsed."""
    source[0] = PLACE.sub(lambda place: tables(place[1]), source[0])


def setup(app: "Sphinx") -> dict[str, Any]:
    """Have Sphinx call it."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    main(sys.argv[1:])
