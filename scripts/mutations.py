# ruff: noqa: E501  (a mutation is a row)
"""One-line mistakes put into the code one at a time: which of them does a test notice?

Usage: python -m scripts.mutations [PART ...] [--list] [--minutes M] [--limit S] [--trust]

PART chooses the mutations whose file's path contains it, such as atlas/store or workers/kernel; all by default. A
mutation is made in a copy of its package in a temporary folder, which the tests import in place of the checkout's, so
that nothing in the checkout changes. The tests named beside it are run until the first fails: the mutation is caught,
and the test is printed. Tests that run longer than ``--limit`` seconds are stopped: the mutation may have made a loop
endless, or the machine is busy. Before, the tests have to pass without it, unless ``--trust`` says that they do. No new
mutation begins after ``--minutes``. Each of workers/ compiles all kernels that its tests need. The exit code is 1 if a
mutation is missed or stopped, or is stale: its line is not in its file once. ``--list`` finds the stale ones.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tests.support import ROOT

CAUGHT, MISSED, STOPPED, STALE, UNTRIED = "caught", "missed", "stopped", "stale", "not tried"
NONE_SELECTED = 5
"""Exit code of pytest if its files hold no test that is not slow: their slow ones run in its place."""


class Mutation(NamedTuple):
    """A text that stands once in a file of atlas/ or workers/, what it becomes, and the tests that should notice."""

    file: str
    old: str
    new: str
    tests: str


MUTATIONS = tuple(
    Mutation(*row)
    for row in (
        ("atlas/formatting.py", "if total < 3600:", "if total < 360:", "interface/test_text.py"),
        ("atlas/argument_checks.py", "and int(n) >= 1 for n in sizes", "and int(n) >= 0 for n in sizes", "interface/test_arguments.py"),
        ("atlas/spec/cells.py", "if not edges[0] <= value <= edges[-1]:", "if not edges[0] < value < edges[-1]:", "query/test_query.py spec/test_axes.py"),
        ("atlas/spec/cells.py", "[2.0 * points[0] - middle[0]], middle", "[points[0]], middle", "query/test_query.py spec/test_axes.py"),
        ("atlas/spec/extension.py", "share = k / factor", "share = (k - 0.5) / factor", "service/test_extend.py"),
        ("atlas/spec/extension.py", "np.abs(new - near) <= SAME", "np.abs(new - near) < 0 * SAME", "service/test_extend.py"),
        ("atlas/spec/axis.py", 'if scale == "log" and min(start, stop) <= 0:', 'if scale == "log" and max(start, stop) <= 0:', "spec/test_axes.py spec/test_spec.py"),
        ("atlas/store/tiling.py", "columns.get(column, none)", "columns.get(column, 0)", "store/test_tiling.py store/test_store.py store/test_metadata_damage.py"),
        ("atlas/store/record_format.py", "(by_regime == sizes) & (by_reason == sizes)", "by_regime == sizes", "store/test_tile_records.py"),
        ("atlas/store/record_format.py", "digest.update(variable.name.encode())", "pass", "store/test_tile_records.py"),
        ("atlas/store/record_format.py", "row[CELLS] = np.bincount(places,", "row[CELLS] = np.bincount(places[:-1],", "store/test_tile_records.py"),
        ("atlas/overview/levels.py", "> self.min_side:", ">= self.min_side:", "overview/test_overview.py"),
        ("atlas/overview/levels.py", "min((i + 1) * c, n)", "(i + 1) * c", "overview/test_overview.py overview/test_stacks.py"),
        ("atlas/overview/coarsen.py", "np.where(periodic, arrays[name], 0)", "np.where(solved, arrays[name], 0)", "overview/test_overview.py"),
        ("atlas/overview/coarsen.py", "(largest > 0).astype", "(largest >= 0).astype", "overview/test_overview.py"),
        ("atlas/service/tile_order.py", "np.argsort(-guess,", "np.argsort(guess,", "service/test_tile_order.py"),
        ("atlas/service/tile_order.py", "weights=1 / distance", "weights=distance", "service/test_tile_order.py"),
        ("atlas/query/window.py", "if not 1 <= len(names) <= MAX_AXES:", "if not 1 <= len(names):", "query/test_view.py query/test_query.py"),
        ("atlas/orbits/curves/distance.py", "if point[axis] == end:", "if point[axis] != end:", "orbits/curves/test_cycle_planes.py"),
        ("atlas/orbits/curves/settings.py", "or value < 1:", "or value < 0:", "orbits/curves/test_curves_table.py interface/test_arguments.py orbits/curves/test_curves_search.py"),
        ("atlas/orbits/curves/passages.py", "chord] <= ONE_CELL", "chord] <= 2 * ONE_CELL", "orbits/curves/test_curves_onward.py"),
        ("atlas/orbits/stored_orbits.py", "if half is not orbit:", "if False:", "orbits/test_stored.py"),
        ("atlas/orbits/labels/table.py", "alone=int(np.sum(cells == 1))", "alone=int(np.sum(cells <= 2))", "orbits/labels/test_labels.py orbits/labels/test_labelling.py"),
        ("atlas/orbits/labels/components.py", "if len(roots) > 1:", "if len(roots) > 2:", "orbits/labels/test_labels.py orbits/labels/test_labelling.py"),
        ("atlas/orbits/branches/from_cell.py", "if not low <= seed.values[along] <= high:", "if not low <= high:", "orbits/branches/test_branch_cells.py"),
        ("atlas/orbits/branches/table.py", "if len(current_row) == len(before) > 1:", "if len(current_row) == len(before) > 2:", "orbits/branches/test_branch_pictures.py orbits/branches/test_branch_cells.py"),
        ("atlas/robustness/linear_measures.py", "-1.0 / largest", "-2.0 / largest", "robustness/test_robustness.py"),
        ("atlas/robustness/norm.py", "if weight <= 0.0:", "if weight < 0.0:", "robustness/test_robustness.py"),
        ("atlas/robustness/stored_cells.py", "if shock.reached >= 0 else", "if shock.reached > 0 else", "robustness/test_measure_store.py::test_shocks_of_a_store_are_those_of_single_cells"),
        ("atlas/cell/point_command.py", "if value != field.default:", "if value == field.default:", "interface/test_cli.py query/test_query.py explore/test_cell.py"),
        ("atlas/cell/portrait_data.py", "turns = max(1, -(-count // _span(orbit)))\n    times", "turns = 1\n    times", "render/test_portrait.py"),
        ("atlas/render/text.py", "1e-12 and 0 < abs(times) <= 12", "1e-12 and 0 < abs(times) <= 1", "render/test_maps.py"),
        ("atlas/explore/lattice.py", "np.log(values / low) / np.log(high / low)", "(values / low) / (high / low)", "explore/test_viewport.py"),
        ("atlas/render/scales.py", "(0.5 / high) * clipped + 0.5)", "(0.5 / high) * clipped + 0.4)", "render/test_render.py"),
        ("atlas/render/layout.py", "if not low < high:", "if not low <= high:", "render/test_maps.py"),
        ("workers/results.py", '"rigid_mode", INVALID', '"rigid_mode", FAILED', "workers/model/test_systems.py"),
        ("workers/model/chain.py", "*([0.0] * (n - 1))]", "*([1.0] * (n - 1))]", "workers/model/test_systems.py"),
        ("workers/model/system.py", "[contact.rigid for contact in definition.contacts] != [True]", "True", "workers/model/test_systems.py workers/kernel/test_hybrid_laws.py"),
        ("workers/model/parse_force.py", "if order * turns > HIGHEST:", "if order > HIGHEST:", "workers/model/test_forces.py"),
        ("workers/model/parse_force.py", "if count > HARMONICS:", "if count > 2 * HARMONICS:", "workers/model/test_forces.py workers/model/test_systems.py"),
        ("workers/model/expression.py", "if len(text) > MAX_LENGTH and", "if len(text) > 2 * MAX_LENGTH and", "workers/model/test_expression.py"),
        ("workers/model/definition_checks.py", "not 0.0 <= number <= GREATEST_R:", "not 0.0 <= number <= GREATEST_R + 0.1:", "workers/model/test_systems.py workers/model/test_elements.py"),
        ("workers/model/parse_definition.py", "if not parameter.low <= parameter.high:", "if not parameter.low <= 2 * parameter.high:", "workers/model/test_systems.py"),
        ("workers/model/laws.py", "-np.inf, max(-low, high)", "-np.inf, high", "workers/model/test_laws.py"),
        ("workers/model/block_decomposition.py", "np.abs(lam) <= FREE * n", "np.abs(lam) <= 0.0 * n", "workers/model/test_modes.py"),
        ("workers/kernel/flow.py", "near = x > -0.1", "near = x > -10.0", "workers/kernel/test_flight.py"),
        ("workers/kernel/contact.py", "return REST if load > 0.0 else LEAVE", "return REST", "workers/kernel/test_impact.py"),
        ("workers/kernel/chatter.py", "2.0 * w / (load * (1.0 - R))", "2.0 * w / (load * (1.0 + R))", "workers/kernel/test_chatter.py"),
        ("workers/kernel/linalg.py", "for k in range(size - 1, -1, -1):", "for k in range(size - 1, 0, -1):", "workers/orbit/test_section.py workers/kernel/test_orbits.py"),
        ("workers/kernel/tangent.py", "if norm == 0.0:", "if norm < 0.0:", "workers/kernel/test_frame.py workers/kernel/test_exponents.py"),
        ("workers/kernel/elementary.py", "fma(r * r, p, r)", "fma(r * r, p, 1.0000001 * r)", "workers/kernel/test_elementary.py"),
        ("workers/kernel/signal.py", "rigid = lam == 0.0", "rigid = lam < 0.0", "workers/kernel/test_flight.py"),
        ("workers/kernel/lanes/rounds.py", "(1.0 - r * r) * (speed * speed) if hit", "(1.0 - r) * (speed * speed) if hit", "workers/cell/test_impact_speeds.py"),
        ("workers/orbit/newton.py", "if not (arrived and residual <= 0.5 * best.residual):", "if not arrived:", "workers/orbit/test_orbit_proofs.py"),
        ("workers/orbit/escape.py", "MARGIN = 1.0 + 1e-12", "MARGIN = 1.0 - 1e-3", "workers/orbit/test_escape.py"),
        ("workers/orbit/floquet.py", "coupling = max(coupling, abs", "coupling = min(coupling, abs", "workers/cell/test_floquet.py"),
        ("workers/cell/exponents.py", "-oscillator.trace * oscillator.period + np.where", "-oscillator.trace + np.where", "workers/cell"),
        ("workers/cell/exponents.py", "j + np.where(j < size,", "j + 1 + np.where(j < size,", "workers/cell/test_dimension.py"),
        ("workers/cell/ranges.py", "closed = gap.sin_part.shape[1] == 1", "closed = True", "workers/kernel/test_range.py"),
        ("workers/cell/averages.py", "(mean > CLEAR * error)", "(mean > 0.1 * CLEAR * error)", "workers/cell"),
        ("workers/attractors/initial_states.py", "(y > lower[k]) & (y < upper[k])", "y < upper[k]", "workers/attractors/test_starts.py"),
        ("workers/attractors/matching.py", "if apart < nearest:", "if apart > nearest:", "workers/attractors/test_attractors.py"),
        ("workers/sweep.py", "if not -len(shape) <= axis < len(shape):", "if not axis < len(shape):", "service/test_continuation.py"),
    )
)  # fmt: skip


def is_stale(mutation: Mutation) -> bool:
    """Whether the text of a mutation does not stand in its file once."""
    path = ROOT / mutation.file
    return not path.exists() or path.read_text(encoding="utf-8").count(mutation.old) != 1


def outcome(mutation: Mutation, folder: Path, limit: float) -> tuple[str, str]:
    """Whether the tests notice a mutation: CAUGHT, MISSED or STOPPED, and the first test that fails."""
    package = mutation.file.split("/")[0]
    shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    text = (ROOT / mutation.file).read_text(encoding="utf-8")
    (folder / mutation.file).write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
    return run_tests(mutation.tests, folder, limit)


def run_tests(tests: str, folder: Path, limit: float) -> tuple[str, str]:
    """MISSED if tests pass with the packages of a folder, if it has any; SystemExit if none could run."""
    paths = [f"tests/{name}" for name in tests.split()]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
    command += [f"--basetemp={folder / 'tests'}", "-o", f"pythonpath={folder} {ROOT}", *paths]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))}
    if (folder / "workers").exists():
        environment["NUMBA_CACHE_DIR"] = str(folder / "kernels")

    def run() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=ROOT, env=environment, timeout=limit, capture_output=True, check=False, text=True
        )

    try:
        done = run()
        if done.returncode == NONE_SELECTED:
            command[command.index("not slow")] = "slow"
            done = run()
    except subprocess.TimeoutExpired:
        return STOPPED, f"after {limit:g} s"
    if done.returncode not in (0, 1, 2):  # 2: a module cannot even be imported
        raise SystemExit(f"{tests}: pytest ended with {done.returncode}\n{done.stdout[-2000:]}")
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return (CAUGHT, " ".join(failed[:1])) if done.returncode else (MISSED, "")


def main() -> int:
    """Try the mutations and print the outcome of each; 1 if one is missed, stopped or stale."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", help="of the path of a file; default: all")
    parser.add_argument("--list", action="store_true", help="print the mutations and try none")
    parser.add_argument("--minutes", type=float, default=60.0, help="after which no mutation begins")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds for the tests of one mutation")
    parser.add_argument("--trust", action="store_true", help="do not run the tests without the mutation before")
    given = parser.parse_args()
    end, sound = time.monotonic() + 60.0 * given.minutes, set[str]()
    counts = dict.fromkeys((CAUGHT, MISSED, STOPPED, STALE, UNTRIED), 0)
    for mutation in MUTATIONS:
        if given.part and not any(part in mutation.file for part in given.part):
            continue
        became, by = STALE if is_stale(mutation) else UNTRIED, ""
        if became == UNTRIED and not given.list and time.monotonic() < end:
            if not given.trust and mutation.tests not in sound:
                with TemporaryDirectory(prefix="mutations-") as folder:
                    if run_tests(mutation.tests, Path(folder), given.limit)[0] != MISSED:
                        raise SystemExit(f"{mutation.tests}: fails without a mutation")
                sound.add(mutation.tests)
            with TemporaryDirectory(prefix="mutations-") as folder:
                became, by = outcome(mutation, Path(folder), given.limit)
        counts[became] += 1
        print(f"{became}: {mutation.file}: {mutation.old!r} -> {mutation.new!r}  ({by or mutation.tests})", flush=True)
    print(", ".join(f"{count} {name}" for name, count in counts.items()))
    return 1 if counts[MISSED] or counts[STOPPED] or counts[STALE] else 0


if __name__ == "__main__":
    sys.exit(main())
