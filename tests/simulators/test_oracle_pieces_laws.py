"""The oracle of piecewise-linear machines against the definitions of its elements and the law of volumes."""

import json
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from mpmath import mp

from tests.paths import ROOT
from tests.support.oracle.piecewise import (
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewiseMode,
    monodromy,
    simulate,
)
from tests.support.oracle.piecewise.one_mass import oscillator
from tests.support.oracle.piecewise.random_machines import random_machine, random_state

AT_REST = 1e-11
SHORTEST = 1e-5  # legs of a chatter below this are not looked into


@dataclass
class Watch:
    """An observer that holds each leg against the definitions, by plain sums of forces in double precision."""

    machine: PiecewiseMachine
    time: float = 0.0
    before: np.ndarray | None = None
    checked: int = 0
    rigid_hits: int = 0
    traces: list[tuple[Any, float]] = field(default_factory=list)

    def leg(self, laws: Any, mode: PiecewiseMode, law: Any, series: Any, u: Any, step: Any) -> None:
        machine, n = self.machine.during(self.machine.phases[mode.phase]), self.machine.n
        start, end = (np.array(series.at(at)[: 2 * n], dtype=float) for at in (mp.zero, u))
        if self.before is not None:
            self.check_jump(machine, self.before, start)
        if u * step > SHORTEST:
            for part in (0.2, 0.5, 0.8):
                near = [series.at(u * part + shift)[: 2 * n] for shift in (mp.mpf("-1e-9"), mp.zero, mp.mpf("1e-9"))]
                a = np.array([(p - q) / (mp.mpf("2e-9") * step) for p, q in zip(near[2][n:], near[0][n:], strict=True)])
                z = np.array(near[1], dtype=float)
                self.check(machine, self.time + float(u * step) * part, z[:n], z[n:], a.astype(float))
        self.traces.append((mode, float(u * step)))
        self.time += float(u * step)
        self.before = end

    def check(self, machine: PiecewiseMachine, t: float, x: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """M a - F is made of the forces of held contacts and of sticking friction, and they are within their limits."""
        force = np.array(machine.load, dtype=float) - np.array(machine.stiffness) @ x - np.array(machine.damping) @ v
        for harmonic in machine.forces:
            angle = harmonic.order * machine.omega * t
            force += np.array(harmonic.sin) * math.sin(angle) + np.array(harmonic.cos) * math.cos(angle)
        held: dict[tuple[float, ...], float] = {}  # side of the stop, by row
        stuck: dict[tuple[float, ...], float] = {}  # static friction, by row
        for contact in machine.contacts:
            row = np.array(contact.row, dtype=float)
            for side, stop in contact.stops.items():
                depth, rate = side * (row @ x - stop), side * (row @ v)
                if contact.restitution is not None:
                    assert depth < 1e-12
                    if abs(depth) < AT_REST and abs(rate) < AT_REST:
                        held[tuple(contact.row)] = side
                elif depth > 0:
                    push = contact.preload + contact.stiffness * depth + contact.damping * rate
                    force -= side * row * (max(push, 0.0) if contact.release == "force" else push)
        for friction in machine.friction:
            row = np.array(friction.row, dtype=float)
            slip = row @ v - friction.belt
            if abs(slip) < AT_REST:
                stuck[tuple(friction.row)] = friction.static
            else:
                force -= row * (math.copysign(friction.kinetic, slip) + friction.slope * slip)
        rows = list({**held, **stuck})
        missing = np.array(machine.mass) @ a - force
        forces = np.linalg.lstsq(np.array(rows).T, missing, rcond=None)[0] if rows else np.zeros(0)
        made = np.array(rows).T @ forces if rows else np.zeros_like(missing)
        np.testing.assert_allclose(made, missing, atol=1e-9)
        for row, value in zip(rows, forces, strict=True):
            limit = stuck.get(row, 0.0) + 1e-9
            if row in held:
                assert held[row] * value <= limit
            else:
                assert abs(value) <= limit
        self.checked += 1

    def check_jump(self, machine: PiecewiseMachine, before: np.ndarray, after: np.ndarray) -> None:
        """Between legs nothing moves; velocities jump at rigid stops only, by the laws of impulse and restitution."""
        n = self.machine.n
        np.testing.assert_allclose(after[:n], before[:n], atol=1e-12)
        jump = after[n:] - before[n:]
        if np.abs(jump).max() < 1e-6:
            return
        hit = []
        for contact in machine.contacts:
            row = np.array(contact.row, dtype=float)
            for side, stop in contact.stops.items() if contact.restitution is not None else ():
                if abs(row @ before[:n] - stop) < 1e-10 and side * (row @ before[n:]) > AT_REST:
                    hit.append((row, contact.restitution))
        assert hit
        rows = np.array([row for row, _ in hit])
        impulse = np.array(machine.mass) @ jump
        if len(hit) == 1:
            (row, R), *_ = hit
            share = (row @ impulse) / (row @ row)
            np.testing.assert_allclose(impulse, share * rows[0], atol=1e-9)
            assert row @ after[n:] == pytest.approx(-R * (row @ before[n:]), abs=1e-6)
            self.rigid_hits += 1


def watched(seed: int, periods: int) -> Watch:
    machine = random_machine(seed, switched_elements=seed % 2 == 1)
    watch = Watch(machine)
    period = 2 * math.pi / machine.omega
    state, mode = random_state(machine, seed), None
    for _ in range(periods):
        watch.time = 0.0
        run = simulate(machine, state, mode=mode, digits=30, rest=1e-8, observe=watch.leg)
        assert watch.time == pytest.approx(period, rel=1e-12)
        state, mode = run.sections[-1], run.modes[-1]
    return watch


def test_random_machines_obey_the_definitions_of_their_elements_on_every_leg() -> None:
    watches = [watched(seed, 1) for seed in range(24)]
    assert sum(watch.checked for watch in watches) > 500
    assert sum(watch.rigid_hits for watch in watches) > 20


@pytest.mark.slow
@pytest.mark.parametrize("block", range(8))
def test_many_random_machines_obey_the_definitions_of_their_elements(block: int) -> None:
    for seed in range(400 + 30 * block, 430 + 30 * block):
        watched(seed, 3)


def test_a_machine_survives_json() -> None:
    for seed in range(50):
        machine = random_machine(seed, switched_elements=True)
        assert PiecewiseMachine.of(json.loads(json.dumps(machine.record()))) == machine


def test_a_state_beyond_a_rigid_stop_is_refused() -> None:
    machine = oscillator(1.0, 1.0, contact=PiecewiseContact([1.0], 0.5, restitution=0.5))
    with pytest.raises(ValueError, match=r"contact 0 is 0\.1 beyond its stop"):
        simulate(machine, [0.6, 0.0])


def test_the_oracle_imports_nothing_of_what_it_checks() -> None:
    paths = list((ROOT / "tests" / "support" / "oracle").rglob("*.py"))
    assert len(paths) > 10
    for path in paths:
        assert not any(line.startswith(("from workers", "import workers", "from atlas", "import atlas"))
                       for line in path.read_text().splitlines())  # fmt: skip


# Volumes of the state space


def volume_change(machine: PiecewiseMachine, state: list[float], periods: int) -> float | None:
    """ln |det DP| by the law of sums: what dampers take, and one factor an event; None where a direction is lost.

    -int tr(M^-1 C_mode) dt + sum of ln R^2 over impacts; det S = 1 at all events of soft contacts. No friction.
    """
    watch = Watch(machine)
    run = simulate(machine, state, periods, digits=30, rest=1e-8, observe=watch.leg)
    if any(event.kind == "rest" for event in run.events):
        return None
    inverse = np.linalg.inv(np.array(machine.mass))
    total = 0.0
    for mode, time in watch.traces:
        present = machine.during(machine.phases[mode.phase])
        damping = np.array(present.damping, dtype=float)
        for contact, does in zip(present.contacts, mode.contacts, strict=True):
            damping += contact.damping * np.outer(contact.row, contact.row) * (does[:-1] == "engaged")
        total -= float(np.trace(inverse @ damping)) * time
    for event in run.events:
        if event.kind == "impact":
            total += 2 * math.log(machine.contacts[event.index].restitution)
    return total


@pytest.mark.slow
def test_volumes_change_by_dampers_and_restitution_alone_where_nothing_rubs_or_rests() -> None:
    compared = 0
    for seed in range(120):
        machine = random_machine(seed)
        machine = replace(machine, friction=())
        contacts = tuple(c if c.restitution != 0.0 else replace(c, restitution=0.5) for c in machine.contacts)
        machine = replace(machine, contacts=contacts)
        state = random_state(machine, seed)
        expected = volume_change(machine, state, 1)
        if expected is None:
            continue
        with mp.workdps(50):
            found = float(mp.log(abs(mp.det(monodromy(machine, state, 1)))))
        assert found == pytest.approx(expected, abs=1e-11), seed
        compared += 1
    assert compared > 80


def test_a_turn_changes_volumes_by_the_ratio_of_the_accelerations() -> None:
    """x'' + .1 x' + x + sgn x' = 2 cos .9 t: det S = a_r after / a_r before at each turn."""
    machine = oscillator(0.9, 2.0, friction=PiecewiseFriction([1.0], 1.0, 1.2))
    run = simulate(machine, [2.0, 3.0], span=6.0)
    expected = -0.1 * 6.0
    for event in run.events:
        assert event.kind == "turn"
        applied = 2 * math.cos(0.9 * float(event.t)) - float(event.value)
        expected += math.log((abs(applied) - 1) / (abs(applied) + 1))
    assert run.events
    with mp.workdps(50):
        found = mp.log(mp.det(monodromy(machine, [2.0, 3.0], span=6.0)))
    assert float(found) == pytest.approx(expected, abs=1e-12)
