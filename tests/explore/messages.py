"""The messages of the explorer's page as the browser opens them, and its addresses."""

import json
import zlib
from typing import Any
from urllib.parse import parse_qs

import numpy as np

from atlas.explore.front.numbers import PackedArray, unpack
from atlas.explore.subject import Subject
from atlas.explore.view_state import ViewState, from_address, place_query, style_query


def to_address(home: Subject, subject: Subject, chosen: ViewState) -> str:
    """The query of an address that asks for a choice."""
    return f"{place_query(home, subject, chosen)}&{style_query(chosen)}"


def styled(subject: Subject, chosen: ViewState, query: str) -> ViewState:
    """A view in the style that a query gives."""
    address = parse_qs(f"{place_query(subject, subject, chosen)}&{query}")
    return from_address(subject, {name: [text.encode() for text in texts] for name, texts in address.items()})


def opened(message: np.ndarray) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a message says of the cells in view, and their arrays (y, x)."""
    content = message.tobytes()
    body = 4 + int.from_bytes(content[:4], "little")
    about = json.loads(zlib.decompress(content[4:body]))
    arrays = {}
    for name, array in about["arrays"].items():
        begin = body + array["at"]
        arrays[name] = unpack(
            PackedArray(array["type"], content[begin : begin + array["size"]]), about["axes"][0]["count"]
        )
    return about, arrays
