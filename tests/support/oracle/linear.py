"""Linear autonomous systems z' = B z by Taylor series, with a bound on the truncation error.

The terms are integers, multiples of one unit of the norm: Python's integers are exact and fast, and rounding is
2^-GUARD of the truncation error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpmath import mp

Number = Any  # an mpmath mpf, which has no public type
Row = dict[int, Number]

REACH = 4  # longest step times rate: longer steps need fewer terms per time, but lose digits
GUARD = 64  # bits of a term below the working precision


@dataclass(frozen=True)
class LinearSystem:
    """z' = B z with B by sparse rows, and a norm max_i weight_i |z_i| in which B stretches by at most ``rate``.

    ``scaled`` are the rows in coordinates weight_i z_i, as (column, entry): a multiple of rate / 2^bits.
    """

    rows: tuple[Row, ...]
    weights: tuple[Number, ...]
    rate: Number
    bits: int
    scaled: tuple[tuple[tuple[int, int], ...], ...]

    @classmethod
    def of(cls, rows: Sequence[Row], weights: Sequence[Number]) -> "LinearSystem":
        """The system with its rate, the operator norm of B."""
        rate = max(sum(abs(entry) * weights[i] / weights[j] for j, entry in row.items()) for i, row in enumerate(rows))
        bits = mp.prec + GUARD
        with mp.workprec(bits):
            scaled = tuple(
                tuple((j, integer(entry * weights[i] / weights[j] / rate, bits)) for j, entry in row.items())
                for i, row in enumerate(rows)
            )
        return cls(tuple(rows), tuple(weights), rate, bits, scaled)

    def derivative(self, z: Sequence[Number]) -> list[Number]:
        """B z."""
        return [mp.fdot((entry, z[j]) for j, entry in row.items()) for row in self.rows]

    def norm(self, z: Sequence[Number]) -> Number:
        """Weighted maximum norm."""
        return max(weight * abs(value) for weight, value in zip(self.weights, z, strict=True))

    def series(self, z: Sequence[Number], step: Number) -> "TaylorSeries":
        """Taylor series of the flow over one step, as a polynomial in u = t/step in [0, 1]."""
        bits = self.bits
        unit = mp.ldexp(1, mp.frexp(self.norm(z))[1] - bits)
        with mp.workprec(bits):
            term = [integer(weight * value / unit) for weight, value in zip(self.weights, z, strict=True)]
            stretch = integer(self.rate * step, bits)
        terms = [term]
        largest = max(map(abs, term))
        while True:
            order = len(terms)
            term = [sum(entry * term[j] for j, entry in row) * stretch // (order << 2 * bits) for row in self.scaled]
            terms.append(term)
            size = max(map(abs, term))
            largest = max(largest, size)
            ratio = stretch // (order + 1) + 1
            rest = (1 << bits) - ratio
            # Each later term is at most ratio times the previous one: a geometric series bounds the sum.
            if 2 * ratio < 1 << bits and size * ratio << (mp.prec - 1) <= rest * largest:
                left_out = unit * size * ratio / rest
                return TaylorSeries(
                    terms, bits, tuple(unit / weight for weight in self.weights), left_out, self.weights
                )


def integer(value: Number, bits: int = 0) -> int:
    """The integer nearest to value 2^bits."""
    return int(mp.nint(mp.ldexp(value, bits)))


@dataclass(frozen=True)
class TaylorSeries:
    """z(u), u in [0, 1]: terms as integers, ``units`` of their components.

    The truncation error is at most ``left_out`` in the norm of these ``weights``.
    """

    terms: list[list[int]]
    bits: int
    units: tuple[Number, ...]
    left_out: Number
    weights: tuple[Number, ...]

    def at(self, u: Number) -> list[Number]:
        """z(u), by Horner's rule."""
        result = self.terms[-1]
        whole = integer(u, self.bits)
        for term in reversed(self.terms[:-1]):
            result = [(value * whole >> self.bits) + lower for value, lower in zip(result, term, strict=True)]
        return [value * unit for value, unit in zip(result, self.units, strict=True)]

    def of(self, functional: Mapping[int, Number]) -> tuple[list[Number], Number]:
        """Coefficients of a linear functional of z(u), and the bound on its truncation error."""
        scaled = {i: f * self.units[i] for i, f in functional.items()}
        polynomial = [mp.fdot((f, term[i]) for i, f in scaled.items()) for term in self.terms]
        return polynomial, sum(abs(f) * self.left_out / self.weights[i] for i, f in functional.items())
