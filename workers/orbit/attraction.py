"""Whether a motion near an orbit falls into it.

A turn takes h* + d to h* + J d + r, where r is what the linear map does not explain. The multipliers of J are at most
|mu| < 1, but its energy norm may exceed 1: a deviation may grow for some turns. With every turn it shrinks in the norm

    |d|_P^2 = d.P d = sum_{k < K} |A^k d|^2,    A = J / q,    q = (1 + |mu|) / 2,    K a power of two with |A^K| <= 1,

for |A d|_P^2 = |d|_P^2 - |d|^2 + |A^K d|^2 <= |d|_P^2, so that |J d|_P <= q |d|_P. The motion falls into the orbit
where |r|_P < (1 - q) |d|_P, what is not explained is less than half of the contraction 1 - |mu|, in each turn until it
has come nearer, in the energy norm, and by J alone stays so, and in one more: a single turn says nothing of r in the
directions into which J takes d.
"""

import math

import numpy as np

from workers.kernel.jit import inline_always, kernel

LOOK_AHEAD = 256
"""Turns of the linear map after which a deviation that has not grown back is taken not to."""

MOST_DOUBLINGS = 30
"""Of K. More would take |mu| within 1e-9 of 1, where rounding decides."""


@inline_always
def weight(metric, k):
    """What the energy norm multiplies coordinate k of a block state (2n,) by."""
    return math.sqrt(metric[k // 2]) if k % 2 == 0 else 1.0


@inline_always
def product(left, right, found):
    """Write the matrix product of two square matrices."""
    size = len(left)
    for i in range(size):
        for k in range(size):
            total = 0.0
            for j in range(size):
                total += left[i, j] * right[j, k]
            found[i, k] = total


@kernel
def shrinking_norm(metric, J, contraction):
    """P (2n, 2n) of the norm in which J (2n, 2n) shrinks every deviation; NaN where none is found.

    contraction = 1 - |mu|.

    The sum to 2K is P + (A^K)' P A^K: all terms are squares, so that nothing cancels.
    """
    size = len(J)
    A, P = np.empty((size, size)), np.zeros((size, size))
    square, image = np.empty((size, size)), np.empty((size, size))
    for i in range(size):
        for k in range(size):
            A[i, k] = J[i, k] * weight(metric, i) / (weight(metric, k) * (1.0 - 0.5 * contraction))
        P[i, i] = 1.0
    shrinks = False
    for _ in range(MOST_DOUBLINGS):
        total = 0.0
        for i in range(size):
            for k in range(size):
                total += A[i, k] * A[i, k]
        if total <= 1.0:
            shrinks = True
            break
        product(P, A, image)
        for i in range(size):
            for k in range(i + 1):
                term = 0.0
                for j in range(size):
                    term += A[j, i] * image[j, k]
                square[i, k] = square[k, i] = term
        for i in range(size):
            for k in range(size):
                P[i, k] += square[i, k]
        product(A, A, square)
        for i in range(size):
            for k in range(size):
                A[i, k] = square[i, k]
    for i in range(size):
        for k in range(size):
            P[i, k] = P[i, k] * weight(metric, i) * weight(metric, k) if shrinks else np.nan
    return P


@inline_always
def squared(P, d):
    """d.P d."""
    total = 0.0
    for i in range(len(d)):
        for k in range(len(d)):
            total += d[i] * P[i, k] * d[k]
    return total


@kernel
def falls_into(P, J, contraction, fixed, h, image):
    """Whether a turn from block state h (n, 2) to ``image`` is one of falling into the orbit through ``fixed``.

    |r|_P < contraction / 2 |d|_P with d = h - h*, r = image - h* - J d; P as of ``shrinking_norm``.
    """
    size = len(J)
    d, r = np.empty(size), np.empty(size)
    for k in range(size):
        d[k] = h[k // 2, k % 2] - fixed[k // 2, k % 2]
    for i in range(size):
        r[i] = image[i // 2, i % 2] - fixed[i // 2, i % 2]
        for k in range(size):
            r[i] -= J[i, k] * d[k]
    return squared(P, r) < (0.5 * contraction) ** 2 * squared(P, d)


@kernel
def stays_nearer(metric, P, J, fixed, h, begun):
    """Whether a motion at block state h (n, 2) is nearer to an orbit than ``begun``, and by J alone stays so.

    That is certain once the deviation is less in the norm of P, which no turn lets grow and is the larger of the two.
    """
    size = len(J)
    d, image = np.empty(size), np.empty(size)
    for k in range(size):
        d[k] = h[k // 2, k % 2] - fixed[k // 2, k % 2]
    for _ in range(LOOK_AHEAD):
        total = 0.0
        for k in range(size):
            total += (weight(metric, k) * d[k]) ** 2
        if not total < begun * begun:
            return False
        if squared(P, d) < begun * begun:
            break
        for i in range(size):
            image[i] = 0.0
            for k in range(size):
                image[i] += J[i, k] * d[k]
        for k in range(size):
            d[k] = image[k]
    return True
