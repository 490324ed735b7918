"""The mutations of one line stand in the code."""

from tests.script import script


def test_every_mutation_changes_a_text_that_stands_once_in_its_file() -> None:
    assert "0 stale" in script("mutations", "--list").splitlines()[-1]
