"""Orbits with one impact in n forcing periods of a mass on a spring with one rigid stop, in closed form.

    x'' + 2 zeta x' + x = A sin(omega t + phase),    x <= sigma;    at the stop x' -> -R x'

Put t = 0 at the impact and let theta be the phase of the forced response there, of amplitude F. The rest of the motion,
u = x - F sin(omega t + theta), is free: with E = exp of the free flow over n periods, (u, u') at the end is E times
that at the beginning, and u has the same value at both. With the speed v before the impact this gives

    F sin theta = sigma - alpha v,    F cos theta = -beta v / omega,    F^2 = (sigma - alpha v)^2 + (beta v / omega)^2,

an ellipse in (sigma, v). Its vertical tangents are folds. The multipliers are eigenvalues of E times the saltation
matrix of the impact, so a multiplier -1 gives one more equation, v = ratio sigma. The mass may pass the stop in
between: this is not checked.
"""

from dataclasses import dataclass
from functools import cached_property
from math import cos, exp, hypot, pi, sin, sqrt


@dataclass(frozen=True)
class OneImpact:
    """The orbits with one impact in n = ``periods`` forcing periods; zeta < 1, R < 1."""

    omega: float
    zeta: float
    R: float
    periods: int = 1

    @cached_property
    def flow(self) -> tuple[float, float, float, float, float]:
        """Elements 11, 12 and 22 of E, 1 - trace + determinant, and the determinant."""
        rate, length = sqrt(1.0 - self.zeta**2), 2.0 * pi * self.periods / self.omega
        decay, c, s = exp(-self.zeta * length), cos(rate * length), sin(rate * length) / rate
        first, last, det = decay * (c + self.zeta * s), decay * (c - self.zeta * s), decay**2
        return first, decay * s, last, 1.0 - first - last + det, det

    @property
    def response(self) -> float:
        """F / A: amplitude of the motion without impact, the grazing value of the stop."""
        return 1.0 / hypot(1.0 - self.omega**2, 2.0 * self.zeta * self.omega)

    @property
    def alpha(self) -> float:
        """Coefficient of the ellipse, zero if omega is 2 n sqrt(1 - zeta^2) / m with an integer m."""
        _, e12, _, gap, _ = self.flow
        return -(1.0 + self.R) * e12 / gap

    @property
    def beta(self) -> float:
        """Coefficient of the ellipse."""
        e11, _, _, gap, _ = self.flow
        return self.R - (1.0 + self.R) * (1.0 - e11) / gap

    def speeds(self, sigma: float, A: float) -> list[float]:
        """The speeds v > 0 before the impact, largest first."""
        square = self.alpha**2 + (self.beta / self.omega) ** 2
        root = (self.alpha * sigma) ** 2 - square * (sigma**2 - (self.response * A) ** 2)
        roots = [(self.alpha * sigma + sign * sqrt(root)) / square for sign in (1.0, -1.0)] if root >= 0.0 else []
        return sorted((v for v in roots if v > 0.0), reverse=True)

    @property
    def fold(self) -> float:
        """Sigma / A at the fold, of either sign."""
        return self.response * hypot(1.0, self.alpha * self.omega / self.beta)

    @property
    def doubling_ratio(self) -> float:
        """v / sigma at the period doubling."""
        e11, e12, e22, _, det = self.flow
        traced = (self.R * (e11 + e22) - 1.0 - self.R**2 * det) / (1.0 + self.R)
        bent = (1.0 - self.omega**2) * self.alpha + 2.0 * self.zeta * self.beta
        return -(self.omega**2) * e12 / (traced + bent * e12)

    @property
    def doubling(self) -> float:
        """Sigma / A at the period doubling, if ``doubling_ratio`` is positive."""
        ratio = self.doubling_ratio
        return self.response / hypot(1.0 - self.alpha * ratio, self.beta * ratio / self.omega)
