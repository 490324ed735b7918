"""The force of a definition: harmonics of commensurate frequencies, with sine and cosine parts."""

import math
from collections.abc import Collection, Iterable, Mapping
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from workers.model.expression import Expression, Row, evaluate_entries
from workers.model.oscillator import Array
from workers.model.parameter import OMEGA


class Harmonic(NamedTuple):
    """A harmonic of the force, with amplitudes and phase angles for each coordinate; an empty cosine is zero.

    force sin(order (omega t + tau) + phase) + cosine cos(order (omega t + tau) + phase)
    """

    order: Fraction
    force: Row
    phase: Row
    cosine: Row = ()


def turns_of(orders: Iterable[Fraction]) -> int:
    """Return the number of periods 2 pi / omega after which harmonics of these orders all repeat.

    The orders are multiples of 1 / turns.
    """
    return math.lcm(*(order.denominator for order in orders))


def amplitudes(
    harmonics: Collection[Harmonic], turns: int, highest: int, named: Mapping[str, Array], n: int
) -> tuple[Array, Array]:
    """Return the force (N, highest, n) of harmonics, as amplitudes of the sines and of the cosines.

    harmonics  the harmonics
    turns      periods 2 pi / omega in a period of the force
    highest    highest order, in multiples of 1 / turns; [k - 1] of the result has order k / turns
    named      values (N,) by name
    n          number of coordinates
    """
    sines, cosines = np.zeros((2, named[OMEGA].size, highest, n))
    for order, force, phase, cosine in harmonics:
        k, size, angle = int(order * turns) - 1, evaluate_entries(force, named), evaluate_entries(phase, named)
        sines[:, k] += size * np.cos(angle)
        cosines[:, k] += size * np.sin(angle)
        if cosine:
            size = evaluate_entries(cosine, named)
            sines[:, k] -= size * np.sin(angle)
            cosines[:, k] += size * np.cos(angle)
    return sines, cosines


def replace_first_harmonic(
    harmonics: tuple[Harmonic, ...], force: Row | None, cosine: Row | None
) -> tuple[Harmonic, ...]:
    """Return the harmonics with the given amplitudes for the first harmonic of order 1; None leaves them unchanged."""
    if force is None and cosine is None:
        return harmonics
    none = (Expression("0.0"),) * len(force or cosine or ())
    first = next((harmonic for harmonic in harmonics if harmonic.order == 1), Harmonic(Fraction(1), none, none))
    new = first._replace(
        force=first.force if force is None else force, cosine=first.cosine if cosine is None else cosine
    )
    return (new, *(harmonic for harmonic in harmonics if harmonic is not first))
