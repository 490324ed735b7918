"""Bifurcations of periodic orbits, where a multiplier takes a given real value: Newton's method."""

from collections.abc import Callable
from typing import Any

from mpmath import mp

from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.machine import PiecewiseMachine, Vector
from tests.support.oracle.piecewise.mode_law import PiecewiseMode
from tests.support.oracle.piecewise.motion import simulate
from tests.support.oracle.piecewise.orbits import DIGITS, REST, STEPS, monodromy

WIDTH = mp.mpf("1e-9")  # of central differences


def bifurcation(
    machine_at: Callable[[Number], PiecewiseMachine], parameter: float, state: Vector, multiplier: int,
    periods: int = 1, *,
    mode: PiecewiseMode | None = None, symmetric: bool = False, tolerance: float = 1e-20,
) -> tuple[Number, list[Number]]:  # fmt: skip
    """Parameter and section state (x, v) of the nearby orbit with the multiplier 1 (fold) or -1.

    image z(span) = z(0) and det(J - multiplier) = 0, where J is the derivative of image z(span); ``symmetric``: image
    -1 and half the span.
    """
    with mp.workdps(DIGITS):
        size = len(state)
        image = -1 if symmetric else 1

        def span(machine: PiecewiseMachine) -> Number:
            return 2 * mp.pi / mp.mpf(machine.omega) * periods / (2 if symmetric else 1)

        def closure(unknown: Any) -> Any:
            machine = machine_at(unknown[size])
            z = list(unknown)[:size]
            if symmetric:
                run = simulate(machine, z, mode=mode, span=span(machine), digits=DIGITS, rest=REST)
            else:
                run = simulate(machine, z, periods, mode=mode, digits=DIGITS, rest=REST)
            return mp.matrix([image * a - b for a, b in zip(run.sections[-1], z, strict=True)])

        def jacobian(unknown: Any) -> Any:
            machine = machine_at(unknown[size])
            half = span(machine) if symmetric else None
            return image * monodromy(machine, list(unknown)[:size], periods, mode=mode, span=half)

        def critical(unknown: Any) -> Number:
            return mp.det(jacobian(unknown) - multiplier * mp.eye(size))

        def residual(unknown: Any) -> Any:
            return mp.matrix([*closure(unknown), critical(unknown)])

        unknown = mp.matrix([*map(mp.mpf, state), mp.mpf(parameter)])
        for _ in range(STEPS):
            off = residual(unknown)
            if mp.norm(off) < tolerance:
                return unknown[size], list(unknown)[:size]
            slopes = mp.zeros(size + 1)
            for j in range(size + 1):
                step = mp.matrix([WIDTH * (i == j) for i in range(size + 1)])
                slopes[:, j] = (residual(unknown + step) - residual(unknown - step)) / (2 * WIDTH)
            unknown -= mp.lu_solve(slopes, off)
        raise ArithmeticError(f"residual {mp.nstr(mp.norm(off), 3)} after {STEPS} steps of Newton's method")
