"""The tangent frame: Gram-Schmidt with the logarithms of what it takes out (Li & Tan 2011)."""

import math

import numpy as np

from workers.jit import kernel


@kernel
def inner(lam, u, w):
    """The energy product sum_j lam_j u_j w_j + u_j' w_j' of two tangent vectors (n, 2): undamped flight keeps it."""
    total = 0.0
    for j in range(len(lam)):
        total += lam[j] * u[j, 0] * w[j, 0] + u[j, 1] * w[j, 1]
    return total


@kernel
def orthonormalise(lam, V, growth, triangle, rank):
    """Make V (m, n, 2) orthonormal in the energy product and add the log of each norm to growth (m,).

    V = Q r by modified Gram-Schmidt. Only the first ``rank`` directions exist; the others are structurally
    lost: zero, growth -infinity. triangle (m, m), or (0, 0) for none, is the product of all r so far with its
    rows divided by exp(growth): it stays in range where the product itself would not.
    """
    for i in range(min(rank, V.shape[0])):
        norm = math.sqrt(inner(lam, V[i], V[i]))
        for j in range(len(lam)):
            V[i, j, 0] /= norm
            V[i, j, 1] /= norm
        for k in range(i + 1, V.shape[0]):
            overlap = inner(lam, V[i], V[k])
            for j in range(len(lam)):
                V[k, j, 0] -= overlap * V[i, j, 0]
                V[k, j, 1] -= overlap * V[i, j, 1]
            if triangle.shape[0] > 0:
                triangle[i] += overlap / norm * math.exp(growth[k] - growth[i]) * triangle[k]
        growth[i] += math.log(norm)
    for i in range(rank, V.shape[0]):
        V[i] = 0.0
        growth[i] = -np.inf
