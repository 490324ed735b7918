"""The benchmark of cells runs, and its cells are what their names say. No time is asserted."""

import subprocess
import sys

import numpy as np
import pytest

from scripts.bench_cell import KINDS, MASSES, cells, measured
from tests.paths import ROOT
from workers.model.system import find_system
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC
from workers.tile import solve_tile


def test_the_cells_are_what_their_kinds_say() -> None:
    regimes = {kind: set(solve_tile("two-mass", cells(kind, 25))["regime"].ravel().tolist()) for kind in KINDS}
    assert regimes["periodic"] == {PERIODIC}
    assert regimes["impact-free"] == regimes["new structure"] == {NO_IMPACT}
    assert CHAOTIC not in regimes["plane of R and zeta"]


def test_both_kinds_of_measure_are_numbers() -> None:
    assert measured({"kind": "periodic", "cells": 9}) > 0.0
    assert np.isfinite(measured({"figure": "3", "exponents": "largest", "cells": 16, "periods": 20}))


@pytest.mark.parametrize("n", MASSES)
def test_a_system_measured_for_its_number_of_masses_has_so_many(n: int) -> None:
    assert len(find_system(MASSES[n]).states) == 2 * n


def test_another_version_answers_in_a_process_of_its_own() -> None:
    command = [sys.executable, str(ROOT / "scripts" / "bench_cell.py"), "--serve"]
    asked = '{"kind": "impact-free", "cells": 4}\n'
    environment = {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, input=asked, env=environment, check=True, capture_output=True, text=True)
    assert float(done.stdout) > 0.0
