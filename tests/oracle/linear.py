"""Linear autonomous systems z' = B z by Taylor series, with a bound on what the series leaves out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpmath import mp

Number = Any  # an mpmath mpf, which has no public type
Row = dict[int, Number]

REACH = 4  # a step is at most REACH / rate long: longer ones need fewer terms a unit of time, but lose digits


@dataclass(frozen=True)
class LinearSystem:
    """z' = B z with B by sparse rows, and a norm max_i weight_i |z_i| in which B stretches by at most ``rate``."""

    rows: tuple[Row, ...]
    weights: tuple[Number, ...]
    rate: Number

    @classmethod
    def of(cls, rows: Sequence[Row], weights: Sequence[Number]) -> "LinearSystem":
        """The system with its rate, the operator norm of B."""
        rate = max(sum(abs(entry) * weights[i] / weights[j] for j, entry in row.items()) for i, row in enumerate(rows))
        return cls(tuple(rows), tuple(weights), rate)

    def derivative(self, z: Sequence[Number]) -> list[Number]:
        """B z."""
        return [mp.fdot((entry, z[j]) for j, entry in row.items()) for row in self.rows]

    def norm(self, z: Sequence[Number]) -> Number:
        """Weighted maximum norm."""
        return max(weight * abs(value) for weight, value in zip(self.weights, z, strict=True))

    def series(self, z: Sequence[Number], step: Number) -> "Series":
        """Taylor series of the flow over one step, as a polynomial in u = t/step in [0, 1]."""
        coefficients = [list(z)]
        largest = self.norm(z)
        while True:
            order = len(coefficients)
            factor = step / order
            coefficients.append([factor * value for value in self.derivative(coefficients[-1])])
            size = self.norm(coefficients[-1])
            largest = max(largest, size)
            ratio = self.rate * step / (order + 1)
            # Each later term is at most ratio times the one before: a geometric series bounds them all.
            if ratio < 0.5 and size * ratio / (1 - ratio) <= mp.eps * largest:
                return Series(coefficients, tuple(size * ratio / (1 - ratio) / weight for weight in self.weights))


@dataclass(frozen=True)
class Series:
    """Coefficient vectors of z(u), u in [0, 1], and the bounds on each component's truncation error."""

    coefficients: list[list[Number]]
    remainder: tuple[Number, ...]

    def at(self, u: Number) -> list[Number]:
        """z(u), by Horner's rule."""
        result = list(self.coefficients[-1])
        for row in reversed(self.coefficients[:-1]):
            result = [value * u + lower for value, lower in zip(result, row, strict=True)]
        return result

    def of(self, functional: Mapping[int, Number]) -> tuple[list[Number], Number]:
        """Coefficients of a linear functional of z(u), and the bound on its truncation error."""
        polynomial = [mp.fdot((f, row[i]) for i, f in functional.items()) for row in self.coefficients]
        return polynomial, sum(abs(f) * self.remainder[i] for i, f in functional.items())
