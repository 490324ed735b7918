"""Two machines in heyoka, for the benchmarks: adaptive Taylor series with terminal events at the stops.

``Taylor``      the two-mass oscillator
``SoftTaylor``  one mass with a soft stop, the packaged system soft-impact

The impact law, the saltation of the tangent vectors and their orthonormalisation are compiled by Numba, so that only
the integrator is measured. heyoka is optional: pip install heyoka.
"""

import math
import time
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scripts.general_integrator import FIGURES, GeneralIntegrator

try:
    import heyoka
except ImportError:
    heyoka = None

INSTALLED = heyoka is not None
Array = NDArray[np.float64]


@njit()
def rebound(state: Array, p: Array, R: float, t: float) -> None:
    """Impact law for the state (4), saltation for the tangent vectors (4 each) behind it, in place."""
    v, drive = state[2], math.sin(p[10] * t + p[11])
    before1 = p[0] * state[0] + p[1] * state[1] + p[2] * v + p[3] * state[3] + p[8] * drive
    jump = -(1.0 + R) * v
    state[2] = -R * v
    for k in range(4, state.size, 4):
        w = state[k] / v
        state[k] += jump * w
        state[k + 2] = -R * state[k + 2] + ((1.0 + R) * before1 + jump * p[2]) * w
        state[k + 3] += jump * p[6] * w


@njit()
def orthonormalise(flat: Array, growth: Array, size: int = 4) -> None:
    """Modified Gram-Schmidt of tangent vectors of ``size`` numbers each, in place; adds the logs of their lengths."""
    for i in range(growth.size):
        a = flat[size * i : size * i + size]
        norm = math.sqrt(np.sum(a**2))
        a /= norm
        growth[i] += math.log(norm)
        for k in range(i + 1, growth.size):
            b = flat[size * k : size * k + size]
            b -= np.sum(a * b) * a


def equations(vectors: int) -> tuple[list[tuple[Any, Any]], Any]:
    """The two-mass oscillator with this many tangent vectors, and its displacement x1; par[0:8] are two rows of A."""
    parts = ["x1", "x2", "v1", "v2"] + [f"w{k}{i}" for k in range(vectors) for i in range(4)]
    symbols = heyoka.make_vars(*parts)
    par = heyoka.par
    drive = heyoka.sin(par[10] * heyoka.time + par[11])

    def rates_of(x: list[Any], force: bool) -> list[Any]:
        a = [sum((par[4 * row + k] * x[k] for k in range(1, 4)), par[4 * row] * x[0]) for row in range(2)]
        return [x[2], x[3], *(a[row] + par[8 + row] * drive if force else a[row] for row in range(2))]

    rates = [rate for k in range(0, len(parts), 4) for rate in rates_of(list(symbols[k : k + 4]), k == 0)]
    return list(zip(symbols, rates, strict=True)), symbols[0]


def parameters(params: dict[str, float]) -> list[float]:
    """The values of par[0:13]: two rows of A, the force on each mass, omega, tau and b."""
    general = GeneralIntegrator(params, 1)
    return [*general.A[2:].ravel(), *general.force, params["omega"], params["tau"], params["b"]]


class Taylor:
    """One compiled integrator with 0 to 4 tangent vectors; the parameters are set per cell."""

    def __init__(self, vectors: int) -> None:
        self.vectors = vectors
        system, x1 = equations(vectors)
        par = heyoka.par
        self.R, self.impacts = 1.0, 0

        def on_stop(integrator: Any, _: int) -> bool:
            rebound(self.state, self.pars, self.R, integrator.time)
            self.impacts += 1
            return True

        direction = heyoka.event_direction
        events = [
            heyoka.t_event(x1 - par[12], callback=on_stop, direction=direction.positive),
            heyoka.t_event(x1 + par[12], callback=on_stop, direction=direction.negative),
        ]
        start = [0.0] * len(system)
        self.integrator = heyoka.taylor_adaptive(system, start, t_events=events, pars=[0.0] * 13, tol=1e-10)
        self.state, self.pars = self.integrator.state, self.integrator.pars
        self.run(FIGURES["3"], (2,))  # compiles the Numba functions

    def run(self, params: dict[str, float], lengths: tuple[int, ...]) -> list[tuple[int, float, Array]]:
        """(periods, processor seconds, exponents) at each length from one run, without its first quarter."""
        self.pars[:] = parameters(params)
        self.R = params["R"]
        self.state[:] = 0.0
        self.state[4:] = 0.1 + 0.4 * np.eye(4)[: self.vectors].ravel()
        self.integrator.reset_cooldowns()
        end, tangent, forward = 2.0 * math.pi / params["omega"], self.state[4:], self.integrator.propagate_until
        sums = np.zeros((max(lengths) + 1, self.vectors))
        found = []
        start = time.process_time()
        for k in range(max(lengths)):
            self.integrator.time = 0.0
            forward(end)
            sums[k + 1] = sums[k]
            orthonormalise(tangent, sums[k + 1])
            if k + 1 in lengths:
                dropped = (k + 1) // 4
                mean = (sums[k + 1] - sums[dropped]) / (k + 1 - dropped)
                found.append((k + 1, time.process_time() - start, mean))
        return found


class SoftTaylor:
    """The mass of soft-impact with 0 to 2 tangent vectors: x'' = -x - 2 zeta x' + a omega^2 sin(omega t) - F.

    F = beta (x - e) where x > e; the stop has no damping, so that vectors pass its ends unchanged.
    """

    def __init__(self, vectors: int) -> None:
        parts = ["x", "v"] + [f"w{k}{i}" for k in range(vectors) for i in range(2)]
        symbols, par = heyoka.make_vars(*parts), heyoka.par
        omega, a, beta, e, zeta, touches = (par[k] for k in range(6))
        rates: list[Any] = []
        for k in range(0, len(parts), 2):
            pull = -(1.0 + touches * beta) * symbols[k] - 2.0 * zeta * symbols[k + 1]
            push = touches * beta * e + a * omega * omega * heyoka.sin(omega * heyoka.time)
            rates += [symbols[k + 1], pull + push if k == 0 else pull]

        def on_stop(integrator: Any, direction: int) -> bool:
            self.pars[5] = float(direction > 0)
            return True

        self.vectors = vectors
        self.integrator = heyoka.taylor_adaptive(
            list(zip(symbols, rates, strict=True)), [0.0] * len(parts), pars=[0.0] * 6, tol=1e-10,
            t_events=[heyoka.t_event(symbols[0] - e, callback=on_stop)],
        )  # fmt: skip
        self.state, self.pars = self.integrator.state, self.integrator.pars

    def run(self, params: dict[str, float], periods: int) -> tuple[float, Array]:
        """Processor seconds of the second half of ``periods`` periods from rest, and the exponents of that half."""
        self.pars[:] = [*(params[name] for name in ("omega", "a", "beta", "e", "zeta")), 0.0]
        self.state[:] = 0.0
        self.state[2:] = np.eye(2)[: self.vectors].ravel()
        end, half, start = 2.0 * math.pi / params["omega"], periods // 2, 0.0
        growth = np.zeros(self.vectors)
        for k in range(2 * half):
            if k == half:
                growth[:], start = 0.0, time.process_time()
            self.integrator.time = 0.0
            self.integrator.propagate_until(end)
            orthonormalise(self.state[2:], growth, 2)
        return time.process_time() - start, growth / half
