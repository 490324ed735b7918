"""What is refused, and how: in one line that says what was found and what would be right."""

from collections.abc import Mapping
from typing import Any

import pytest

from workers import System
from workers.model.entries import DefinitionError


def refuse(definition: Mapping[str, Any], line: str, *, begins: bool = False) -> None:
    """Hold that a definition is refused in a short line with this part, or one that begins with it."""
    with pytest.raises(DefinitionError) as caught:
        System.from_mapping(definition)
    found = str(caught.value)
    assert found.startswith(line) if begins else line in found, found
    assert "\n" not in found and len(found) < 250, found
