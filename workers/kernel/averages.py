"""Running averages of the tangent growth per forcing period (Lyapunov exponents), with their standard errors."""

import math

import numpy as np

from workers.kernel.elementary import exp_minus
from workers.kernel.jit import inlined, kernel

LEVELS = 40
"""Number of levels of the blocking analysis, enough for 2^40 periods."""

COUNT, MEAN, SQUARES, UNPAIRED = range(4)
"""Columns of the levels (LEVELS, 4) of an average. COUNT, MEAN and SQUARES are the count, the mean and the sum of
squared deviations of blocks of 2^k periods. UNPAIRED is the newest block while it has no partner."""

FEWEST_BLOCKS = 32
"""Minimum number of blocks that a level of the blocking analysis needs for its error bar to count."""


@inlined
def add_to_blocks(levels, x):
    """Add a value to the blocking analysis, which averages ever longer runs of values (Flyvbjerg & Petersen 1989).

    ``levels`` (LEVELS, 4) changes in place. A run of 2^k values is a block of level k; the mean of two blocks moves up
    a level.
    """
    for k in range(LEVELS):
        levels[k, COUNT] += 1.0
        deviation = x - levels[k, MEAN]
        levels[k, MEAN] += deviation / levels[k, COUNT]
        levels[k, SQUARES] += deviation * (x - levels[k, MEAN])
        half = 0.5 * levels[k, COUNT]
        if half != math.floor(half):
            levels[k, UNPAIRED] = x
            return
        x = 0.5 * (levels[k, UNPAIRED] + x)


@kernel
def standard_error(levels):
    """Return the standard error of the mean of correlated values.

    levels (LEVELS, 4)  blocking analysis of the values, see ``add_to_blocks``

    A block is the mean of B consecutive values. Blocks of B = 2^k values give the error e_k, which grows from sigma /
    sqrt(N) to sqrt(sigma^2 tau / N). Blocks are long enough from the first k with B^3 > 2 N (e_k / e_0)^4 (Lee et al.
    2011). The result is the largest e_k of that k and all longer blocks: these reveal weak correlations, such as long
    flights that now and then miss the stops. If no k qualifies, it is the largest e_k of the levels with at least
    FEWEST_BLOCKS blocks. It is NaN for fewer than FEWEST_BLOCKS values.
    """
    error, first, count, enough = np.nan, np.nan, levels[0, COUNT], False
    for k in range(LEVELS):
        blocks = levels[k, COUNT]
        if blocks < FEWEST_BLOCKS:
            return error
        level_error = math.sqrt(levels[k, SQUARES] / (blocks - 1.0) / blocks)
        if k == 0:
            first = level_error
        starts = not enough and 8.0**k > 2.0 * count * (level_error / first) ** 4
        error = level_error if starts or not level_error < error else error
        enough = enough or starts
    return error


@inlined
def add_growth(levels, weighted, growth, k, periods):
    """Add the growth g of the first tangent vector in period k to the averages over an interval of ``periods`` periods.

    levels   (LEVELS, 4)  blocking analysis of the growth, for its plain mean and standard error
    weighted (2,)         sums of w g and of w over the interval

    The weight is w = exp(-1 / (u (1 - u))) with u = (k + 1/2) / periods. The ratio of both sums is the weighted
    Birkhoff average, which on a torus converges faster than any power of ``periods`` (Das et al. 2017).
    """
    u = (k + 0.5) / periods
    weight = exp_minus(1.0 / (u * (1.0 - u)))
    weighted[0] += weight * growth
    weighted[1] += weight
    add_to_blocks(levels, growth)
