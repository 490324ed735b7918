"""Arrays of cells as deflated bytes, rounded only as far as a limit of size asks; ``numbers.mjs`` reads them back."""

import base64
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from atlas.render.coded_maps import CodedMap

MANTISSA = 52
"""Bits of a double's mantissa."""
DIGITS = {24: 7, 17: 5, 14: 4, 10: 3}
"""Bits of the mantissa that are kept, and the significant digits that they hold: rounding changes a value by at most
half a unit of the last of these.
"""


@dataclass(frozen=True)
class PackedArray:
    """An array as bytes, or as text.

    type     the name of its type in numpy
    bits     of the mantissa that are kept of a float; the values are exact with MANTISSA
    """

    type: str
    data: bytes = field(repr=False)
    bits: int = MANTISSA

    @property
    def text(self) -> str:
        """The bytes in base64."""
        return base64.b64encode(self.data).decode()

    @property
    def length(self) -> int:
        """How many characters that is."""
        return 4 * -(-len(self.data) // 3)

    @property
    def digits(self) -> int | None:
        """The significant digits that all values have; None where they are exact."""
        return DIGITS.get(self.bits)


def pack(values: NDArray[np.generic], bits: int = MANTISSA) -> PackedArray:
    """An array (y, x), packed; of floats the first ``bits`` bits of the mantissa.

    Its bits count as whole numbers, of which each is stored as its difference from the one below in y, modulo the
    range of its type: neighbouring cells are alike, and their differences have few digits. Bytes of equal significance
    stand together.
    """
    kept = round_mantissa(values, bits) if values.dtype.kind == "f" else values
    kept = kept.astype(np.uint8) if kept.dtype.kind == "b" else kept
    whole = np.ascontiguousarray(kept).view(f"u{kept.itemsize}")
    steps = np.concatenate([whole[:1], whole[1:] - whole[:-1]]).astype(f"<u{kept.itemsize}")
    planes = steps.view(np.uint8).reshape(-1, kept.itemsize).T
    return PackedArray(kept.dtype.name, zlib.compress(planes.tobytes(), 6), bits)


def add_codes(packed: dict[str, PackedArray], made: CodedMap) -> str:
    """Add the codes of a map to arrays, and return their name there: that of an equal array where there is one."""
    codes = pack(made.codes)
    name = next((name for name, known in packed.items() if known.data == codes.data), f"map-{made.name}")
    packed.setdefault(name, codes)
    return name


def unpack(packed: PackedArray, width: int) -> NDArray[np.generic]:
    """The array (y, x) of this many columns that is packed, as the page reads it."""
    size = np.dtype(packed.type).itemsize
    planes = np.frombuffer(zlib.decompress(packed.data), np.uint8).reshape(size, -1)
    steps = planes.T.copy().view(f"<u{size}").reshape(-1, width).astype(f"u{size}")
    return np.add.accumulate(steps, axis=0, dtype=steps.dtype).view(packed.type)


def round_mantissa(values: NDArray[np.generic], bits: int) -> NDArray[np.float64]:
    """Values to ``bits`` bits of the mantissa, the nearest, ties to even; values that are not finite stay."""
    exact = np.asarray(values, np.float64)
    if bits >= MANTISSA:
        return exact
    dropped = MANTISSA - bits
    whole = exact.view(np.int64)
    last = (whole >> dropped) & 1
    near = ((whole + ((1 << (dropped - 1)) - 1) + last) >> dropped << dropped).view(np.float64)
    return np.where(np.isfinite(exact) & np.isfinite(near), near, exact)


def pack_within(
    arrays: Mapping[str, Callable[[], NDArray[np.generic]]], limit: int, last: str, first: str
) -> tuple[dict[str, PackedArray], list[str]]:
    """Arrays, packed, of at most ``limit`` characters as texts where that can be, and the names of those left out.

    They are exact where they fit. Otherwise floats lose digits, one after the other, always one with the
    most digits: the one named ``first``, then the largest text, ``last`` the last. Those are left out that have no more
    digits to lose.
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
