"""heyoka's batch mode beside its scalar mode: microseconds a cell and forcing period, with events and tangent vectors.

scripts.bench_kernel measures the solver against heyoka's scalar mode. Here as many cells of the same figures as heyoka
has lanes, with slightly different b, go through one batch integrator; each impact is a callback for its lane. Both
modes are timed in processor time on one core, in turn, best of several, after half of the periods.

Usage: python -m scripts.bench_heyoka_batch [--light] [--keep]
"""

import argparse
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.general_integrator import FIGURES
from scripts.heyoka_reference import INSTALLED, Taylor, equations, orthonormalise, parameters, rebound
from scripts.measured import parsed, print_table

if INSTALLED:
    import heyoka

Array = NDArray[np.float64]

PERIODS, REPEATS = 4000, 5
LIGHT_PERIODS, LIGHT_REPEATS = 400, 2


class Batch:
    """One compiled batch integrator with 0 to 4 tangent vectors; a lane is a cell."""

    def __init__(self, vectors: int) -> None:
        self.vectors, self.lanes = vectors, heyoka.recommended_simd_size()
        system, x1 = equations(vectors)
        par, direction = heyoka.par, heyoka.event_direction
        self.R, self.impacts = 1.0, np.zeros(self.lanes, np.int64)

        def on_stop(integrator: Any, _: int, lane: int) -> bool:
            rebound(self.state[:, lane], self.pars[:, lane], self.R, self.times[lane])
            self.impacts[lane] += 1
            return True

        events = [
            heyoka.t_event_batch(x1 - par[12], callback=on_stop, direction=direction.positive),
            heyoka.t_event_batch(x1 + par[12], callback=on_stop, direction=direction.negative),
        ]
        start, pars = np.zeros((len(system), self.lanes)), np.zeros((13, self.lanes))
        self.integrator = heyoka.taylor_adaptive_batch(system, start, t_events=events, pars=pars, tol=1e-10)
        self.state, self.pars, self.times = self.integrator.state, self.integrator.pars, self.integrator.time

    def run(self, cells: list[dict[str, float]], periods: int) -> tuple[float, Array]:
        """Processor seconds of the later half of the periods, and the exponents (vectors, lanes) over it."""
        self.pars[:] = np.array([parameters(cell) for cell in cells]).T
        self.R = cells[0]["R"]
        self.state[:] = 0.0
        self.state[4:] = (0.1 + 0.4 * np.eye(4)[: self.vectors].ravel())[:, None]
        self.integrator.reset_cooldowns()
        end, half = 2.0 * math.pi / cells[0]["omega"], periods // 2
        growth = np.zeros((self.lanes, self.vectors))
        start = time.process_time()
        for k in range(periods):
            if k == half:
                start, growth[:] = time.process_time(), 0.0
                self.impacts[:] = 0
            self.integrator.set_time(0.0)
            self.integrator.propagate_until(end)
            for lane in range(self.lanes):
                orthonormalise(self.state[4:, lane], growth[lane])
        return time.process_time() - start, growth.T / (periods - half)


def measure(periods: int, repeats: int) -> list[tuple[str, int, float, float, float]]:
    """Figure, exponents, microseconds a cell and period of the scalar and the batch mode, and their ratio."""
    rows = []
    for vectors in (0, 1, 4):
        scalar, batch = Taylor(vectors), Batch(vectors)
        for figure, params in FIGURES.items():
            cells = [params | {"b": params["b"] * (1.0 + 1e-5 * lane)} for lane in range(batch.lanes)]
            batch.run(cells, 10)  # compiles what Numba compiles
            alone, together = math.inf, math.inf
            for _ in range(repeats):
                first, second = scalar.run(params, (periods // 2, periods))
                alone = min(alone, (second[1] - first[1]) / (periods - periods // 2))
                together = min(together, batch.run(cells, periods)[0] / (periods - periods // 2) / batch.lanes)
            rows.append((figure, vectors, 1e6 * alone, 1e6 * together, alone / together))
    return sorted(rows)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--light", action="store_true", help="a tenth of the periods")
    options = parsed(parser)
    if not INSTALLED:
        raise SystemExit("heyoka is not installed: pip install heyoka")
    rows = measure(*((LIGHT_PERIODS, LIGHT_REPEATS) if options.light else (PERIODS, REPEATS)))
    print(f"{heyoka.recommended_simd_size()} lanes, heyoka {heyoka.__version__}")
    table = [[f, str(n), f"{alone:.1f}", f"{together:.1f}", f"{ratio:.2f}"] for f, n, alone, together, ratio in rows]
    print_table(
        "heyoka-batch", ["figure", "exponents", "scalar, µs", "batch, µs", "scalar / batch"], table, options.keep
    )


if __name__ == "__main__":
    main()
