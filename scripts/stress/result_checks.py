"""Properties that every solution must have."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from scripts.stress.cells import draw
from scripts.stress.findings import RandomCell, StressFindings
from scripts.stress.systems import draw_of_system
from workers import Settings
from workers.results import CHAOTIC, INVALID, NO_IMPACT, PERIODIC, PERIODS_SPENT, QUASIPERIODIC, REASONS, REGIMES
from workers.tile import solve_tile

Result = Mapping[str, Any]

NAMES = {regime.code: regime.name for regime in REGIMES}
POSITION = 1e-12
"""Share of the clearance by which a position may exceed a stop, besides the rounding of its terms."""
SUM_LAW = 1e-9
"""Defect of the sum law allowed to a periodic cell, in units of ``sum_law_scale``."""
NEUTRAL = 1e-6
"""Largest positive value of the largest exponent of a periodic cell."""


def cells_of(seed: int, of_systems: bool, numbers: Sequence[int]) -> list[RandomCell]:
    """Cells of a seed by number: of random systems, or of the two-mass oscillator."""
    return [(draw_of_system if of_systems else draw)(seed, number) for number in numbers]


def solve(cells: Sequence[RandomCell], settings: Settings) -> StressFindings:
    """Solve cells, those of one table together and others one by one, and check each result."""
    findings = StressFindings()
    for cell, result, seconds in _solved(cells, settings):
        reason = REASONS[int(result["reason"])].text
        _count(findings, cell, result, reason, seconds)
        for trouble in misplaced(cell, result):
            findings.record_trouble("NaN or infinity where none belongs", trouble, cell)
        for trouble in contradictions(cell, result):
            findings.record_trouble("results that contradict each other", trouble, cell)
        _check_positions(findings, cell, result)
        _check_sum_law(findings, cell, result)
    return findings


def _solved(cells: Sequence[RandomCell], settings: Settings) -> Iterator[tuple[RandomCell, Result, float]]:
    """Each cell with its result and its processor time, or its share of the time."""
    for _, group in groupby(cells, key=lambda cell: cell.number if isinstance(cell.system, str) else id(cell.system)):
        together = list(group)
        params = {name: [cell.params[name] for cell in together] for name in together[0].params}
        begun = time.process_time()
        arrays = solve_tile(together[0].system, params, settings)  # type: ignore[arg-type]
        seconds = (time.process_time() - begun) / len(together)
        for k, cell in enumerate(together):
            yield cell, {name: array[k] for name, array in arrays.items()}, seconds


def _count(findings: StressFindings, cell: RandomCell, result: Result, reason: str, seconds: float) -> None:
    regime = NAMES[int(result["regime"])]
    findings.cells += 1
    findings.seconds += seconds
    findings.kinds[cell.kind] += 1
    findings.regimes[regime] += 1
    findings.sticking += bool(result["sticks"])
    findings.impacting += bool(result["impacts_per_period"] > 0 or result["sticks"])
    findings.record("periods", float(result["periods_used"]), cell)
    findings.record("seconds", seconds, cell)
    if regime == "invalid":
        findings.invalid[reason] += 1
    elif regime == "failed":
        findings.stopped[reason] += 1
        findings.record_trouble("failed", reason, cell)
    elif regime == "chaotic" and reason:
        findings.uncertain[reason] += 1
    elif regime == "undetermined" and reason != REASONS[PERIODS_SPENT].text:
        findings.record_trouble("given up, said to be undetermined", reason, cell)
    away = cell.beyond(cell.position(cell.start))
    outside = away > 0.0 and (regime != "invalid" or "beyond a stop" in reason)
    findings.outside += outside
    if outside != (reason == "the initial state lies beyond a stop"):
        findings.record_trouble(
            "a state beyond a stop not recognised", f"{regime}, {reason!r}, {away:.2e} beyond", cell
        )


def _lost(cell: RandomCell, result: Result) -> tuple[int, int]:
    """Least and greatest number of exponents of -infinity: two if it sticks, one or two with impacts of R = 0."""
    regime = int(result["regime"])
    if result["sticks"]:
        return (2 if regime == PERIODIC else 0), 2
    return 0, 2 if cell.params["R"] == 0.0 and regime != NO_IMPACT else 0


def misplaced(cell: RandomCell, result: Result) -> list[str]:
    """Results that are NaN or infinite although their regime promises a number; -infinity as in ``_lost``."""
    regime = int(result["regime"])
    wrong = [name for name, value in result.items() if np.any(np.asarray(value, dtype=float) == np.inf)]
    if regime not in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC):
        return wrong
    least, most = _lost(cell, result)
    lost = int(np.sum(result["spectrum"] == -np.inf))
    promised = ["error", "stuck_fraction", "state", "section"]
    if lost < len(result["spectrum"]):
        promised.append("largest")
    if not result["sticks"]:
        promised.append("impacts_per_period")
        if cell.params["R"] > 0.0 or regime == NO_IMPACT:
            promised.append("sum_law_defect")
    wrong += [name for name in promised if not np.all(np.isfinite(result[name]))]
    if np.any(np.isnan(result["spectrum"])) or not least <= lost <= most:
        wrong.append(f"spectrum {result['spectrum']}")
    if result["impacts_per_period"] > 0.0 and not math.isfinite(result["min_impact_speed"]):
        wrong.append("min_impact_speed")
    return wrong


def contradictions(cell: RandomCell, result: Result) -> list[str]:
    """Contradictions among the results of a cell."""
    regime, spectrum = int(result["regime"]), np.asarray(result["spectrum"])
    upper, lower, rate = int(result["impacts_upper"]), int(result["impacts_lower"]), float(result["impacts_per_period"])
    known = regime in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC)
    largest, period = float(result["largest"]), int(result["period"])
    wrong = {
        "exponents are not in order": known and np.any(spectrum[1:] > spectrum[:-1]) and regime != QUASIPERIODIC,
        "the largest exponent is not the first": regime in (NO_IMPACT, PERIODIC) and largest != spectrum[0],
        "impacts without an impact": regime == NO_IMPACT and (bool(result["sticks"]) or rate != 0.0),
        "a periodic cell without a period": regime == PERIODIC and period < 1,
        "a periodic cell that impacts never": regime == PERIODIC and not result["sticks"] and upper + lower < 1,
        "impact counts of a period do not add up": regime == PERIODIC
        and not result["sticks"]
        and not math.isclose(rate * period, upper + lower),
        "a periodic orbit that grows": regime == PERIODIC and largest > NEUTRAL,
        "chaos without growth": regime == CHAOTIC and not largest > 0.0,
        "impacts on a stop that is not there": known
        and not result["sticks"]
        and ((upper > 0 and cell.upper == math.inf) or (lower > 0 and cell.lower == -math.inf)),
    }
    return [what for what, holds in wrong.items() if holds]


def _check_positions(findings: StressFindings, cell: RandomCell, result: Result) -> None:
    if int(result["regime"]) == INVALID:
        return
    for state in [*result["section"], result["state"]]:
        if not np.all(np.isfinite(state)):
            continue
        findings.checked["section positions"] += 1
        beyond = cell.beyond(cell.position(state))
        terms = sum(abs(share * x) for share, x in zip(cell.gap, state, strict=False))
        if beyond > POSITION * cell.clearance + 4e-16 * len(cell.gap) * terms * (np.count_nonzero(cell.gap) > 1):
            findings.record_trouble(
                "position beyond a stop", f"section {beyond / cell.clearance!r} clearances beyond", cell
            )


def sum_law_scale(cell: RandomCell, result: Result) -> float:
    """Size of the terms in the sum of the exponents, at least 1: trace(M^-1 C) T and 2 ln R per impact."""
    R, hits = cell.params["R"], float(result["impacts_per_period"])
    loss = 2.0 * hits * abs(math.log(R)) if R > 0.0 and hits > 0.0 else 0.0
    return max(1.0, cell.trace * 2.0 * math.pi / cell.params["omega"], loss)


def _check_sum_law(findings: StressFindings, cell: RandomCell, result: Result) -> None:
    defect = abs(float(result["sum_law_defect"]))
    if math.isnan(defect):
        return
    regime = NAMES[int(result["regime"])]
    defect /= sum_law_scale(cell, result)
    findings.checked[f"sum law, {regime}, {cell.kind}"] += 1
    findings.record(f"sum law, {regime}, {cell.kind}", defect, cell)
    if regime == "periodic" and not defect <= SUM_LAW:
        findings.record_trouble("sum law broken by a periodic cell", f"{defect:.2e}", cell)
