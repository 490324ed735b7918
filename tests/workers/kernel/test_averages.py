"""Averages over periods and their error bars."""

import math

import numpy as np
import pytest

from tests import naive
from workers.cell.interval import batch_of, run, run_periods
from workers.kernel.averages import COUNT, LEVELS, MEAN, add_growth, add_to_blocks, standard_error
from workers.kernel.coordinates import motion_from
from workers.kernel.lanes.run import MotionBatch
from workers.kernel.motion import SPREAD, Motion
from workers.kernel.tangent import reset_frame
from workers.model.oscillator import Oscillator, many_of, map_fields

ONE = np.zeros(1, dtype=np.int64)


def averaged(osc: Oscillator, motion: Motion, periods: int, kept: int = 0) -> MotionBatch:
    """The batch of one motion, after a stretch of this many periods that takes it on in place."""
    batch = batch_of(many_of(osc), map_fields(motion, lambda field: field[None]), kept)
    batch.periods[0] = periods
    run(batch, ONE)
    return batch


def blocking(values: np.ndarray) -> np.ndarray:
    levels = np.zeros((LEVELS, 4))
    for value in values:
        add_to_blocks(levels, float(value))
    return levels


def correlated(rng: np.random.Generator, phi: float, count: int) -> np.ndarray:
    """AR(1) noise of unit variance, correlation time (1 + phi) / (1 - phi) samples."""
    noise = rng.normal(size=count) * math.sqrt(1 - phi * phi)
    values = np.empty(count)
    last = rng.normal()
    for k in range(count):
        last = values[k] = phi * last + noise[k]
    return values


@pytest.mark.parametrize("count", [32, 64, 65, 300, 5000, 30_000])
@pytest.mark.parametrize("phi", [-0.5, 0.0, 0.6, 0.9, 0.99])
def test_mean_and_error_are_those_of_plain_blocking(phi: float, count: int) -> None:
    """Truth: the naive twin, which reshapes the whole series level by level."""
    values = correlated(np.random.default_rng(1), phi, count) + 3.0
    levels = blocking(values)
    assert levels[0, 0] == count
    assert levels[0, 1] == pytest.approx(values.mean(), rel=1e-13)
    assert standard_error(levels) == pytest.approx(naive.blocking_error(values, 32), rel=1e-11)


def test_white_noise_has_the_error_sigma_over_root_n() -> None:
    """The largest of several estimates of the same number: a few per cent above it on average."""
    rng = np.random.default_rng(2)
    errors = [standard_error(blocking(2.0 * rng.normal(size=4096))) for _ in range(60)]
    assert 1.0 < np.mean(errors) / (2.0 / 64.0) < 1.2


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, -0.5])
def test_the_error_bar_of_correlated_noise_is_right_within_statistics(phi: float) -> None:
    """(mean - true mean) / error over 400 series: root mean square near one, 90 % below two.

    Anticorrelated noise may only be overestimated: the error is the largest of all block lengths.
    """
    rng = np.random.default_rng(3)
    z = []
    for _ in range(400):
        values = correlated(rng, phi, 2048)
        z.append(values.mean() / standard_error(blocking(values)))
    rms = math.sqrt(np.mean(np.square(z)))
    assert rms < 1.15
    if phi >= 0.0:
        assert rms > 0.8
    assert np.mean(np.abs(z) < 2.0) > 0.9


def test_too_few_values_have_no_error() -> None:
    assert math.isnan(standard_error(blocking(np.ones(31))))
    assert standard_error(blocking(np.ones(32))) == 0.0


def test_growth_is_weighted_by_the_bump_function_of_its_place_in_the_stretch() -> None:
    """w = exp(-1 / (u (1 - u))), u the middle of the period as a share of the stretch."""
    growth, levels, weighted = np.random.default_rng(5).normal(size=40), np.zeros((LEVELS, 4)), np.zeros(2)
    for k, value in enumerate(growth):
        add_growth(levels, weighted, value, k, len(growth))
    u = (np.arange(40) + 0.5) / 40
    weight = np.exp(-1.0 / (u * (1.0 - u)))
    assert weighted == pytest.approx([np.sum(weight * growth), np.sum(weight)], rel=1e-13)
    assert levels[0, [COUNT, MEAN]] == pytest.approx([40, growth.mean()], rel=1e-13)


def test_the_weighted_average_of_a_periodic_orbit_beats_the_plain_mean() -> None:
    """Truth: the Floquet exponent of Fig. 3, from 40-digit arithmetic (a complex pair: the growth oscillates)."""
    exact = -0.235569640371152
    osc, start = naive.two_mass(**naive.FIGURES[3])
    motion = motion_from(osc, start, vectors=1)
    run_periods(osc, motion, 500)
    average = averaged(osc, motion, 4000)
    plain, weighted = average.levels[0, 0, MEAN], average.weighted[0, 0] / average.weighted[0, 1]
    assert abs(weighted - exact) < 1e-11
    assert abs(plain - exact) < 1e-3


@pytest.mark.parametrize("figure", [3, 4, 5])
@pytest.mark.parametrize("vectors", [1, 4])
def test_averages_do_not_depend_on_when_the_frame_is_made_orthonormal(figure: int, vectors: int) -> None:
    """Against every period, as Li & Tan (2011) do."""
    osc, start = naive.two_mass(**naive.FIGURES[figure])
    one, other = motion_from(osc, start, vectors=vectors), motion_from(osc, start, vectors=vectors)
    average, expected = averaged(osc, one, 300), averaged(osc, other, 1)
    for _ in range(299):
        reset_frame(osc.gap.blocks, other)
        expected.completed[0] = 0
        run(expected, ONE)
    reset_frame(osc.gap.blocks, other)
    assert one.tally[SPREAD] > 0.0
    assert average.levels[0, :, MEAN] == pytest.approx(expected.levels[0, :, MEAN], abs=1e-12)
    reset_frame(osc.gap.blocks, one)
    assert one.growth == pytest.approx(other.growth, abs=1e-9)


def test_a_stretch_ends_with_its_last_sections() -> None:
    osc, start = naive.two_mass(**naive.FIGURES[4])
    one, other = motion_from(osc, start, vectors=1), motion_from(osc, start)
    kept, expected = averaged(osc, one, 10, 3).sections[0], averaged(osc, other, 10, 3).sections[0]
    assert kept == pytest.approx(expected, abs=1e-15)
    assert kept[-1] == pytest.approx(one.h, abs=0)


@pytest.mark.slow
def test_the_error_bar_sees_weak_but_slow_changes_behind_the_noise_of_single_periods() -> None:
    """(mean - true mean) / error over 300 series: blocks that are just long enough for the noise give 1.8."""
    rng = np.random.default_rng(5)
    z = []
    for _ in range(300):
        values = rng.normal(size=8192) + 0.3 * correlated(rng, 1.0 - 2.0 / 300.0, 8192)
        z.append(values.mean() / standard_error(blocking(values)))
    assert math.sqrt(np.mean(np.square(z))) < 1.6
