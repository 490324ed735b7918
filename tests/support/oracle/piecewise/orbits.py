"""Periodic orbits of a piecewise-linear machine: Newton's method on the stroboscopic map, its derivative, measures.

The derivative is by central differences of motions in higher precision, without saltation matrices.
"""

from dataclasses import dataclass
from typing import Any

from mpmath import mp

from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.machine import PiecewiseMachine, Vector
from tests.support.oracle.piecewise.mode_law import PiecewiseMode
from tests.support.oracle.piecewise.motion import PiecewiseRun, simulate

DIGITS = 50
REST = 1e-14
STEPS = 30


@dataclass(frozen=True)
class PiecewiseOrbit:
    """One turn, ``run`` over ``span``, that closes as image z(span) = z(0) + drift; ``jacobian``: d image z(span).

    ``image`` is 1, or -1 for symmetric orbits followed over half their period.
    """

    machine: PiecewiseMachine
    run: PiecewiseRun
    span: Number
    jacobian: Any
    image: int
    drift: Number

    @property
    def state(self) -> list[Number]:
        """(x, v) at the section."""
        return self.run.sections[0]

    @property
    def multipliers(self) -> list[complex]:
        """Eigenvalues of the whole turn's map, largest modulus first; for a symmetric orbit of both halves."""
        return _eigenvalues(self.jacobian if self.image > 0 else self.jacobian * self.jacobian)

    @property
    def half_multipliers(self) -> list[complex]:
        """Eigenvalues of the map over ``span`` followed by ``image``."""
        return _eigenvalues(self.jacobian)


def monodromy(
    machine: PiecewiseMachine, state: Vector, periods: int = 1, *, mode: PiecewiseMode | None = None,
    span: Number | None = None,
    digits: int = DIGITS,
) -> Any:  # fmt: skip
    """d(x, v)(end) / d(x, v)(0), an mpmath matrix, by central differences 10^-(digits/3) wide.

    On a section in a ``mode`` with constraints, variations are first projected onto them.
    """
    with mp.workdps(digits):
        start = [mp.mpf(value) for value in state]
        width = mp.mpf(10) ** (-digits // 3)
        result = mp.zeros(len(start))
        for j in range(len(start)):
            ends = []
            for sign in (1, -1):
                moved = [value + sign * width * (i == j) for i, value in enumerate(start)]
                run = simulate(machine, moved, periods, mode=mode, span=span, digits=digits, rest=REST)
                ends.append(run.sections[-1])
            for i, (a, b) in enumerate(zip(*ends, strict=True)):
                result[i, j] = (a - b) / (2 * width)
        return result


def orbit(
    machine: PiecewiseMachine, state: Vector, periods: int = 1, *, mode: PiecewiseMode | None = None,
    symmetric: bool = False,
    drift: int | None = None, tolerance: float = 1e-30,
) -> PiecewiseOrbit:  # fmt: skip
    """The periodic orbit near a section state, by Newton's method until the closure is below ``tolerance``.

    ``symmetric``: over half of ``periods`` forcing periods, closed by z -> -z. ``drift``: the coordinate that may
    differ after the turn; it keeps its value in ``state``.
    """
    with mp.workdps(DIGITS):
        whole = 2 * mp.pi / mp.mpf(machine.omega) * periods
        half = whole / 2 if symmetric else None
        image = -1 if symmetric else 1
        z = [mp.mpf(value) for value in state]
        known = [i for i in range(len(z)) if i != drift]
        for _ in range(STEPS):
            run = simulate(machine, z, periods, mode=mode, span=half, digits=DIGITS, rest=REST)
            z, end = run.sections[0], run.sections[-1]
            closure = mp.matrix([image * end[i] - z[i] for i in known])
            jacobian = image * monodromy(machine, z, periods, mode=mode, span=half)
            if mp.norm(closure) < tolerance:
                moved = mp.zero if drift is None else end[drift] - z[drift]
                return PiecewiseOrbit(machine, run, half or whole, jacobian, image, moved)
            reduced = mp.matrix([[jacobian[i, j] - (i == j) for j in known] for i in known])
            for i, change in zip(known, mp.lu_solve(reduced, -closure), strict=True):
                z[i] += change
        raise ArithmeticError(f"closure {mp.nstr(mp.norm(closure), 3)} after {STEPS} steps of Newton's method")


def _eigenvalues(matrix: Any) -> list[complex]:
    with mp.workdps(DIGITS):
        values = [complex(value) for value in mp.eig(matrix, left=False, right=False)]
    return sorted(values, key=lambda value: (-abs(value), -value.imag))
