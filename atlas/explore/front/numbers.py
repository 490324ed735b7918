"""Packing arrays of cells into few bytes for a page, rounded only as far as a size limit requires.

``numbers.mjs`` unpacks them in the browser.
"""

import base64
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from atlas.render.coded_maps import CodedMap

MANTISSA = 52
"""Number of mantissa bits of a double."""
DIGITS = {24: 7, 17: 5, 14: 4, 10: 3}
"""Significant digits of a rounded float by the number of mantissa bits that are kept.

Rounding changes a value by at most half a unit of the last of these digits.
"""


@dataclass(frozen=True)
class PackedArray:
    """A packed array of cells, as bytes or as text.

    type   name of the array's type in numpy
    data   the deflated bytes
    bits   number of mantissa bits that are kept of a float; values are exact with MANTISSA
    """

    type: str
    data: bytes = field(repr=False)
    bits: int = MANTISSA

    @property
    def text(self) -> str:
        """The packed bytes in base64."""
        return base64.b64encode(self.data).decode()

    @property
    def length(self) -> int:
        """Number of characters of ``text``."""
        return 4 * -(-len(self.data) // 3)

    @property
    def digits(self) -> int | None:
        """Number of significant digits of all values; None if the values are exact."""
        return DIGITS.get(self.bits)


def pack(values: NDArray[np.generic], bits: int = MANTISSA) -> PackedArray:
    """Return an array (y, x) of cells, packed; floats are rounded to ``bits`` mantissa bits.

    The bits of a value are taken as a whole number. Each number is stored as its difference from the number in the row
    before, modulo the range of its type: neighbouring cells are alike, so the differences have few digits. Bytes of
    equal significance are stored together.
    """
    stored_values = round_mantissa(values, bits) if values.dtype.kind == "f" else values
    stored_values = stored_values.astype(np.uint8) if stored_values.dtype.kind == "b" else stored_values
    integers = np.ascontiguousarray(stored_values).view(f"u{stored_values.itemsize}")
    steps = np.concatenate([integers[:1], integers[1:] - integers[:-1]]).astype(f"<u{stored_values.itemsize}")
    planes = steps.view(np.uint8).reshape(-1, stored_values.itemsize).T
    return PackedArray(stored_values.dtype.name, zlib.compress(planes.tobytes(), 6), bits)


def add_codes(packed: dict[str, PackedArray], coded_map: CodedMap) -> str:
    """Add the colour codes of a map's cells to the packed arrays, and return their name there.

    If an equal array is there already, return its name instead.
    """
    codes = pack(coded_map.codes)
    name = next((name for name, known in packed.items() if known.data == codes.data), f"map-{coded_map.name}")
    packed.setdefault(name, codes)
    return name


def unpack(packed: PackedArray, width: int) -> NDArray[np.generic]:
    """Return the array (y, x), with ``width`` columns, of packed values, exactly as the browser reads it."""
    size = np.dtype(packed.type).itemsize
    planes = np.frombuffer(zlib.decompress(packed.data), np.uint8).reshape(size, -1)
    steps = planes.T.copy().view(f"<u{size}").reshape(-1, width).astype(f"u{size}")
    return np.add.accumulate(steps, axis=0, dtype=steps.dtype).view(packed.type)


def round_mantissa(values: NDArray[np.generic], bits: int) -> NDArray[np.float64]:
    """Return values rounded to ``bits`` mantissa bits, to nearest, ties to even.

    Infinite values and NaN stay, and so do values that rounding would make infinite.
    """
    exact = np.asarray(values, np.float64)
    if bits >= MANTISSA:
        return exact
    dropped = MANTISSA - bits
    integers = exact.view(np.int64)
    last = (integers >> dropped) & 1
    near = ((integers + ((1 << (dropped - 1)) - 1) + last) >> dropped << dropped).view(np.float64)
    return np.where(np.isfinite(exact) & np.isfinite(near), near, exact)


def pack_within(
    arrays: Mapping[str, Callable[[], NDArray[np.generic]]], limit: int, last: str, first: str
) -> tuple[dict[str, PackedArray], list[str]]:
    """Return packed arrays with at most ``limit`` characters of text together, if possible, and the names left out.

    arrays   functions that return the arrays, by name
    limit    maximum number of characters
    last     name of the array that loses digits last
    first    name of the array that loses digits first

    The arrays are exact if they fit. Otherwise floats lose digits step by step. Each step shortens an array among those
    with the most digits: ``first``, then the longest text, and ``last`` at the end. An array with no more digits to
    lose is left out.
    """
    packed = {name: pack(read()) for name, read in arrays.items()}
    left_out: list[str] = []

    def order(name: str) -> tuple[int, bool, bool, int]:
        return packed[name].bits, name != last, name == first, packed[name].length

    while sum(array.length for array in packed.values()) > limit:
        floats = [name for name, array in packed.items() if array.type == "float64"]
        if not floats:
            break
        name = max(floats, key=order)
        fewer = [bits for bits in DIGITS if bits < packed[name].bits]
        if fewer:
            packed[name] = pack(arrays[name](), max(fewer))
        else:
            left_out.append(name)
            del packed[name]
    return packed, left_out
