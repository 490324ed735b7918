"""The messages of the explorer's page as the browser opens them, and its addresses."""

import json
import zlib
from typing import Any

import numpy as np

from atlas.explore.chosen import Chosen, look_query, place_query
from atlas.explore.front.numbers import Packed, unpack
from atlas.explore.subject import Subject


def to_address(home: Subject, subject: Subject, chosen: Chosen) -> str:
    """The query of an address that asks for a choice."""
    return f"{place_query(home, subject, chosen)}&{look_query(chosen)}"


def opened(message: np.ndarray) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a message says of the cells in view, and their arrays (y, x)."""
    content = message.tobytes()
    body = 4 + int.from_bytes(content[:4], "little")
    about = json.loads(zlib.decompress(content[4:body]))
    arrays = {}
    for name, array in about["arrays"].items():
        begin = body + array["at"]
        arrays[name] = unpack(Packed(array["type"], content[begin : begin + array["size"]]), about["axes"][0]["count"])
    return about, arrays
