"""The claim that pages and messages name things: no word in them stands for a noun that a reader has to find.

Each banned phrase has come up in a sentence that readers could not follow. A sentence with one is better with the noun,
the number or the verb in its place: "a worker is excluded", not "gets no more".
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.paths import ROOT
from tests.project.test_docs import PAGES, prose

BANNED = (
    r"told", r"so many", r"(?:that|those) which", r"those that", r"each of (?:them|those)", r"whatever", r"is none",
    r"such a one", r"says? so", r"goes on", r"gets? no more", r"speaks? against",
    r"what (?:it|they) (?:was|were|did|does|found|finds?|shows?|raises?|decides?|draws?|says?|said)",
    r"of them\b[^.;:|]*\bof them",
)  # fmt: skip
PHRASE = re.compile(rf"\b(?:{'|'.join(BANNED)})\b", re.IGNORECASE)
ROOMS = [file for package in ("atlas", "workers") for file in sorted((ROOT / package).rglob("*.py"))]


def found(text: str) -> list[str]:
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
    assert found("This worker\ngets no more tiles.") == ["This worker gets no more tiles."]
    assert found("Some of them are chaotic, and of them few settle.")
    assert not found("An untold story of one of them. Two of them.")


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_a_page_has_no_banned_phrase(page: Path) -> None:
    assert found(re.sub(r"`[^`]*`", "", prose(page))) == []


def test_no_message_has_a_banned_phrase() -> None:
    hits = {str(file.relative_to(ROOT)): [hit for text in messages(file) for hit in found(text)] for file in ROOMS}
    assert {file: lines for file, lines in hits.items() if lines} == {}
