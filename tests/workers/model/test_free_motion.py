"""The machines of a system over a few parameters: those of cells."""

import numpy as np
import pytest

from tests.oscillators import rigid_machines
from workers.continuation.families import family_of
from workers.model.build import build
from workers.model.family import NoOscillatorError, machines_over
from workers.model.hybrid_modes import FLYING
from workers.model.oscillator import COLUMN
from workers.model.system import System, find_system, system_names
from workers.results import NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE


def rows_of(system: System, free: tuple[str, ...], count: int) -> np.ndarray:
    defaults = np.array([system.parameter(name).default for name in free])
    return defaults * np.random.default_rng(7).uniform(0.9, 1.1, (count, len(free)))


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("name", [name for name in system_names() if not find_system(name).has_modes])
def test_their_flight_is_that_of_cells_to_rounding_whichever_parameters_are_free(name: str, count: int) -> None:
    system = find_system(name)
    names = [p.name for p in system.parameters if p.name not in system.states]
    for free in ((), (names[0],), tuple(names[:2]), tuple(names[2:4])):
        rows = rows_of(system, free, count)
        values = {p.name: np.full(count, p.default) for p in system.parameters}
        oscillators, _ = system.build_many(values | {name: rows[:, k].copy() for k, name in enumerate(free)})
        family = family_of(system, {}, free)
        family.model(rows[::-1].copy())  # what is kept is of another row
        found, gap = family.model(rows), oscillators.gap
        mode = found.mode(FLYING)
        pairs = [
            (mode.blocks[:, 0, :, : COLUMN.k0], gap.blocks[..., : COLUMN.k0]),
            (mode.waves[:, 0], gap.waves), (mode.numbers[:, 0], gap.numbers), (mode.forced, gap.forced),
            (mode.to_blocks, oscillators.to_blocks), (mode.to_physical, oscillators.to_physical),
            (found.elements.stops[:, 0, 1], oscillators.b_upper), (-found.elements.stops[:, 0, 0], oscillators.b_lower),
            (found.elements.R[:, 0], oscillators.R), (found.tau, oscillators.tau),
        ]  # fmt: skip
        for one, other in pairs:
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-14 * np.max(np.abs(other), initial=0.0))


@pytest.mark.parametrize(
    ("free", "row"),
    [(("omega", "b"), [2.0, -0.1]), (("R", "b"), [1.2, 0.3]), (("omega", "b"), [np.nan, 0.3])],
)
def test_values_out_of_range_are_told_beside_good_ones(free: tuple[str, ...], row: list[float]) -> None:
    system = find_system("two-mass")
    good = rows_of(system, free, 1)[0]
    _, reasons = machines_over(system, {}, free)(np.array([good, row]))
    assert reasons.tolist() == [NO_REASON, OUT_OF_RANGE]


def test_fixed_values_that_make_no_machine_are_told() -> None:
    with pytest.raises(NoOscillatorError, match=r"no oscillator at b = 0\.2"):
        family_of(find_system("two-mass"), {"mu_m": -1.0}, ("b",)).model(np.array([[0.2]]))
    _, reasons = machines_over(find_system("two-mass"), {"zeta": 1e308}, ("b",))(np.array([[0.2]]))
    assert reasons.tolist() == [OUT_OF_DOUBLES]


def test_a_dashpot_along_the_gap_leaves_what_moves_on_a_stop_undamped() -> None:
    """It cannot move there; rounding made its damping negative in some machines, which were refused."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        A = rng.normal(size=(2, 2))
        along = rng.normal(size=2)
        built, reasons = build(
            rigid_machines(
                mass=np.array([A @ A.T + np.eye(2)]), damping=np.array([np.outer(along, along)]),
                stiffness=np.array([np.eye(2)]), gap_row=along[None], force_sin=np.ones((1, 1, 2)),
                force_cos=np.zeros((1, 1, 2)), load=np.zeros((1, 2)), omega=np.ones(1), tau=np.zeros(1),
                upper=np.ones(1), lower=-np.ones(1), R=np.full(1, 0.5),
            )
        )  # fmt: skip
        assert reasons[0] == NO_REASON
        assert built.sticking.blocks[0, 0, 0, 0, COLUMN.eta] == 0.0


def test_a_machine_depends_on_parameters_through_names_too() -> None:
    two_mass = find_system("two-mass").definition
    assert two_mass.changes_with(("omega", "b")) and two_mass.changes_with(("f2",))
    assert not two_mass.changes_with(("omega", "tau", "x1"))
    through = {"name": "named", "let": {"c": "2 * omega", "d": "1 + c"}, "load": [0.0, "d"]}
    named = System.from_mapping(find_system("two-mass").table() | through).definition
    assert named.changes_with(("omega",))


def test_rows_after_some_that_make_no_machine_are_as_before() -> None:
    system = find_system("two-mass")
    good, bad = np.array([[2.0, 0.3], [3.0, 0.2]]), np.array([[2.0, -0.3], [np.nan, 0.2]])
    motions = machines_over(system, {}, ("omega", "b"))
    told = [motions(rows)[1].tolist() for rows in (bad, good, bad, good)]
    assert told == [[OUT_OF_RANGE, OUT_OF_RANGE], [NO_REASON, NO_REASON]] * 2
