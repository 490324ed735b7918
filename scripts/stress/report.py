"""The report of a stress run, as plain values and in words."""

import json
import math
from typing import Any

import numpy as np

from scripts.stress.findings import LISTED, StressFindings
from scripts.stress.result_checks import SUM_LAW

NEVER = (
    "NaN or infinity where none belongs",
    "results that contradict each other",
    "position beyond a stop",
    "crossing missed",
    "a state beyond a stop not recognised",
    "an orbit that the simulator does not close",
)
"""Troubles that must not happen to any cell."""

FAILURES = 1e-4
"""Share of cells that may fail."""


def summary(findings: StressFindings, seconds: float, arguments: dict[str, Any]) -> dict[str, Any]:
    """All findings as plain values; NaN and infinity as None."""

    def listed(kind: str) -> list[dict[str, Any]]:
        return [{"what": what, **cell.facts()} for what, cell in findings.listed.get(kind, [])]

    return {
        **arguments,
        "wall_seconds": round(seconds, 1),
        "cells": findings.cells,
        "kinds": dict(sorted(findings.kinds.items())),
        "processor_seconds": round(findings.seconds, 1),
        "regimes": dict(findings.regimes.most_common()),
        "with_impacts": findings.impacting,
        "sticking": findings.sticking,
        "invalid": dict(findings.invalid.most_common()),
        "uncertain": dict(findings.uncertain.most_common()),
        "failed": dict(findings.stopped.most_common()),
        "failed_share": sum(findings.stopped.values()) / max(1, findings.cells),
        "given_up": findings.counts["given up, said to be undetermined"],
        "never": {kind: findings.counts[kind] for kind in NEVER},
        "checked": dict(sorted(findings.checked.items())),
        "sum_law_broken": findings.counts["sum law broken by a periodic cell"],
        "worst": {
            kind: {"value": value if math.isfinite(value) else None, **cell.facts()}
            for kind, (value, cell) in sorted(findings.worst.items())
        },
        "distributions": {
            kind: dict(zip(("median", "90%", "99%", "max"), np.percentile(values, [50, 90, 99, 100]), strict=True))
            for kind, values in sorted(findings.samples.items())
        },
        "listed": {kind: listed(kind) for kind in sorted(findings.listed)},
    }


def _cell(facts: dict[str, Any]) -> str:
    """A cell by number and parameters; for a random system, its name."""
    name = facts["system"] if isinstance(facts["system"], str) else facts["system"]["name"]
    return f"cell {facts['cell']} of {name}: " + " ".join(f"{p}={value!r}" for p, value in facts["parameters"].items())


def _definition(facts: dict[str, Any]) -> list[str]:
    """The table of a random system on one line, for ``solve_tile``."""
    return [] if isinstance(facts["system"], str) else [f"    system: {json.dumps(facts['system'])}"]


def report(facts: dict[str, Any]) -> str:
    """The summary in words."""
    cells = facts["cells"]

    def counted(counts: dict[str, int]) -> list[str]:
        return [f"  {count:8d}  {100.0 * count / cells:8.4f} %  {what}" for what, count in counts.items()]

    lines = [
        f"Stress report: {cells} random cells, seed {facts['seed']}, at most {facts['max_periods']} periods a cell",
        ", ".join(f"{count} of {kind}" for kind, count in facts["kinds"].items()),
        f"{facts['wall_seconds']:.0f} s wall, {facts['processor_seconds']:.0f} s of processor time to solve; "
        f"{facts['with_impacts']} with impacts, {facts['sticking']} stick",
        "", "Regimes", *counted(facts["regimes"]),
        "", "Invalid, by reason", *counted(facts["invalid"]),
        "", "Chaotic with an uncertain average, by reason", *counted(facts["uncertain"]),
        "", f"Failed, by reason (share {facts['failed_share']:.1e}, goal below {FAILURES:.0e})",
        *counted(facts["failed"]),
        f"  {facts['given_up']:8d}  {100.0 * facts['given_up'] / cells:8.4f} %  given up for their cost, undetermined",
        "", "Must be 0", *(f"  {count:8d}  {kind}" for kind, count in facts["never"].items()),
        f"  {facts['sum_law_broken']:8d}  sum law of a periodic cell off by more than {SUM_LAW:.0e}",
        "", "Checked", *(f"  {count:8d}  {kind}" for kind, count in facts["checked"].items()),
        "", "Worst",
    ]  # fmt: skip
    for kind, worst in facts["worst"].items():
        value = "none" if worst["value"] is None else f"{worst['value']:.3g}"
        lines += [f"  {value:>10}  {kind}", f"              {_cell(worst)}"]
    lines += ["", "Orbits against the independent simulator, in eps x state size x norm of the accumulated Jacobian"]
    for kind, values in facts["distributions"].items():
        lines.append(f"  {kind}: " + ", ".join(f"{name} {value:.3g}" for name, value in values.items()))
    for kind, listed in facts["listed"].items():
        lines += ["", f"{kind} (the first {LISTED})"]
        for one in listed:
            lines += [f"  {one['what']}", f"    {_cell(one)}", *_definition(one)]
    return "\n".join(lines) + "\n"


def table(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """The report's figures in brief, as rows of a table: name, and count or size."""
    cells, regimes, checked, worst = facts["cells"], facts["regimes"], facts["checked"], facts["worst"]

    def per_cent(*names: str) -> str:
        return f"{100 * sum(regimes.get(name, 0) for name in names) / cells:.1f} %"

    def total(*starts: str) -> int:
        return sum(count for what, count in checked.items() if what.startswith(starts))

    def largest(*starts: str) -> float:
        return max((finding["value"] for what, finding in worst.items() if what.startswith(starts)), default=0.0)

    reasons = "".join(f"; {count}: {why}" for why, count in facts["failed"].items())
    rows = [
        ("cells", f"{cells:,}: {', '.join(f'{count:,} {kind}' for kind, count in facts['kinds'].items())}"),
        ("periodic or no impact", per_cent("periodic", "no_impact")),
        ("chaotic", per_cent("chaotic")),
        (f"undetermined within {facts['max_periods']} periods", per_cent("undetermined")),
        ("given up for their cost, of all", f"{100 * facts['given_up'] / cells:.1f} %"),
        ("invalid", per_cent("invalid")),
        ("failed", f"{sum(facts['failed'].values())}{reasons}"),
        *((what, str(count)) for what, count in facts["never"].items()),
        ("section positions checked", f"{total('section positions'):,}"),
        ("impact positions checked", f"{total('impact positions', 'positions at rigid contacts'):,}"),
        ("flights checked", f"{total('flights checked,'):,}"),
        (
            "largest defect of the sum law, periodic cells",
            f"{largest('sum law, periodic'):.1e} in {total('sum law, periodic'):,} cells",
        ),
        ("orbits compared with the simulator", f"{total('orbits compared', 'orbits closed'):,}"),
    ]
    if any(what.startswith("deviation") for what in worst):
        rows.append(("their largest deviation, in eps times the norm of the Jacobian", f"{largest('deviation,'):.1f}"))
    if any(what.startswith("orbit not closed") for what in worst):
        rows.append(("largest gap of a closed orbit, of the state", f"{largest('orbit not closed'):.1e}"))
    return rows
