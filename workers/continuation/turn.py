"""What one turn of an orbit over its events shows, and what its equations are made of."""

from typing import Any, NamedTuple

from numpy.typing import NDArray

from workers.continuation.oscillator import Array

Table = NDArray[Any]
"""Real numbers, complex ones where z is."""


class Turn(NamedTuple):
    """What ``shooting.turns`` and ``legs.turns_of_modes`` find of N orbits: see there."""

    signals: Array
    states: Array
    residuals: Array
    tangents: Array
    shifts: Array
