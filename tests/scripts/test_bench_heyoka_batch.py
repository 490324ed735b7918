"""The claim that heyoka's batch mode, as it is timed, follows the motion that its scalar mode follows."""

import pytest

from scripts import bench_heyoka_batch as bench
from scripts.general_integrator import FIGURES
from scripts.heyoka_reference import INSTALLED, Taylor


@pytest.mark.slow
@pytest.mark.skipif(not INSTALLED, reason="heyoka is not installed")
def test_each_lane_has_the_impacts_and_the_exponent_of_its_cell() -> None:
    batch, scalar = bench.Batch(1), Taylor(1)
    cells = [FIGURES["4"] | {"b": 0.2 * (1.0 + 1e-3 * lane)} for lane in range(batch.lanes)]
    _, exponents = batch.run(cells, 400)
    alone = [scalar.run(cell, (400,))[0][2][0] for cell in cells]
    assert batch.impacts.tolist() == [4 * 200] * batch.lanes
    assert exponents[0] == pytest.approx(alone, abs=1e-9)
