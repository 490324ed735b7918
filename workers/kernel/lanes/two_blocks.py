"""Tangent vectors of machines with two blocks (two masses), four for each cell: all four at a time, in registers.

Each function is a loop over lanes, slots that hold one cell each, or over cells that were gathered. The results have
the same bits as the passes of ``frames.py``, which take one vector at a time. Arrays are flat with constant offsets,
see ``layout.py``.
"""

import math

from workers.kernel.elementary import log
from workers.kernel.fma import fma
from workers.kernel.jit import inlined, kernel
from workers.kernel.lanes.layout import BLOCK, BLOCK_SIZE, LANE, LANE_SIZE, STRIDE

BLOCKS, VECTORS = 2, 4

VECTOR = 4 * STRIDE
"""Distance, in numbers, from one vector of many frames to the next."""


@inlined
def read(U, e):
    """Return the four numbers of a tangent vector of one cell, from index e of the array U of many cells on."""
    return U[e], U[e + STRIDE], U[e + 2 * STRIDE], U[e + 3 * STRIDE]


@inlined
def write(U, e, u):
    """Write the four numbers u of a tangent vector of one cell, from index e of the array U of many cells on."""
    U[e], U[e + STRIDE], U[e + 2 * STRIDE], U[e + 3 * STRIDE] = u


@inlined
def product(p, q, u, w):
    """Return ``tangent.inner`` of two tangent vectors of four numbers, two for each decoupled equation of motion.

    p and q are the metric of both equations.
    """
    return fma(u[3], w[3], fma(q * u[2], w[2], fma(u[1], w[1], fma(p * u[0], w[0], 0.0))))


@inlined
def without(p, q, u, w):
    """Return the tangent vector w without its component along the unit vector u.

    p and q are the metric of both decoupled equations.
    """
    overlap = product(p, q, u, w)
    return (
        fma(-overlap, u[0], w[0]), fma(-overlap, u[1], w[1]), fma(-overlap, u[2], w[2]), fma(-overlap, u[3], w[3])
    )  # fmt: skip


@inlined
def unit(p, q, u, exists):
    """Return the unit vector along u and the logarithm of u's length.

    p and q are the metric of both decoupled equations. If ``exists`` is False, since the direction is lost, return a
    zero vector and -infinity.
    """
    norm = math.sqrt(product(p, q, u, u))
    inverse = 1.0 / norm if exists else 0.0
    return (u[0] * inverse, u[1] * inverse, u[2] * inverse, u[3] * inverse), log(norm if exists else 0.0)


@kernel
def orthonormalise_frames(metric, rank, U, growth, count):
    """Apply tangent.orthonormalise to the four tangent vectors of each of ``count`` cells.

    For the arrays see frames.normalise_pass.
    """
    for i in range(count):
        p, q, directions = metric[i], metric[2 * STRIDE + i], rank[i]
        u, v, w, x = read(U, i), read(U, VECTOR + i), read(U, 2 * VECTOR + i), read(U, 3 * VECTOR + i)
        u, grown = unit(p, q, u, directions > 0)
        growth[i] += grown
        v, w, x = without(p, q, u, v), without(p, q, u, w), without(p, q, u, x)
        v, grown = unit(p, q, v, directions > 1)
        growth[STRIDE + i] += grown
        w, x = without(p, q, v, w), without(p, q, v, x)
        w, grown = unit(p, q, w, directions > 2)
        growth[2 * STRIDE + i] += grown
        x = without(p, q, w, x)
        x, grown = unit(p, q, x, directions > 3)
        growth[3 * STRIDE + i] += grown
        write(U, i, u)
        write(U, VECTOR + i, v)
        write(U, 2 * VECTOR + i, w)
        write(U, 3 * VECTOR + i, x)


@inlined
def flown(a, i, flows, u):
    """Return the tangent vector u, four numbers, after the flight just completed in lane i, which holds one cell.

    ``flows`` is True if a flight has been completed; otherwise u is returned unchanged.
    """
    first, second = LANE_SIZE + i, LANE_SIZE + BLOCK_SIZE + i
    w0 = fma(a[first + BLOCK.f11], u[0], a[first + BLOCK.f12] * u[1])
    w1 = fma(a[first + BLOCK.f21], u[0], a[first + BLOCK.f22] * u[1])
    w2 = fma(a[second + BLOCK.f11], u[2], a[second + BLOCK.f12] * u[3])
    w3 = fma(a[second + BLOCK.f21], u[2], a[second + BLOCK.f22] * u[3])
    return w0 if flows else u[0], w1 if flows else u[1], w2 if flows else u[2], w3 if flows else u[3]


@inlined
def along(a, i, column0, column1, w):
    """Return the product of tangent vector w with a row of the gap coordinate of the cell in lane i.

    The row is given by the offsets column0 and column1 of its numbers in each of both decoupled equations.
    """
    first, second = LANE_SIZE + i, LANE_SIZE + BLOCK_SIZE + i
    total = fma(a[first + column1], w[1], fma(a[first + column0], w[0], 0.0))
    return fma(a[second + column1], w[3], fma(a[second + column0], w[2], total))


@inlined
def kicked(a, i, w):
    """Return the tangent vector w after the impact of the cell in lane i; w itself if there is no impact.

    See contact.saltation.
    """
    first, second = LANE_SIZE + i, LANE_SIZE + BLOCK_SIZE + i
    dy, dv = along(a, i, BLOCK.c0, BLOCK.c1, w), along(a, i, BLOCK.cA0, BLOCK.cA1, w)
    along_k = -a[LANE.loss + i] * fma(-a[LANE.ratio + i], dy, dv)
    along_Ak = -a[LANE.loss + i] * dy
    return (
        fma(along_Ak, a[first + BLOCK.Ak0], fma(along_k, a[first + BLOCK.k0], w[0])),
        fma(along_Ak, a[first + BLOCK.Ak1], fma(along_k, a[first + BLOCK.k1], w[1])),
        fma(along_Ak, a[second + BLOCK.Ak0], fma(along_k, a[second + BLOCK.k0], w[2])),
        fma(along_Ak, a[second + BLOCK.Ak1], fma(along_k, a[second + BLOCK.k1], w[3])),
    )


@kernel
def transfer_frames(a, frames, n):
    """Carry all four tangent vectors of each of n cells through a completed flight and an impact.

    It does the work of frames.transfer_pass, but reads the fields of a cell once.
    """
    for i in range(n):
        flows = a[LANE.flows + i] > 0.0
        u, v = read(frames, i), read(frames, VECTOR + i)
        w, x = read(frames, 2 * VECTOR + i), read(frames, 3 * VECTOR + i)
        u, v = kicked(a, i, flown(a, i, flows, u)), kicked(a, i, flown(a, i, flows, v))
        w, x = kicked(a, i, flown(a, i, flows, w)), kicked(a, i, flown(a, i, flows, x))
        write(frames, i, u)
        write(frames, VECTOR + i, v)
        write(frames, 2 * VECTOR + i, w)
        write(frames, 3 * VECTOR + i, x)
