"""Small dense matrices: linear equations, and the moduli of eigenvalues."""

import math

import numpy as np
from numba import types

from workers.kernel.by_reference import by_value
from workers.kernel.external import FLOATS, external
from workers.kernel.jit import inline_always, inlined, kernel

EPS = float(np.finfo(np.float64).eps)

NOTHING = 1e-290
"""Entries below this number count as zero in a matrix whose largest entry is about one: products with them
underflow."""

MAX_SWEEPS = 60
"""Maximum number of QR steps for one eigenvalue; two or three usually suffice."""


@kernel
def identity(size):
    """Return the unit matrix of this size."""
    unit = np.zeros((size, size))
    for k in range(size):
        unit[k, k] = 1.0
    return unit


@kernel
def solution(matrix, right):
    """Return the solution x of matrix x = right, by Gaussian elimination with pivots; both arguments are overwritten.

    x is not finite if the matrix is singular.
    """
    size = len(right)
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        for c in range(k, size):
            matrix[k, c], matrix[pivot, c] = matrix[pivot, c], matrix[k, c]
        right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for c in range(k + 1, size):
                matrix[i, c] -= factor * matrix[k, c]
            right[i] -= factor * right[k]
    for k in range(size - 1, -1, -1):
        for c in range(k + 1, size):
            right[k] -= matrix[k, c] * right[c]
        right[k] /= matrix[k, k]
    return right


@inline_always
def balance(A):
    """Scale the coordinates until rows and columns of A are of like size, a similarity transformation, in place."""
    size = len(A)
    for _ in range(10):
        settled = True
        for i in range(size):
            row, column = 0.0, 0.0
            for k in range(size):
                if k != i:
                    row += abs(A[i, k])
                    column += abs(A[k, i])
            if row > 0.0 and column > 0.0 and not 0.25 < row / column < 4.0:
                settled = False
                f = math.sqrt(row / column)
                for k in range(size):
                    A[i, k] /= f
                    A[k, i] *= f
        if settled:
            return


@inline_always
def to_hessenberg(A):
    """Make A zero below its subdiagonal by eliminations with pivots, a similarity transformation, in place."""
    size = len(A)
    for m in range(1, size - 1):
        pivot = m
        for i in range(m + 1, size):
            if abs(A[i, m - 1]) > abs(A[pivot, m - 1]):
                pivot = i
        if A[pivot, m - 1] == 0.0:
            continue
        for c in range(size):
            A[m, c], A[pivot, c] = A[pivot, c], A[m, c]
        for c in range(size):
            A[c, m], A[c, pivot] = A[c, pivot], A[c, m]
        for i in range(m + 1, size):
            factor = A[i, m - 1] / A[m, m - 1]
            for c in range(m - 1, size):
                A[i, c] -= factor * A[m, c]
            for c in range(size):
                A[c, m] += factor * A[c, i]


@inline_always
def near_eigenvalue(a, b, c, d):
    """Return the eigenvalue of [[a, b], [c, d]] nearest to d."""
    half = times(0.5, a - d)
    root = np.sqrt(half * half + b * c)
    if abs(half + root) < abs(half - root):
        root = -root
    far = half + root
    return d - (b * c / far if far != 0.0 else 0.0 * far)


@inlined
def times(real, z):
    """Return a real number times a complex one."""
    return complex(real * z.real, real * z.imag)


@inlined
def over(z, real):
    """Return a complex number divided by a real one."""
    return complex(z.real / real, z.imag / real)


@inlined
def couples(below, before, after):
    """Return True if an entry ``below`` the diagonal of a Hessenberg matrix exceeds the rounding of its neighbours.

    The neighbours are ``before`` and ``after`` on the diagonal. If the entry does not exceed it, the eigenvalue problem
    splits there.
    """
    if max(abs(below.real), abs(below.imag)) < NOTHING:
        return False
    sides = abs(before.real) + abs(before.imag) + abs(after.real) + abs(after.imag)
    if max(abs(below.real), abs(below.imag)) > 2.0 * EPS * sides:  # mostly true, which saves the roots
        return True
    return abs(below) > EPS * (abs(before) + abs(after))


@inline_always
def rotate_once(H, cosines, sines, start, end, shift):
    """Do one shifted step of the QR method for eigenvalues, in place.

    The step acts on rows and columns start...end - 1 of the complex Hessenberg matrix H.

    ``cosines`` and ``sines``, as long as the matrix, are overwritten.
    """
    for k in range(start, end):
        H[k, k] -= shift
    for k in range(start, end - 1):
        x, y = H[k, k], H[k + 1, k]
        length = abs(x)
        size = math.hypot(length, abs(y))
        c, s = 1.0, 0.0j
        if size > 0.0:
            c = length / size
            s = over((over(x, length) if length > 0.0 else 1.0 + 0.0j) * y.conjugate(), size)
        cosines[k], sines[k] = c, s
        for j in range(k, end):
            x, y = H[k, j], H[k + 1, j]
            H[k, j], H[k + 1, j] = times(c, x) + s * y, times(c, y) - s.conjugate() * x
    for k in range(start, end - 1):
        c, s = cosines[k], sines[k]
        for i in range(start, min(k + 2, end)):
            x, y = H[i, k], H[i, k + 1]
            H[i, k], H[i, k + 1] = times(c, x) + s.conjugate() * y, times(c, y) - s * x
    for k in range(start, end):
        H[k, k] += shift


@inline_always
def exponent_of(matrix):
    """Return the least integer k with all |entries| of a matrix below 2^k; 0 for a matrix of zeros."""
    largest = 0.0
    for row in matrix:
        for entry in row:
            largest = max(largest, abs(entry))
    return math.frexp(largest)[1]


@external(FLOATS[2], FLOATS[1])
def fill_moduli(matrix, sizes):
    """Write the moduli of the eigenvalues of a real matrix to ``sizes``; infinity if the matrix is not finite.

    The QR method with shifts finds them. Entries are scaled to about one, where no product of two significant entries
    underflows.
    """
    matrix, sizes = by_value(matrix), by_value(sizes)
    size = len(matrix)
    A, H = np.empty((size, size)), np.empty((size, size), dtype=np.complex128)
    cosines, sines = np.empty(size), np.empty(size, dtype=np.complex128)
    for i in range(size):
        sizes[i] = np.inf
        for k in range(size):
            A[i, k] = matrix[i, k]
    for i in range(size):
        for k in range(size):
            if not math.isfinite(A[i, k]):
                return
    exponent = exponent_of(A)
    for i in range(size):
        for k in range(size):
            A[i, k] = math.ldexp(A[i, k], -exponent)
    balance(A)
    to_hessenberg(A)
    for i in range(size):
        for k in range(size):
            H[i, k] = A[i, k]
    end, sweeps = size, 0
    while end > 0:
        start = end - 1
        while start > 0 and couples(H[start, start - 1], H[start - 1, start - 1], H[start, start]):
            start -= 1
        if start == end - 1:
            end, sweeps = end - 1, 0
            sizes[end] = math.ldexp(abs(H[end, end]), exponent)
        elif sweeps == MAX_SWEEPS:
            for i in range(size):
                sizes[i] = np.inf
            return
        else:
            sweeps += 1
            shift = near_eigenvalue(H[end - 2, end - 2], H[end - 2, end - 1], H[end - 1, end - 2], H[end - 1, end - 1])
            if sweeps % 10 == 0:  # breaks cycles
                shift = H[end - 1, end - 1] + abs(H[end - 1, end - 2])
            rotate_once(H, cosines, sines, start, end, shift)


@inline_always
def moduli(matrix):
    """Return the moduli of the eigenvalues of a real matrix, in any order; infinity if the matrix is not finite."""
    sizes = np.empty(len(matrix))
    fill_moduli(matrix, sizes)
    return sizes


@external(FLOATS[2], result=types.float64)
def spectral_radius(matrix):
    """Return the largest modulus of an eigenvalue of a real matrix; infinity if the matrix is not finite."""
    matrix = by_value(matrix)
    return highest(moduli(matrix), 0, len(matrix))


@inline_always
def highest(values, start, end):
    """Return the largest of values[start:end], NaN if any of them is NaN."""
    top = values[start]
    for i in range(start + 1, end):
        if values[i] > top or math.isnan(values[i]):
            top = values[i]
    return top


@inline_always
def sort_down(values):
    """Sort an array of numbers from the largest to the smallest, in place."""
    for i in range(1, len(values)):
        value, k = values[i], i
        while k > 0 and values[k - 1] < value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value


@inlined
def copy_into(target, source):
    """Copy the entries of an array into another of the same shape; both are contiguous."""
    if source.ndim == 1:  # decided by the compiler: ravel calls a function of NumPy
        for k in range(len(source)):
            target[k] = source[k]
        return
    to, values = target.ravel(), source.ravel()
    for k in range(values.size):
        to[k] = values[k]
