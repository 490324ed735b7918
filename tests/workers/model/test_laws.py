"""Springs, contacts and friction with a law of segments: orbits to many digits, and random machines by the oracle.

A law is a sum of kinks, F_0 + s_0 x + sum of (s_j - s_(j-1)) max(0, x - x_j): to the oracle a machine has a soft
contact for each vertex, which no code of this package has made.
"""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from click.testing import CliRunner

from atlas.cell.law_check import check_law, finer
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.spec.equation import equation_of
from atlas.spec.spec import Spec
from tests.refusals import refuse
from tests.support.oracle.piecewise import PiecewiseContact
from tests.support.oracle.piecewise.random_machines import random_machine, random_state
from tests.support.oracle.segmented_mass import SegmentedMass
from tests.support.oracle.segmented_mass import simulate as simulate_segments
from tests.support.oracle.smooth import SmoothMass
from tests.support.oracle.smooth import orbit as smooth_orbit
from tests.support.solver_bridge import Array, SolverMotion, follow, machines_of
from tests.workers.kernel.test_hybrid_random import Drawn, assert_few_stop, check_derivative, check_volume, compare
from workers import Settings, solve_tile
from workers.kernel.motion import RUNNING, SIMULTANEOUS
from workers.model import laws
from workers.model.entries import DefinitionError
from workers.model.expression import Expression
from workers.model.mode_table import build_hybrid
from workers.model.oscillator import Oscillator
from workers.model.piecewise_fit import fewest
from workers.model.system import SYSTEMS, System, find_system
from workers.results import INVALID, NO_IMPACT, NO_REASON, PERIODIC

ONE_MASS: dict[str, Any] = {"coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "force": [0.5],
                            "phase": ["pi / 2"]}  # fmt: skip


def chords(law: Any, h: float, low: int, high: int) -> list[list[float]]:
    """The table of a law at multiples of h."""
    return [[i * h, law(i * h)] for i in range(low, high + 1)]


def duffing(h: float, reach: float = 1.2, **changes: Any) -> dict[str, Any]:
    """x'' + .1 x' + law(x) = .5 cos 1.2 t, law chords of x + x^3, x <= .6 with R = .8."""
    steps = round(reach / h)
    spring = {"name": "beam", "row": [1.0], "law": chords(lambda x: x + x**3, h, -steps, steps)}
    stop = {"name": "stop", "gap": [1.0], "upper": 0.6, "restitution": 0.8}
    return ONE_MASS | {
        "name": "duffing", "springs": [spring], "contacts": [stop], "parameters": {"omega": {"default": 1.2}}, **changes
    }  # fmt: skip


def hertz(h: float, **changes: Any) -> dict[str, Any]:
    """x'' + .1 x' + x + 5 (x - .3)^1.5 = .5 cos 1.1 t, chords at depths j h."""
    ball = {"name": "ball", "gap": [1.0], "upper": 0.3, "law": chords(lambda d: 5.0 * d**1.5, h, 0, round(2.0 / h))}
    parameters = {"omega": {"default": 1.1}}
    return ONE_MASS | {"name": "hertz", "stiffness": [[1.0]], "contacts": [ball], "parameters": parameters, **changes}


def orbit_of(definition: dict[str, Any]) -> tuple[dict[str, Array], SolverMotion]:
    """The results of the machine at its defaults, and the turn of its orbit from the state that they tell."""
    found = solve_tile(System.from_mapping(definition), {}, Settings(exponents="spectrum"))
    return found, follow(hybrid_of(definition), found["state"])


def hybrid_of(definition: dict[str, Any]) -> Oscillator:
    """The machine at its defaults, as the kernels run it."""
    system = System.from_mapping(definition)
    values = {p.name: np.array([p.default]) for p in system.parameters}
    hybrid, reasons = build_hybrid(system.definition.machines(values))
    assert reasons[0] == NO_REASON
    return hybrid


def speeds_before(turn: SolverMotion, contact: int) -> list[tuple[float, float]]:
    """When and how fast a contact is reached or left at its stop."""
    return [(event.t, event.rate) for event in turn.events if (event.element, event.index) == ("contact", contact)]


def test_a_spring_of_chords_moves_a_mass_with_a_stop_as_the_published_digits_say() -> None:
    """characteristics.md C1: Newton's method in 30 digits, and central differences of the simulated map."""
    found, turn = orbit_of(duffing(0.1))
    assert (found["regime"], found["period"], found["impacts_upper"]) == (PERIODIC, 1, 1)
    assert found["state"][0] == pytest.approx(0.511928466649658, abs=1e-13)
    [(t, v)] = speeds_before(turn, 0)
    assert t == pytest.approx(0.1083382599737459, abs=1e-13)
    assert v == pytest.approx(0.7943314184722406, abs=1e-13)
    mu = np.linalg.eigvals(turn.jacobian)
    np.testing.assert_allclose(sorted(mu.imag), [-0.082116115417837, 0.082116115417837], atol=1e-12)
    np.testing.assert_allclose(mu.real, -0.61023212451431, atol=1e-12)


def test_a_contact_of_chords_pushes_as_the_published_digits_say() -> None:
    """characteristics.md C2: the same, and DOP853 of the law."""
    found, turn = orbit_of(hertz(0.2))
    assert (found["regime"], found["period"], found["impacts_upper"]) == (PERIODIC, 1, 1)
    assert found["state"][0] == pytest.approx(0.8671794308827634, abs=1e-13)
    left = [pass_ for pass_ in speeds_before(turn, 0) if pass_[1] < 0.0][-1]
    reached = next(pass_ for pass_ in speeds_before(turn, 0) if pass_[0] > left[0])
    assert left[0] == pytest.approx(0.9821054229542983, abs=1e-12)
    assert reached == pytest.approx((5.193585240741768, 1.299091952291305), abs=1e-12)
    mu = np.linalg.eigvals(turn.jacobian)
    np.testing.assert_allclose(mu.real, 0.17407871257306, atol=1e-12)
    np.testing.assert_allclose(sorted(mu.imag), [-0.73112555111322, 0.73112555111322], atol=1e-12)


def test_states_converge_to_those_of_the_smooth_law_as_the_square_of_the_spacing() -> None:
    """characteristics.md C2: DOP853 of the smooth law; error of x(0) over h^2."""
    over = [(float(orbit_of(hertz(h))[0]["state"][0]) - 0.87217559443) / h**2 for h in (0.16, 0.08, 0.04)]
    np.testing.assert_allclose(over, [-0.123, -0.128, -0.134], atol=6e-4)


def test_exponents_add_up_to_what_dampers_and_impacts_take() -> None:
    for definition in (duffing(0.1), hertz(0.2, contacts=[hertz(0.2)["contacts"][0] | {"damping": 0.3}])):
        assert abs(orbit_of(definition)[0]["sum_law_defect"]) < 1e-12


def test_a_spring_is_no_contact() -> None:
    found, _ = orbit_of(duffing(0.1, contacts=[duffing(0.1)["contacts"][0] | {"upper": 3.0}], force=[0.3]))
    assert found["regime"] == NO_IMPACT
    assert (found["impacts_upper"], found["impacts_lower"]) == (0, 0)
    assert not any(name.startswith("beam") for name in found)


def test_a_machine_with_springs_alone_has_orbits_and_counts_no_contacts() -> None:
    definition = duffing(0.1)
    del definition["contacts"]
    found, turn = orbit_of(definition)
    assert (found["regime"], found["impacts_upper"], found["impacts_lower"]) == (PERIODIC, 0, 0)
    assert len(turn.events) > 0


def test_an_odd_law_makes_a_symmetric_orbit() -> None:
    definition = duffing(0.1)
    del definition["contacts"]
    assert orbit_of(definition)[0]["symmetric"]


def test_segments_of_a_spring_that_go_on_are_one() -> None:
    """A table of a straight line is that line: no event, and the same results as stiffness and load to rounding."""
    straight = ONE_MASS | {"name": "line", "contacts": [hertz(0.2)["contacts"][0]], "parameters": {"omega": 1.1}}
    table = [[-1.0, -0.75], [0.0, 0.25], [0.5, 0.75], [2.0, 2.25]]
    found = orbit_of(straight | {"springs": [{"name": "line", "row": [1.0], "law": table}]})[0]
    wanted = orbit_of(straight | {"stiffness": [[1.0]], "load": [-0.25]})[0]
    np.testing.assert_allclose(found["state"], wanted["state"], rtol=1e-12)
    np.testing.assert_allclose(found["spectrum"], wanted["spectrum"], rtol=1e-11)


def test_a_contact_gives_back_what_its_law_takes_in_and_its_damper_takes_the_rest() -> None:
    """Truth: over a turn the force does as much work as dampers take, C v^2 and what the contact loses."""
    definition = hertz(0.2, contacts=[hertz(0.2)["contacts"][0] | {"damping": 0.3}])
    definition["measures"] = {"all": {"velocity": [1.0], "report": ["rms"]}}
    found, _ = orbit_of(definition)
    assert found["damper_loss"] == pytest.approx(0.1 * float(found["all_rms"]) ** 2 * 2.0 * math.pi / 1.1, rel=1e-12)
    assert found["ball_loss"] > 0.0
    # the depth by the energy: of the undamped contact nothing is lost
    assert orbit_of(hertz(0.2))[0]["ball_loss"] == 0.0


def drawn(seed: int) -> Drawn:
    """A random machine whose soft contacts have laws, and of which rows have springs."""
    rng = np.random.default_rng([seed, 51])
    base = random_machine(seed)
    start = random_state(base, seed)
    soft = [contact.restitution is None for contact in base.contacts]
    bare = [replace(contact, release="displacement") for contact in base.contacts]
    bare = [replace(contact, stiffness=0.0) if of else contact for contact, of in zip(bare, soft, strict=True)]
    machine = replace(base, contacts=tuple(bare), phases=tuple(replace(p, contacts=None) for p in base.phases))
    solver, stacked = machines_of([machine]), list(bare)
    tables = [np.zeros((1, 2, 1, 3)) for _ in bare]
    for c in np.flatnonzero(soft):
        table = _table(rng, 0.0, float(base.contacts[c].stiffness))
        _, one = laws.one_sided(table, falls=False)
        tables[c] = np.stack([one, one], axis=1)
        stacked += [_kink(base.contacts[c], x, s) for x, s in _kinks(table[0])]
        stacked[c] = replace(bare[c], stiffness=_slopes(table[0])[0])
    solver = solver._replace(contact_laws=laws.widened(tables, (1, 2)))
    stiffness, load = np.array(machine.stiffness), np.array(machine.load)
    phases = list(machine.phases)
    if seed % 3:
        row, table = np.eye(machine.n)[[int(rng.integers(machine.n))]], _table(rng, -0.6, 4.0, falls=True)
        solver = laws.sprung(solver, row, laws.two_sided(table))
        pull = _slopes(table[0])[0] * np.outer(row[0], row[0])
        push = (table[0, 0, 1] - _slopes(table[0])[0] * table[0, 0, 0]) * row[0]
        stiffness, load = stiffness + pull, load - push
        phases = [
            replace(
                phase,
                stiffness=None if phase.stiffness is None else (np.array(phase.stiffness) + pull).tolist(),
                load=None if phase.load is None else (np.array(phase.load) - push).tolist(),
            )
            for phase in phases
        ]
        stacked += [PiecewiseContact(row[0].tolist(), upper=x, stiffness=s) for x, s in _kinks(table[0])]
    oracle = replace(
        machine, contacts=tuple(stacked), stiffness=stiffness.tolist(), load=load.tolist(), phases=tuple(phases)
    )
    hybrid, reasons = build_hybrid(solver)
    assert reasons[0] == NO_REASON
    return Drawn(hybrid, oracle, start)


def _table(rng: np.random.Generator, begin: float, stiffness: float, falls: bool = False) -> Array:
    """A table (1, V, 2) of 2 to 7 segments over about the reach of motions; one that ``falls`` may do so within."""
    V = int(rng.integers(3, 9))
    x = begin + np.concatenate([[0.0], np.cumsum(rng.uniform(0.02, 0.3, V - 1))])
    slopes = stiffness * rng.uniform(-0.3 if falls else 0.0, 1.0, V - 1)
    slopes[[0, -1]] = np.abs(slopes[[0, -1]])
    first = float(rng.normal() * 0.2) if falls else 0.0
    return np.stack([x, first + np.concatenate([[0.0], np.cumsum(slopes * np.diff(x))])], axis=1)[None]


def _slopes(table: Array) -> list[float]:
    return (np.diff(table[:, 1]) / np.diff(table[:, 0])).tolist()


def _kinks(table: Array) -> list[tuple[float, float]]:
    """Each vertex where the slope changes, and by how much."""
    return list(zip(table[1:-1, 0].tolist(), np.diff(_slopes(table)).tolist(), strict=True))


def _kink(contact: PiecewiseContact, x: float, stiffness: float) -> PiecewiseContact:
    upper = None if contact.upper is None else contact.upper + x
    return PiecewiseContact(contact.row, upper, None if contact.lower is None else contact.lower - x, None, stiffness)


@pytest.mark.parametrize(
    ("seeds", "periods"),
    [(range(6), 2), *(pytest.param(range(k, k + 50), 4, marks=pytest.mark.slow) for k in (100, 150))],
)
def test_random_machines_with_laws_go_where_the_oracle_takes_them(seeds: range, periods: int) -> None:
    """Two rigid contacts at once have no answer: such a cell is failed."""
    assert_few_stop([compare(seed, periods, drawn) for seed in seeds], SIMULTANEOUS)


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(100, 300), marks=pytest.mark.slow)])
def test_derivatives_and_volumes_of_random_machines_with_laws_are_those_of_their_motions(seeds: range) -> None:
    assert sum(check_derivative(seed, drawn) for seed in seeds) >= 0.5 * len(seeds)
    assert sum(check_volume(seed, drawn) for seed in seeds) >= 0.5 * len(seeds)


def segmented(seed: int) -> SegmentedMass:
    """A random mass with a contact that can only push, with friction, or both."""
    rng = np.random.default_rng([seed, 52])
    contact, friction = _table(rng, 0.0, 10.0)[0], np.array([[0.0, 0.0]])
    if seed % 3:
        V = int(rng.integers(3, 7))
        friction = np.stack([np.cumsum(rng.uniform(0.05, 0.5, V)), rng.uniform(0.1, 0.4, V)], axis=1)
        friction[0, 0], friction[-1, 1] = 0.0, friction[-2, 1]
    kinetic = float(friction[0, 1])
    return SegmentedMass(
        c=float(rng.uniform(0.05, 0.3)), k=1.0, A=float(rng.uniform(0.5, 1.5)), omega=float(rng.uniform(0.5, 2.0)),
        contact=[tuple(row) for row in contact.tolist()] if seed % 3 != 1 else (), stop=float(rng.uniform(0.0, 0.5)),
        damping=float(rng.uniform(0.0, 1.0)),
        friction=[tuple(row) for row in friction.tolist()] if seed % 3 else (),
        static=kinetic * float(rng.uniform(1.0, 1.5)), belt=float(rng.uniform(-0.8, 0.8)),
    )  # fmt: skip


def definition_of(mass: SegmentedMass) -> dict[str, Any]:
    contact = {"name": "stop", "gap": [1.0], "upper": mass.stop, "damping": mass.damping, "release": "force"}
    friction = {"name": "belt", "row": [1.0], "static": mass.static, "belt": mass.belt}
    found: dict[str, Any] = ONE_MASS | {
        "name": "mass", "damping": [[mass.c]], "stiffness": [[mass.k]], "force": [mass.A],
        "parameters": {"omega": {"default": mass.omega}},
    }  # fmt: skip
    if mass.contact:
        found["contacts"] = [contact | {"law": [list(row) for row in mass.contact]}]
    if mass.friction:
        found["friction"] = [friction | {"law": [list(row) for row in mass.friction]}]
    return found


def follows(seed: int, periods: int = 3) -> int:
    """Hold a random mass against DOP853 from event to event; how many events it passed."""
    mass = segmented(seed)
    start = [-0.3, 0.9] if mass.belt < 0.5 else [-0.3, -0.2]
    hybrid = hybrid_of(definition_of(mass))
    found = follow(hybrid, start, periods=periods)
    expected, happened = simulate_segments(mass, start, periods)
    assert found.status == RUNNING, seed
    np.testing.assert_allclose(found.state, expected, rtol=0.0, atol=1e-8, err_msg=f"seed {seed}")
    return len(happened)


def test_random_masses_whose_contact_only_pushes_or_that_rub_by_a_law_go_where_dop853_does() -> None:
    assert sum(follows(seed) for seed in range(12)) > 150


@pytest.mark.slow
def test_many_random_masses_with_such_laws_go_where_dop853_does() -> None:
    assert sum(follows(seed) for seed in range(100, 300)) > 2000


def belt(h: float, **more: Any) -> dict[str, Any]:
    """x'' + .1 x' + x + law(|v_r|) sgn v_r = 0 on a belt of speed 1, law chords of .5 + .5 e^(-2 v) at j h up to 4."""
    law = chords(lambda v: 0.5 + 0.5 * math.exp(-2.0 * v), h, 0, round(4.0 / h))
    law.append([5.0, law[-1][1]])
    friction = {"name": "belt", "row": [1.0], "belt": 1.0, "law": law}
    return ONE_MASS | {"name": "belt", "stiffness": [[1.0]], "force": [0.0], "friction": [friction], **more}


@pytest.mark.parametrize(
    ("h", "cycle", "stuck"),
    [(0.5, 6.45097319759493817, 0.161090048268041064), (0.125, 6.43302837374732419, 0.1569760753735405)],
)
def test_a_block_on_a_belt_whose_friction_falls_sticks_and_slips_as_the_published_digits_say(
    h: float, cycle: float, stuck: float
) -> None:
    """characteristics.md C3, cycle and share stuck (of h = .5 by exact pieces in 30 digits: a digit there is wrong)."""
    found = follow(hybrid_of(belt(h, parameters={"omega": {"default": 2.0 * math.pi / cycle}})), [0.9, 1.0])
    np.testing.assert_allclose(found.state, [0.9, 1.0], atol=1e-12)
    friction = [event for event in found.events if event.element == "friction"]
    assert [event.t for event in friction[-2:]] == pytest.approx([cycle * (1.0 - stuck), cycle], abs=1e-12)


WALL = ONE_MASS | {
    "name": "wall", "force": [2.0], "parameters": {"L": {"default": 3.0}, "omega": {"default": 1.5}},
    "contacts": [{"name": "wall", "gap": [1.0], "upper": 1.2, "restitution": 0.8}],
    "springs": [{"name": "beam", "row": [1.0], "law": "y + y**3", "within": 1e-3, "range": ["-L", "2 * L"]}],
}  # fmt: skip


def test_a_cell_tells_how_far_the_expression_of_a_spring_was_used() -> None:
    """The motion reaches from the wall to its lowest point; forces by the expression itself."""
    L = np.array([0.5, 1.5, 3.0])
    found = solve_tile(System.from_mapping(WALL), {"L": L})
    lowest = found["peak_to_peak"] - 1.2
    assert np.all(found["max_impact_speed"] > 1.0) and np.all(lowest > 1.0)
    assert found["beam_reach"] == pytest.approx(lowest, rel=1e-14)
    assert found["beam_range_share"] == pytest.approx(np.maximum(lowest / L, 1.2 / (2.0 * L)), rel=1e-14)
    assert (found["beam_range_share"] > 1.0).tolist() == [True, False, False]
    low, high = np.minimum(lowest, L), 2.0 * L
    met = np.maximum(low, np.minimum(1.2, high))
    met += met**3
    assert found["beam_law_error"] == pytest.approx(1e-3 * (high + high**3) / met, rel=1e-12)


def test_a_cell_tells_how_far_the_expression_of_a_friction_was_used() -> None:
    """A mass that rests on its springs while the belt slides below it at u = .5; the force there is 1 + v - v^2 / 4."""
    friction = {"name": "belt", "row": [1.0], "belt": 0.5, "law": "1 + v - v**2 / 4", "within": 1e-2, "range": 2.0}
    definition = {"name": "belt", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]]}
    found = solve_tile(System.from_mapping(definition | {"friction": [friction]}), {"x": 0.1})
    assert found["regime"] == NO_IMPACT
    assert found["belt_speed"] == pytest.approx(0.5, rel=1e-14)
    assert found["belt_range_share"] == pytest.approx(0.25, rel=1e-14)
    assert found["belt_law_error"] == pytest.approx(1e-2 * 2.0 / (1.5 - 0.5**2 / 4.0), rel=1e-12)


def test_a_cell_tells_how_far_the_expression_of_a_contact_was_used() -> None:
    found = solve_tile("hertz-ball", {})
    depth, reach = found["plane_penetration"], find_system("hertz-ball").definition.contacts[0].range
    assert isinstance(reach, Expression) and reach.constant is not None
    assert found["plane_range_share"] == pytest.approx(depth / reach.constant, rel=1e-14)
    assert found["plane_law_error"] == pytest.approx(2.5e-4 * (reach.constant / depth) ** 1.5, rel=1e-12)


def test_commands_say_in_a_line_how_far_laws_were_used(tmp_path: Path) -> None:
    file, spec, store = tmp_path / "wall.toml", tmp_path / "plane.toml", str(tmp_path / "plane.zarr")
    file.write_text(tomli_w.dumps({"system": WALL}))
    spec.write_text(f'system = "{file}"\n[axes]\nL = {{ values = [0.5, 1.5] }}\nomega = {{ values = [1.5, 1.6] }}\n')
    runner = CliRunner()
    cell = runner.invoke(main, ["point", "--system", str(file), "--set", "L=0.5"])
    share = float(solve_tile(System.from_mapping(WALL), {"L": 0.5})["beam_range_share"])
    line = f"law of beam: beyond its range in 1 cell, up to {share:.3g} of it, where its last segment is used;"
    assert sum(text.startswith(line) for text in cell.stdout.splitlines()) == 1
    fine = runner.invoke(main, ["point", "--system", str(file), "--set", "L=3"])
    assert "law of beam: its segments are off by up to" in fine.stdout and "beyond" not in fine.stdout
    runs = [runner.invoke(main, ["run", str(spec), "-o", store, "--tile", index]) for index in ("0,0", "0,1", "1,0")]
    for shown in (runs[0], runner.invoke(main, ["query", store, "--window", "L=0.5:0.5", "--window", "omega=1.5:1.5"])):
        assert "law of beam: beyond its range in 1 cell, up to" in shown.stdout
    inside = runner.invoke(main, ["query", store, "--at", "L=1.5", "--at", "omega=1.5"])
    assert "law of beam: its segments are off" in inside.stdout and "beyond" not in inside.stdout
    plain = runner.invoke(main, ["point"])
    assert "law of" not in plain.stdout


def test_a_smooth_law_takes_the_fewest_segments_and_is_within_its_bound() -> None:
    """characteristics.md C: n of free vertices, the first of them on the law."""
    for law, end, counts in (
        (lambda d: d**1.5, 1.0, (3, 10, 29, 92)),
        (lambda x: x + x**3, 1.0, (5, 14, 42, 130)),
        (lambda v: 0.5 + 0.5 * np.exp(-2.0 * v), 4.0, (4, 12, 35, 110)),
    ):
        for exponent, count in zip((-2, -3, -4, -5), counts, strict=True):
            table, x = fewest(law, end, 10.0**exponent), np.linspace(0.0, end, 100_001)
            assert len(table) - 1 == count
            assert table[0].tolist() == [0.0, float(law(0.0))]
            assert np.max(np.abs(np.interp(x, *table.T) - law(x))) <= 10.0**exponent * (1.0 + 1e-6)


def test_a_law_by_its_expression_is_that_of_its_table() -> None:
    """Each cell has the segments of its own parameters, whatever its neighbours are."""
    ball = {"name": "ball", "gap": [1.0], "upper": 0.3, "law": "k * d**1.5", "within": 1e-3, "range": 2.0}
    system = System.from_mapping(hertz(0.2, contacts=[ball], parameters={"k": 5.0, "omega": 1.1}))
    found = solve_tile(system, {"k": [5.0, 8.0, 3.0]}, Settings(exponents="spectrum"))
    for i, k in enumerate((5.0, 8.0, 3.0)):
        table = fewest(lambda d, k=k: k * d**1.5, 2.0, 1e-3 * k * 2.0**1.5, 0.0).tolist()
        alone, _ = orbit_of(hertz(0.2, contacts=[hertz(0.2)["contacts"][0] | {"law": table}]))
        np.testing.assert_allclose(found["state"][i], alone["state"], rtol=1e-9)
    assert found["state"][0][0] == pytest.approx(0.87217559443, abs=2e-3)  # of the smooth law


def test_a_spring_by_its_expression_is_odd_where_that_is() -> None:
    spring = {"name": "beam", "row": [1.0], "law": "y + y**3", "within": 1e-3, "range": 1.2}
    definition = duffing(0.1, springs=[spring])
    del definition["contacts"]
    assert orbit_of(definition)[0]["symmetric"]
    line = "pulls back by y + y**3 (21 segments at the defaults, within 0.001 of the largest)"
    assert line in equation_of(System.from_mapping(definition))


def with_law(kind: str, law: Any, **more: Any) -> dict[str, Any]:
    elements = {
        "contacts": {"name": "stop", "gap": [1.0], "upper": 0.3},
        "springs": {"name": "beam", "row": [1.0]},
        "friction": {"name": "belt", "row": [1.0]},
    }
    return ONE_MASS | {"name": "wrong", "stiffness": [[1.0]], kind: [elements[kind] | {"law": law} | more]}


NO_LAWS = [
    (with_law("contacts", [[0, 0]]), "system.contacts[0].law: found '1 rows', must be 2 to 65 rows [d, force]"),
    (with_law("springs", [[0, 0, 1], [1, 1]]), "system.springs[0].law[0]: found 3 numbers, must be 2, y and the force"),
    (with_law("springs", [[0, 0], [0, 1]]), "system.springs[0].law: found y 0 after 0 at the defaults, must increase"),
    (with_law("contacts", [[0.1, 0], [1, 1]]), "system.contacts[0].law: found depth 0.1 in the first row"),
    (with_law("contacts", [[0, 1], [1, 0.5]]), "system.contacts[0].law: found a fall from 1 to 0.5 at the defaults"),
    (with_law("contacts", [[0, -1], [1, 0.5]]), "system.contacts[0].law: found force -1 at the defaults, must be 0"),
    (with_law("friction", [[0, 1], [1, 0.5]]),
     "system.friction[0].law: falls without end from |v| 0 on at the defaults"),
    (with_law("friction", [[0, 1], [1, -1], [2, 3]]), "system.friction[0].law: found force -1 at the defaults, must"),
    (with_law("contacts", [[0, 0], [1, 1]], stiffness=1),
     "system.contacts[0]: found law and stiffness; the law replaces"),
    (with_law("friction", [[0, 1], [1, 1]], kinetic=1), "system.friction[0]: found law and kinetic; the law replaces"),
    (with_law("friction", [[0, 1], [1, 1]], static=0.5), "system.friction[0].static: found 0.5, kinetic 1 at the"),
    (with_law("contacts", "d"), "system.contacts[0]: within missing; a law that is an expression needs its"),
    (with_law("contacts", "d", within=0.1), "system.contacts[0]: range missing; a law that is an expression"),
    (with_law("contacts", [[0, 0], [1, 1]], within=0.1), "system.contacts[0].within: found beside a table, which is"),
    (with_law("contacts", "d", within=0, range=1), "system.contacts[0].law: found no bound or value at the defaults"),
    (with_law("springs", "sqrt(y)", within=0.1, range=1), "system.springs[0].law: found no bound or value at the"),
    (with_law("contacts", "d**2", within=1e-7, range=1),
     " segments at the defaults, must be at most 64; give within = 3.4e-05"),
    (with_law("contacts", "1 - d", within=0.1, range=1), "system.contacts[0].law: found a fall from 1 to"),
    (with_law("contacts", "d", within=0.1, range=1) | {"parameters": {"d": 1.0}},
     "system.contacts[0].law: d is the argument of the law and a parameter; rename the parameter"),
    (with_law("springs", [[0, 0], [1, "k"]]), "system.springs[0].law[1][1]: unknown name 'k'"),
]  # fmt: skip


@pytest.mark.parametrize(("definition", "line"), NO_LAWS, ids=[line for _, line in NO_LAWS])
def test_a_law_that_is_none_gets_one_line(definition: dict[str, Any], line: str) -> None:
    refuse(definition, line)


def test_a_law_among_too_many_elements_gets_one_line() -> None:
    springs = [{"name": f"s{k}", "row": [1.0], "law": [[0, 0], [1, 1]]} for k in range(4)]
    friction = [{"name": f"f{k}", "row": [1.0], "kinetic": 1} for k in range(3)]
    with pytest.raises(DefinitionError, match="found 7 contacts, springs and friction elements, must be at most 6"):
        System.from_mapping(with_law("friction", [[0, 1], [1, 1]]) | {"springs": springs, "friction": friction})


def test_a_cell_whose_law_does_not_reach_0_is_invalid() -> None:
    spring = {"name": "beam", "row": [1.0], "law": "y**3", "within": 1e-3, "range": ["low", 1.0]}
    system = System.from_mapping(
        with_law("springs", "y", within=0.1, range=1) | {"springs": [spring], "parameters": {"low": -1.0}}
    )
    found = solve_tile(system, {"low": [-1.0, 0.5]}, Settings(exponents="none", max_periods=300))
    assert (found["regime"] == INVALID).tolist() == [False, True]


def test_cells_whose_law_takes_too_many_segments_are_invalid() -> None:
    ball = {"name": "ball", "gap": [1.0], "upper": 0.3, "law": "d**1.5", "within": "w", "range": 1.0}
    system = System.from_mapping(hertz(0.2, contacts=[ball], parameters={"w": 1e-3}))
    for w in ([1e-8], [1e-8, 1e-3]):
        found = solve_tile(system, {"w": w}, Settings(exponents="none", max_periods=300))
        assert found["regime"][0] == 5


def test_a_definition_with_laws_is_that_of_its_table() -> None:
    fitted = hertz(0.2, contacts=[{"name": "ball", "gap": [1.0], "upper": 0.3, "law": "d", "within": 0.1, "range": 2}])
    for definition in (duffing(0.1), hertz(0.2), belt(0.5), fitted):
        system = System.from_mapping(definition)
        assert System.from_mapping(system.table()) == system


def plane(law: Any, **more: Any) -> Spec:
    ball = {"name": "ball", "gap": [1.0], "upper": 0.3, "law": law} | more
    system = hertz(0.2, contacts=[ball], force=["A"], parameters={"A": {"default": 0.5, "low": 0.0}})
    axes = {"omega": {"start": 0.8, "stop": 1.6, "num": 5}, "A": {"start": 0.2, "stop": 1.0, "num": 5}}
    return Spec(system, axes=axes)


def test_a_law_is_checked_by_twice_as_many_segments() -> None:
    """Truth: cells of the finer law, solved by themselves."""
    spec = plane("5 * d**1.5", within=1e-2, range=2.0)
    found = check_law(spec, finer(spec), cells=2)
    assert found.segments == {"system.contacts[0].law": (3, 6)}
    assert (found.cells, found.beyond) == (4, 0)
    assert found.state is not None
    change, share, at = found.state
    here, there = (
        solve_tile(plane("5 * d**1.5", within=within, range=2.0).system_def, at)["state"] for within in (1e-2, 2.5e-3)
    )
    assert change == pytest.approx(np.max(np.abs(here - there)), rel=1e-9)
    assert share == pytest.approx(change / np.max(np.abs(here)), rel=1e-9)


@pytest.mark.parametrize(
    ("spec", "line"),
    [
        (plane([[0, 0], [1, 1]]), "hertz: no law is an expression; a law given as a table is exact"),
        (
            plane("d**2", within=1e-4, range=1),
            "system.contacts[0].law: found 71 segments within a quarter of its",
        ),
    ],
)
def test_a_law_that_cannot_be_checked_gets_one_line(spec: Spec, line: str) -> None:
    with pytest.raises(InputError, match=re.escape(line)):
        finer(spec)


@pytest.mark.parametrize("given", ["single-mass", "finer.toml", "points.toml"])
def test_a_check_of_laws_is_refused_before_it_loads_the_kernels(
    given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    axes = "[axes.omega]\nstart = 1\nstop = 2\nnum = 3\n[axes.sigma]\nstart = 0.1\nstop = 1\nnum = 3\n"
    Path("finer.toml").write_text(f'system = "ball.toml"\n{axes}')
    ball = (SYSTEMS / "hertz-ball.toml").read_text().replace("within = 2.5e-4", "within = 1.2e-5")
    Path("ball.toml").write_text(ball.replace('"hertz-ball"', '"ball"'))
    Path("table.csv").write_text("omega\n1.0\n")
    Path("points.toml").write_text('system = "hertz-ball"\n[points]\nfile = "table.csv"\n')
    ended = CliRunner().invoke(main, ["plan", given, "--laws"])
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert ended.stderr.startswith("Error: ") and ended.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_plan_lists_the_cells_that_change_with_twice_the_segments() -> None:
    ended = CliRunner().invoke(main, ["plan", "hertz-ball", "--no-probe", "--laws", "3"])
    assert ended.exit_code == 0, ended.output
    assert "segments at the defaults, compared with" in ended.stdout
    assert " of 9 cells change their class" in ended.stdout


def test_an_odd_law_bends_alike_on_both_sides_whatever_its_range() -> None:
    """The segments that meet at 0 are one, to the last bit: no kink lies where a mass rests."""
    spring = {"name": "beam", "row": [1.0], "law": "y**3", "within": 1e-3, "range": [-2.5, 0.6]}
    system = System.from_mapping(duffing(0.1, springs=[spring]))
    [(_, _, table)] = system.definition.laws({p.name: np.array([p.default]) for p in system.parameters})
    (low, high), x = laws.two_sided(table).stops[0], table[0, :, 0]
    assert low == -high < -0.3
    assert set(x[x > 0.0]) - {0.6} <= set(-x)


SMOOTH = {
    "duffing-stop": lambda p: SmoothMass(
        p["omega"], 2.0 * p["zeta"], p["A"], stop=p["b"], R=p["R"], spring=lambda x: p["k"] * x + p["alpha"] * x**3
    ),
    "hertz-ball": lambda p: SmoothMass(
        p["omega"], 2.0 * p["zeta"], 2.0 / 3.0 * p["sigma"], load=2.0 / 3.0, spring=lambda d: 0.0, stop=0.0,
        push=lambda d: 2.0 / 3.0 * d**1.5,
    ),
    "stribeck-belt": lambda p: SmoothMass(
        p["omega"], 2.0 * p["zeta"], p["A"], belt=p["u"],
        rub=lambda v: p["r"] + (1.0 - p["r"]) * math.exp(-v / p["w"]),
    ),
}  # fmt: skip
"""The packaged machines with laws as they are before the package makes segments of them."""


def of_bounds(system: System, times: float) -> System:
    """A system whose laws have so many times their bounds."""

    def scaled(elements: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(
            element
            if element.within is None
            else replace(element, within=Expression(f"{times} * ( {element.within.text} )"))
            for element in elements
        )

    own = system.definition
    changed = replace(own, contacts=scaled(own.contacts), friction=scaled(own.friction), springs=scaled(own.springs))
    return replace(system, definition=changed)


@pytest.mark.parametrize(
    ("name", "given", "kinds"),
    [
        ("duffing-stop", {"omega": 1.6, "A": 0.8}, "hit"),
        ("duffing-stop", {"omega": 1.25, "A": 0.8}, "hit"),
        ("hertz-ball", {"omega": 0.8, "sigma": 0.5}, "hit open"),
        ("hertz-ball", {"omega": 1.8, "sigma": 1.5}, "hit open"),
        ("stribeck-belt", {"omega": 1.0, "u": 0.5}, "slip stick"),
        ("stribeck-belt", {"omega": 1.6, "u": 0.3}, "slip stick"),
    ],
)
def test_orbits_of_the_packaged_machines_tend_to_those_of_their_smooth_laws(
    name: str, given: dict[str, float], kinds: str
) -> None:
    """Truth: DOP853 and Newton's method. A sixteenth of the bound, a quarter of h: about a sixteenth of the error,
    times what the places of the vertices make of it."""
    system = find_system(name)
    coarse, fine = of_bounds(system, 4.0), of_bounds(system, 0.25)
    mass = SMOOTH[name]({p.name: p.default for p in system.parameters} | given)
    cells = [solve_tile(machine, given, Settings(exponents="none")) for machine in (coarse, system, fine)]
    periods = int(cells[1]["period"])
    state, _, happened = smooth_orbit(mass, cells[-1]["state"], periods)
    assert {kind for _, kind, _ in happened} == set(kinds.split())
    assert [int(cell["period"]) for cell in cells] == [periods] * 3
    far, own, close = (float(np.max(np.abs(cell["state"] - state))) for cell in cells)
    assert own < 0.02
    assert close < 0.35 * far
