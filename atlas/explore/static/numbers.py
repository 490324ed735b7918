"""Arrays of cells as text inside a page: deflated bytes in base64, rounded only as far as a limit of size asks.

``page.js`` reads them back.
"""

import base64
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MANTISSA = 52
"""Bits of a double's mantissa."""
DIGITS = {24: 7, 17: 5, 14: 4, 10: 3}
"""Bits of the mantissa that are kept, and the significant digits that they hold: rounding changes a value by at most
half a unit of the last of these.
"""


@dataclass(frozen=True)
class Packed:
    """An array as text.

    type     the name of its type in numpy
    bits     of the mantissa that are kept of a float; the values are exact with MANTISSA
    """

    type: str
    text: str = field(repr=False)
    bits: int = MANTISSA

    @property
    def digits(self) -> int | None:
        """The significant digits that all values have; None where they are exact."""
        return DIGITS.get(self.bits)


def pack(values: NDArray[np.generic], bits: int = MANTISSA) -> Packed:
    """An array as text; of floats the first ``bits`` bits of the mantissa.

    Bytes of equal significance stand together, each as its difference (exclusive or) from the one before: what
    neighbouring cells have in common becomes zeros.
    """
    kept = rounded(values, bits) if values.dtype.kind == "f" else values
    kept = kept.astype(np.uint8) if kept.dtype.kind == "b" else kept
    kept = np.ascontiguousarray(kept, kept.dtype.newbyteorder("<"))
    planes = kept.view(np.uint8).reshape(-1, kept.itemsize).T.copy()
    planes[:, 1:] ^= planes[:, :-1].copy()
    return Packed(kept.dtype.name, base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode(), bits)


def unpack(packed: Packed) -> NDArray[np.generic]:
    """The array (N,) that a text holds, as the page reads it."""
    kind = np.dtype(packed.type).newbyteorder("<")
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed.text)), np.uint8).reshape(kind.itemsize, -1)
    return np.bitwise_xor.accumulate(planes, axis=1).T.copy().view(kind)[:, 0]


def rounded(values: NDArray[np.generic], bits: int) -> NDArray[np.float64]:
    """Values to so many bits of the mantissa, the nearest, ties to even; what is not finite stays."""
    exact = np.asarray(values, np.float64)
    if bits >= MANTISSA:
        return exact
    dropped = MANTISSA - bits
    whole = exact.view(np.int64)
    last = (whole >> dropped) & 1
    near = ((whole + ((1 << (dropped - 1)) - 1) + last) >> dropped << dropped).view(np.float64)
    return np.where(np.isfinite(exact) & np.isfinite(near), near, exact)


def fit(
    arrays: Mapping[str, Callable[[], NDArray[np.generic]]], limit: int, last: tuple[str, ...] = ()
) -> tuple[dict[str, Packed], list[str]]:
    """Arrays as texts of at most ``limit`` characters together, and the names of those that are left out.

    They are exact where that fits. Otherwise the largest of the floats loses digits, again and again, and is left out
    where it has no more to lose. Those named ``last`` keep theirs until all others have as few as there are.
    """
    found = {name: pack(read()) for name, read in arrays.items()}
    left_out: list[str] = []
    while sum(len(each.text) for each in found.values()) > limit:
        name = _next(found, last)
        if name is None:
            break
        fewer = [bits for bits in DIGITS if bits < found[name].bits]
        if fewer:
            found[name] = pack(arrays[name](), max(fewer))
        else:
            del found[name]
            left_out.append(name)
    return found, left_out


def _next(found: Mapping[str, Packed], last: tuple[str, ...]) -> str | None:
    """The float that is to lose digits, or to be left out: the largest text of those that have most to lose."""
    floats = {name: each for name, each in found.items() if each.type == "float64"}
    least = min(DIGITS)
    for group in (
        [name for name, each in floats.items() if name not in last and each.bits > least],
        [name for name, each in floats.items() if name in last and each.bits > least],
        [name for name in floats if name not in last],
        [*floats],
    ):
        if group:
            return max(group, key=lambda name: len(floats[name].text))
    return None
