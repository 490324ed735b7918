"""The test that a motion near a periodic orbit converges to the orbit.

One turn of the orbit takes a state h* + d to h* + J d + r, with h* on the orbit and r the deviation from the linear map
J. The multipliers of J are at most |mu| < 1, but its energy norm may exceed 1: a deviation may grow for some turns.
With every turn it shrinks in the norm

    |d|_P^2 = d.P d = sum_{k < K} |A^k d|^2,    A = J / q,    q = (1 + |mu|) / 2,    K a power of two with |A^K| <= 1,

for |A d|_P^2 = |d|_P^2 - |d|^2 + |A^K d|^2 <= |d|_P^2, so that |J d|_P <= q |d|_P.

The motion converges to the orbit if |r|_P < (1 - q) |d|_P, that is if r is less than half of the contraction 1 - |mu|.
This must hold in each turn until the motion is nearer in the energy norm and stays so by J alone, and in one more turn:
a single turn does not test r in the directions of J d.
"""

import math

import numpy as np
from numba import types

from workers.kernel.by_reference import by_value
from workers.kernel.cell_loops import energy_norm
from workers.kernel.external import FLOATS, external
from workers.kernel.jit import inline_always, kernel
from workers.kernel.linalg import identity
from workers.model.oscillator import COLUMN
from workers.orbit.map import squares

LOOKAHEAD_TURNS = 256
"""Number of turns of the linear map after which a deviation that has not grown back counts as one that never will."""

MAX_DOUBLINGS = 30
"""Maximum number of doublings of K. Larger K would take |mu| within 1e-9 of 1, where rounding decides."""


@inline_always
def deviation(h, fixed):
    """Return the difference h - fixed of two states (n, 2) of the decoupled equations of motion as a vector (2n,)."""
    d = np.empty(h.size)
    for k in range(h.size):
        d[k] = h[k // 2, k % 2] - fixed[k // 2, k % 2]
    return d


@kernel
def add_product(target, left, right):
    """Add the product of two square matrices to a third one, in place."""
    size = len(target)
    for i in range(size):
        for k in range(size):
            total = 0.0
            for j in range(size):
                total += left[i, j] * right[j, k]
            target[i, k] += total


@kernel
def shrinking_norm(blocks, J, contraction):
    """Return the matrix P (2n, 2n) of a norm sqrt(d.P d) in which J (2n, 2n) shrinks every deviation d.

    P is NaN if no such norm is found. ``blocks`` are constants of the decoupled equations of motion, in whose energy
    norm |d| is taken. ``contraction`` is 1 - |mu|, with mu the multiplier of J of largest modulus.

    For the sum over k < K see the head of this module. The sum to 2K is P + (A^K)' P A^K: all terms are squares, so
    there is no cancellation.
    """
    size = len(J)
    weight, A, P = np.empty(size), np.empty((size, size)), identity(size)
    for j in range(len(blocks)):
        weight[2 * j], weight[2 * j + 1] = math.sqrt(blocks[j, COLUMN.metric]), 1.0
    for i in range(size):
        for k in range(size):
            A[i, k] = J[i, k] * weight[i] / (weight[k] * (1.0 - 0.5 * contraction))
    for _ in range(MAX_DOUBLINGS):
        if squares(A) <= 1.0:
            break
        image, square = np.zeros((size, size)), np.zeros((size, size))
        add_product(image, P, A)
        add_product(P, A.T, image)
        add_product(square, A, A)
        A = square
    shrinks = squares(A) <= 1.0
    for i in range(size):
        for k in range(size):
            P[i, k] = P[i, k] * weight[i] * weight[k] if shrinks else np.nan
    return P


@inline_always
def squared(P, d):
    """Return the square d.P d of the length of a vector d in the norm of a matrix P."""
    total = 0.0
    for i in range(len(d)):
        for k in range(len(d)):
            total += d[i] * P[i, k] * d[k]
    return total


@external(FLOATS[2], FLOATS[2], types.float64, FLOATS[2], FLOATS[2], FLOATS[2], result=types.boolean)
def falls_into(P, J, contraction, fixed, h, image):
    """Return True if one turn of a motion, from state h to ``image``, passes the test of convergence to an orbit.

    The orbit passes through ``fixed`` = h*, with linear map J and contraction 1 - |mu|. The states (n, 2) are those of
    the decoupled equations. The test is |r|_P < contraction / 2 |d|_P with d = h - h*, r = image - h* - J d; P as
    returned by ``shrinking_norm``.
    """
    P, J, fixed, h, image = by_value(P), by_value(J), by_value(fixed), by_value(h), by_value(image)
    d, r = deviation(h, fixed), deviation(image, fixed)
    for i in range(len(J)):
        for k in range(len(J)):
            r[i] -= J[i, k] * d[k]
    return squared(P, r) < (0.5 * contraction) ** 2 * squared(P, d)


@external(FLOATS[2], FLOATS[2], FLOATS[2], FLOATS[2], FLOATS[2], types.float64, result=types.boolean)
def stays_nearer(blocks, P, J, fixed, h, begun):
    """Return True if a motion at state h (n, 2) is nearer to an orbit than ``begun``, and stays nearer.

    Future turns are those of the linear map J. Distances from the state ``fixed`` on the orbit are in the energy norm
    of ``blocks``, the decoupled equations of motion. The result is certain once the deviation is smaller in the norm of
    P, which never grows and is the larger of the two.
    """
    blocks, P, J = by_value(blocks), by_value(P), by_value(J)
    fixed, h = by_value(fixed), by_value(h)
    d = deviation(h, fixed)
    for _ in range(LOOKAHEAD_TURNS):
        if not energy_norm(blocks, d.reshape(h.shape)) < begun:
            return False
        if squared(P, d) < begun * begun:
            break
        image = np.zeros(len(d))
        for i in range(len(d)):
            for k in range(len(d)):
                image[i] += J[i, k] * d[k]
        d = image
    return True
