"""Random cells of machines with soft and several contacts, friction and phases, each with its own machine."""

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from scripts.stress.findings import RandomCell, StressFindings
from scripts.stress.result_checks import NAMES, NEUTRAL, POSITION, SUM_LAW
from tests.support.oracle.piecewise import PiecewiseMachine, simulate
from tests.support.oracle.piecewise.random_machines import random_machine, random_state
from tests.support.solver_bridge import machines_of
from workers import Settings
from workers.cell.cell_batch import CellBatch
from workers.cell.solve import solve as solve_cells
from workers.model.mode_table import build_hybrid
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, PERIODS_SPENT, QUASIPERIODIC, REASONS, result_variables
from workers.tile import result_arrays

KIND = "modes"

ORBIT_PERIODS, DIGITS = 8, 30
"""Most periods of an orbit for the simulator to close, and its digits."""

CLOSES = 1e-9
"""Largest distance at the end, as a share of the state."""


def draw_of_modes(seed: int, number: int) -> RandomCell:
    """Cell ``number`` of a seed: its own machine and initial state, see random_machines in tests/support."""
    own = 1_000_000 * seed + number
    machine = random_machine(own, switched_elements=number % 2 == 1)
    states = tuple(f"{name}{i + 1}" for name in "xv" for i in range(machine.n))
    params = dict(zip(states, random_state(machine, own), strict=True))
    nothing: Any = machine  # the simulator of these machines has its own type
    return RandomCell(number, KIND, params, nothing, states, (0.0,) * machine.n, math.inf, -math.inf, 0.0)


def solved(cell: RandomCell, settings: Settings) -> dict[str, Any]:
    """The results of a cell."""
    machine: Any = cell.machine
    hybrids, reasons = build_hybrid(machines_of([machine]))
    arrays = result_arrays(result_variables(settings), settings, 1, len(cell.start))
    solve_cells(CellBatch(hybrids, reasons, np.array([cell.start]), settings, arrays))
    return {name: array[0] for name, array in arrays.items()}


def solve(cells: Sequence[RandomCell], settings: Settings) -> StressFindings:
    """Solve cells one by one and check each result."""
    findings = StressFindings()
    for cell in cells:
        begun = time.process_time()
        result = solved(cell, settings)
        seconds, regime, reason = time.process_time() - begun, int(result["regime"]), int(result["reason"])
        findings.cells, findings.seconds = findings.cells + 1, findings.seconds + seconds
        findings.kinds[cell.kind] += 1
        findings.regimes[NAMES[regime]] += 1
        findings.sticking += bool(result["sticks"])
        findings.impacting += bool(result["impacts_per_period"] > 0 or result["sticks"])
        findings.record("periods", float(result["periods_used"]), cell)
        findings.record("seconds", seconds, cell)
        if NAMES[regime] == "failed":
            findings.stopped[REASONS[reason].text] += 1
            findings.record_trouble("failed", REASONS[reason].text, cell)
        elif NAMES[regime] == "undetermined" and reason != PERIODS_SPENT:
            findings.record_trouble("given up, said to be undetermined", REASONS[reason].text, cell)
        for what in contradictions(result):
            findings.record_trouble("results that contradict each other", what, cell)
        if regime in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC):
            _check_state(findings, cell, result)
        if not math.isnan(result["sum_law_defect"]):
            defect = abs(float(result["sum_law_defect"])) / max(1.0, abs(float(np.sum(result["spectrum"]))))
            findings.checked[f"sum law, {NAMES[regime]}, {cell.kind}"] += 1
            findings.record(f"sum law, {NAMES[regime]}, {cell.kind}", defect, cell)
            if regime == PERIODIC and not defect <= SUM_LAW:
                findings.record_trouble("sum law broken by a periodic cell", f"{defect:.2e}", cell)
    return findings


def contradictions(result: dict[str, Any]) -> list[str]:
    """Contradictions among the results of a cell."""
    regime, spectrum, largest = int(result["regime"]), np.asarray(result["spectrum"]), float(result["largest"])
    known = regime in (NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC)
    wrong = {
        "exponents are not in order": known and bool(np.any(spectrum[1:] > spectrum[:-1])) and regime != QUASIPERIODIC,
        "the largest exponent is not the first": regime in (NO_IMPACT, PERIODIC) and largest != spectrum[0],
        "a periodic cell without a period": regime == PERIODIC and int(result["period"]) < 1,
        "a periodic orbit that grows": regime == PERIODIC and largest > NEUTRAL,
        "chaos without growth": regime == CHAOTIC and not largest > 0.0,
    }
    return [what for what, holds in wrong.items() if holds]


def _check_state(findings: StressFindings, cell: RandomCell, result: dict[str, Any]) -> None:
    """Check that numbers exist and no rigid contact is passed."""
    for name in ("state", "error", "stuck_fraction"):
        if not np.all(np.isfinite(result[name])):
            findings.record_trouble("NaN or infinity where none belongs", name, cell)
    if np.any(np.isnan(result["spectrum"])) or np.any(result["spectrum"] == np.inf):
        findings.record_trouble("NaN or infinity where none belongs", f"spectrum {result['spectrum']}", cell)
    machine: Any = cell.machine
    for contact in machine.contacts:
        y = float(np.asarray(contact.row, dtype=float) @ np.asarray(result["state"])[: machine.n])
        for side, stop in contact.stops.items():
            findings.checked["positions at rigid contacts"] += contact.restitution is not None
            if contact.restitution is not None and side * (y - stop) > POSITION * max(1.0, abs(stop)):
                findings.record_trouble("position beyond a stop", f"{side * (y - stop):.2e} beyond", cell)


def recheck(cell: RandomCell, settings: Settings) -> StressFindings:
    """Check that the multiprecision simulator closes the orbit of a cell."""
    findings, result = StressFindings(), solved(cell, settings)
    findings.checked[f"cells re-evaluated, {cell.kind}"] += 1
    period = int(result["period"])
    if int(result["regime"]) != PERIODIC or period > ORBIT_PERIODS:
        return findings
    machine: Any = cell.machine
    start = np.asarray(result["state"])
    apart = _distance(machine, start, period)
    findings.checked[f"orbits closed by the simulator, {cell.kind}"] += 1
    findings.record(f"orbit not closed, {cell.kind}", apart, cell)
    if not apart <= CLOSES:
        findings.record_trouble("an orbit that the simulator does not close", f"{apart:.2e}", cell)
    return findings


def _distance(machine: PiecewiseMachine, start: Any, period: int) -> float:
    """Distance of a motion from its start after these periods, as a share of the state."""
    end = np.array(simulate(machine, start.tolist(), period, digits=DIGITS, rest=1e-8).sections[-1], dtype=float)
    return float(np.linalg.norm(end - start) / max(float(np.linalg.norm(start)), 1e-12))
