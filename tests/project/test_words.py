"""The claim that pages and messages name things: no word in them stands for a noun that a reader has to find.

Each banned phrase has come up in a sentence that readers could not follow. A sentence with one is better with the noun,
the number or the verb in its place: "a worker is excluded", not "gets no more". A variable, a field or a function with
a banned name is better with the name of its content or of its work: ``tile``, not ``each``.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.paths import ROOT
from tests.project.test_docs import PAGES, prose

BANNED = (
    r"told", r"so many", r"(?:that|those) which", r"those that", r"each of (?:them|those)", r"whatever",
    r"(?-i:(?<!there )is none)", r"such a one", r"says? so", r"goes on", r"gets? no more", r"speaks? against",
    r"what (?:it|they) (?:was|were|did|does|found|finds?|shows?|raises?|decides?|draws?|says?|said)",
    r"as far as they are asked for", r"in the place of one that is there", r"with it (?:Numba|Zarr|Dask)",
    r"who (?:has|does|gets|asks) (?:them|it|one)", r"each in a few words", r"takes? .{1,30} for a transient",
    r"of them\b[^.;:|]*\bof them",
)  # fmt: skip
PHRASE = re.compile(rf"\b(?:{'|'.join(BANNED)})\b", re.IGNORECASE)
NAMES = {
    "asked", "beside", "chosen", "crew", "doing", "done", "each", "errand", "found", "held", "here", "hired", "joined",
    "kept", "labour", "lend", "lent", "looked", "lumped", "made", "moved", "own", "place", "receipt", "sheets", "shown",
    "sought", "taken", "there", "told", "took", "wanted", "way", "ways", "whole", "whose",
    "Crew", "Errand", "Kept", "Sight", "Touch", "Trip", "Wanted",
}  # fmt: skip
MODULES = [file for package in ("atlas", "workers") for file in sorted((ROOT / package).rglob("*.py"))]


def phrases_in(text: str) -> list[str]:
    """Each banned phrase of a text with the words around it."""
    flat = " ".join(text.split())
    return [flat[max(0, match.start() - 40) : match.end() + 40] for match in PHRASE.finditer(flat)]


def messages(file: Path) -> Iterator[str]:
    """The texts of a module that are no docstrings, each f-string as one text."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    plain = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            plain |= {id(part) for part in node.values}
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in plain:
            yield node.value


def test_a_phrase_is_found_across_lines_and_a_word_that_contains_it_is_not() -> None:
    assert phrases_in("This worker\ngets no more tiles.") == ["This worker gets no more tiles."]
    assert phrases_in("Some of them are chaotic, and of them few settle.")
    assert not phrases_in("An untold story of one of them. Two of them.")


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_a_page_has_no_banned_phrase(page: Path) -> None:
    assert phrases_in(re.sub(r"`[^`]*`", "", prose(page))) == []


def test_no_message_has_a_banned_phrase() -> None:
    hits = {
        str(file.relative_to(ROOT)): [hit for text in messages(file) for hit in phrases_in(text)] for file in MODULES
    }
    assert {file: lines for file, lines in hits.items() if lines} == {}


def named(file: Path) -> list[str]:
    """The names of variables, parameters, fields, functions and classes of a module, each with its line."""
    names = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.append(f"{node.id}:{node.lineno}")
        elif isinstance(node, ast.arg):
            names.append(f"{node.arg}:{node.lineno}")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.append(f"{node.name}:{node.lineno}")
    return names


def test_a_name_is_found_in_a_loop_a_parameter_a_field_and_a_function(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text("class A:\n    found: int\n\ndef told(moved):\n    for each in moved:\n        pass\n")
    assert sorted(named(module)) == ["A:1", "each:5", "found:2", "moved:4", "told:4"]


def test_no_variable_field_or_function_has_a_name_that_stands_for_a_noun() -> None:
    hits = {str(file.relative_to(ROOT)): [n for n in named(file) if n.split(":")[0] in NAMES] for file in MODULES}
    assert len(hits) > 100
    assert {file: names for file, names in hits.items() if names} == {}


def test_no_docstring_has_a_banned_phrase() -> None:
    hits = {}
    for file in MODULES:
        nodes = (node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Expr))
        texts = [n.value.value for n in nodes if isinstance(n.value, ast.Constant) and isinstance(n.value.value, str)]
        hits[str(file.relative_to(ROOT))] = [hit for text in texts for hit in phrases_in(text)]
    assert {file: lines for file, lines in hits.items() if lines} == {}
