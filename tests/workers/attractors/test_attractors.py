"""Claims about all attractors of a cell: which there are, that each motion is put to its own, what is told of it."""

import numpy as np
import pytest

from tests.simulators.test_oracle import FIG3
from workers import Settings, solve_tile
from workers.attractors.cell_attractors import LONGEST_KNOWN
from workers.attractors.coexistence import CoexistenceSearch, solve_attractors
from workers.attractors.initial_states import AttractorSettings, initial_states
from workers.attractors.matching import BATCH, DIFFERENT, FIRST_LOOK, REFERENCE, distance, periods_to_settle
from workers.attractors.search import KnownAttractors
from workers.model.oscillator import make_blocks
from workers.model.system import find_system
from workers.results import CHAOTIC, INVALID, LOCKING, NO_IMPACT, PENDING, PERIODIC

TWINS = {"omega": 2.561, "b": 0.193}
"""Two orbits of period 1, mirror images of each other."""
ONE = {"omega": 1.643, "b": 0.52}
"""One orbit, from wherever one starts."""
SEVERAL = {"omega": 3.88, "b": 0.065}
"""Two pairs of twins."""
CHAOS = {"omega": 1.409, "b": 0.267}
CHAOTIC_TWINS = {"omega": 1.0766, "b": 0.7599}
BRIEF = Settings(max_periods=4000, survival=8000, tolerance=0.05)
STATES = ("x1", "x2", "v1", "v2")


def solved(params: dict, starts: AttractorSettings, settings: Settings | None = None) -> dict[str, np.ndarray]:
    return solve_attractors("two-mass", params, settings, starts)


def states_of(params: dict, starts: AttractorSettings) -> np.ndarray:
    """The initial states of one cell."""
    record = find_system("two-mass")
    values = {p.name: np.array([params.get(p.name, p.default)]) for p in record.parameters}
    own = np.array([[values[name][0] for name in STATES]])
    return initial_states(starts, record.build_many(values)[0], record, own)[0]


def same(one: dict, two: dict) -> bool:
    return all(np.array_equal(one[name], two[name], equal_nan=one[name].dtype.kind == "f") for name in one)


def test_the_coexisting_period_3_of_figure_3_is_found_with_its_share() -> None:
    found = solved(FIG3, AttractorSettings(32))
    assert found["period"][:2].tolist() == [1, 3]
    assert found["regime"].tolist() == [PERIODIC, PERIODIC, NO_IMPACT, PENDING]
    assert found["share_low"][1] < found["share"][1] < found["share_high"][1]
    assert found["share"][:3].sum() == pytest.approx(1.0)


def test_the_initial_state_that_is_known_to_reach_period_3_is_told_to() -> None:
    found = solved({**FIG3, "x1": 0.05, "x2": 0.03, "v1": 0.5, "v2": -0.2}, AttractorSettings(16))
    assert found["period"][found["own_attractor"]] == 3


def test_the_attractor_of_the_own_initial_state_has_the_bits_of_solve_tile() -> None:
    params = {"omega": np.linspace(2.0, 4.0, 5), "b": 0.15}
    plain, found = solve_tile("two-mass", params, BRIEF), solved(params, AttractorSettings(4), BRIEF)
    for k, own in enumerate(found["own_attractor"]):
        for name in set(plain) - {"periods_used", "survived"}:
            assert np.array_equal(found[name][k, own], plain[name][k], equal_nan=plain[name].dtype.kind == "f"), name


@pytest.mark.parametrize("params", [FIG3, TWINS, SEVERAL])
def test_each_initial_state_is_put_where_it_goes_alone(params: dict) -> None:
    """Truth: every one of them solved in full, without knowing of the others."""
    starts = AttractorSettings(24)
    found = solved(params, starts)
    states = states_of(params, starts)
    alone = solve_tile("two-mass", params | dict(zip(STATES, states.T, strict=True)), Settings(section_samples=64))
    count = int(found["attractors"])
    hits = np.zeros(count)
    for k in range(starts.count):
        sections = alone["section"][k][: alone["period"][k]]
        on = [np.abs(sections - found["state"][i]).max(axis=1).min() < 1e-7 for i in range(count)]
        assert sum(on) == 1
        hits[on.index(True)] += 1
    assert found["share"][:count] * starts.count == pytest.approx(hits)


def test_a_cell_does_not_depend_on_those_beside_it() -> None:
    cells = [FIG3 | TWINS, FIG3 | ONE, FIG3 | CHAOS]
    names = cells[0].keys()
    together = solved({name: np.array([cell[name] for cell in cells]) for name in names}, AttractorSettings(8), BRIEF)
    for k, cell in enumerate(cells):
        assert same({name: values[k] for name, values in together.items()}, solved(cell, AttractorSettings(8), BRIEF))


def test_mirror_images_are_paired_and_hit_the_stops_the_other_way_round() -> None:
    found = solved(TWINS, AttractorSettings(16))
    assert found["mirror"][:2].tolist() == [1, 0]
    assert found["impacts_upper"][0] == found["impacts_lower"][1]
    assert found["largest"][0] == pytest.approx(found["largest"][1], rel=1e-9)


def test_two_pairs_of_twins_are_told_apart() -> None:
    mirror = solved(SEVERAL, AttractorSettings(32))["mirror"]
    assert sorted(mirror.tolist()) == [0, 1, 2, 3]
    assert np.all(mirror[mirror] == np.arange(4)) and np.all(mirror != np.arange(4))


def test_a_symmetric_orbit_is_its_own_mirror_image() -> None:
    found = solved(FIG3, AttractorSettings(8))
    assert found["symmetric"][0] and found["mirror"][0] == 0


def test_a_cell_with_one_attractor_is_done_after_half_of_its_initial_states() -> None:
    found = solved(ONE, AttractorSettings(32))
    assert (found["attractors"], found["starts"]) == (1, 16)
    assert found["unseen_share"] == pytest.approx(1.0 - 0.05 ** (1 / 16))


def test_known_attractors_cost_less_than_new_ones() -> None:
    """In periods: sixteen initial states that reach one orbit cost less than as many alone."""
    params = ONE | dict(zip(STATES, states_of(ONE, AttractorSettings(16)).T, strict=True))
    alone = solve_tile("two-mass", params)["periods_used"].sum()
    assert solved(ONE, AttractorSettings(16))["periods_used"] < alone


def test_a_motion_into_a_known_orbit_is_recognised_from_its_sections() -> None:
    record = find_system("two-mass")
    values = {p.name: np.array([ONE.get(p.name, p.default)]) for p in record.parameters}
    cell = CoexistenceSearch(record, values, Settings(), AttractorSettings(1))
    cell.solve()
    search = cell.search(np.zeros(7, dtype=np.int64), states_of(ONE, AttractorSettings(8))[1:])
    search.solve()
    assert search.label.tolist() == [0] * 7
    assert np.all((search.arrival > 0) & (search.arrival <= search.cells.periods_flown))


def test_attractors_beyond_those_kept_are_counted() -> None:
    found, all_of_them = solved(SEVERAL, AttractorSettings(32, keep=1)), solved(SEVERAL, AttractorSettings(32))
    assert found["attractors"] == all_of_them["attractors"] == 4
    assert found["starts_unstored"] == round(32 * all_of_them["share"][1:].sum())
    assert found["share"].tolist() == all_of_them["share"][:1].tolist()


def test_motions_on_one_chaos_are_lumped_and_it_is_said() -> None:
    found = solved(CHAOS, AttractorSettings(8), BRIEF)
    assert (found["attractors"], found["regime"][0]) == (1, CHAOTIC)
    assert found["starts_by_statistics"][0] == found["starts"] - 1
    assert 0.0 < found["statistical_distance"][0] <= DIFFERENT
    assert not found["exact"][0]


def test_chaos_survives_for_the_periods_of_all_its_motions() -> None:
    alone, found = solve_tile("two-mass", CHAOS, BRIEF), solved(CHAOS, AttractorSettings(8), BRIEF)
    others = found["starts_by_statistics"][0] * FIRST_LOOK * BATCH
    assert found["survived"][0] >= alone["survived"] + BATCH * REFERENCE + others


def test_mirror_images_of_a_chaos_are_told_apart_and_paired() -> None:
    found = solved(CHAOTIC_TWINS, AttractorSettings(12), BRIEF)
    assert found["regime"][:2].tolist() == [CHAOTIC, CHAOTIC]
    assert found["mirror"][:2].tolist() == [1, 0]


def test_what_ends_in_an_orbit_is_no_attractor() -> None:
    """Truth: chaos that is seen to end after 8201 periods; where the budget is short it looks chaotic to the end."""
    params = {
        "mu_k": 5, "mu_m": 2, "f2": 0, "b": 0.3, "zeta": 0.005,
        "omega": np.linspace(1.5, 4.5, 60)[35], "R": np.linspace(0.9, 1, 60)[3],
    }  # fmt: skip
    short = Settings(exponents="none", max_periods=2000, survival=20000)
    found = solved(params, AttractorSettings(6), short)
    assert found["regime"][: found["attractors"]].tolist() == [NO_IMPACT]
    assert found["share"][0] + found["undecided"] / found["starts"] == pytest.approx(1.0)


def test_motions_that_lock_onto_a_stop_are_on_one_attractor_without_a_period() -> None:
    """Truth: the load on the table has one phase at which it lets go, so that all follow the same release."""
    found = solve_attractors("bouncing-ball", {"omega": 1.0, "A": 3.3, "R": 0.5}, Settings(), AttractorSettings(8))
    assert (found["attractors"], found["undecided"], found["own_attractor"]) == (1, 0, 0)
    assert (found["regime"][0], found["period"][0], found["share"][0]) == (LOCKING, 0, 1.0)
    assert not found["exact"][0] and found["starts_by_statistics"][0] == 0 and found["mirror"][0] == -1


def test_a_cell_whose_parameters_make_no_sense_is_invalid_in_the_first_place() -> None:
    found = solved({"b": np.array([-1.0, 0.1])}, AttractorSettings(4))
    assert found["regime"][0].tolist() == [INVALID, PENDING, PENDING, PENDING]
    assert found["attractors"].tolist()[0] == 0 and np.isnan(found["share"][0]).all()
    assert found["attractors"][1] > 0


def test_an_initial_state_beyond_a_stop_is_not_counted() -> None:
    found = solved({**FIG3, "x1": 0.2}, AttractorSettings(8))
    assert (found["own_attractor"], found["starts"]) == (-1, 7)


def test_the_schedule_of_the_paper_has_no_attractors() -> None:
    with pytest.raises(ValueError, match='found "fixed"'):
        solved(FIG3, AttractorSettings(4), Settings(method="fixed"))


def test_a_box_of_no_component_is_refused() -> None:
    with pytest.raises(KeyError, match="found y, must be a component of the state: x1, x2, v1, v2"):
        solved(FIG3, AttractorSettings(4, box=(("y", 0.0, 1.0),)))


def test_statistics_put_two_motions_of_one_law_together_and_those_of_two_apart() -> None:
    """Truth: batches drawn from normal laws. Of 2000 comparisons of equal laws none may fail: P(|t| > 5) < 1e-5."""
    rng = np.random.default_rng(0)
    mean = np.array([0.2, 0.1, 1.0, 0.5])
    apart = [
        distance(mean + 0.1 * rng.normal(size=(REFERENCE, 4)), mean + 0.1 * rng.normal(size=(FIRST_LOOK, 4)))
        for _ in range(2000)
    ]
    assert max(apart) < DIFFERENT
    other = mean + np.array([0.25, 0.0, 0.0, 0.0])
    assert distance(mean + 0.1 * rng.normal(size=(64, 4)), other + 0.1 * rng.normal(size=(16, 4))) > DIFFERENT


def test_the_distance_is_the_largest_difference_of_means_over_its_standard_error() -> None:
    one, two = np.array([[1.0, 2.0], [3.0, 2.0]]), np.array([[5.0, 2.0], [7.0, 2.0]])
    assert distance(one, two) == pytest.approx(4.0 / np.sqrt(2.0 * (0.5 + 0.5)))


def test_a_motion_is_settled_from_where_its_sections_return_after_a_turn() -> None:
    sections = np.zeros((9, 1, 2))
    sections[:, 0, 1] = [9.0, 9.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0]  # period 2 from the third on
    assert periods_to_settle(make_blocks(np.zeros(1), np.ones(1)), sections, 20, 2) == 20 - 6


def test_the_cells_of_one_batch_know_their_attractors_apart() -> None:
    record = find_system("two-mass")
    cells = [FIG3 | {"b": b} for b in (0.1, 0.193)]
    cells = [FIG3, FIG3 | {"b": 0.193}]
    values = {p.name: np.array([cell.get(p.name, p.default) for cell in cells]) for p in record.parameters}
    both = CoexistenceSearch(record, values, Settings(), AttractorSettings(8))
    both.solve()
    assert all(len(cell.attractors) >= 1 for cell in both.cells)
    assert sum(len(a.starts) for cell in both.cells for a in cell.attractors) == both.starts_tried.sum()


def test_motions_are_compared_with_the_orbits_of_their_own_cell_by_the_contraction_of_a_turn() -> None:
    """1 - exp(p times the largest exponent), of motion without impact too; longer orbits are left to a new proof."""
    record = find_system("two-mass")
    values = {
        p.name: np.array([(FIG3 | {"b": b}).get(p.name, p.default) for b in (0.1, 0.193)]) for p in record.parameters
    }
    both = CoexistenceSearch(record, values, Settings(), AttractorSettings(32))
    both.solve()
    of_cells = [cell.attractors for cell in both.cells]
    known = KnownAttractors(both.oscillators, of_cells)
    assert {a.regime for a in known.attractors} == {PERIODIC, NO_IMPACT}
    for c, attractors in enumerate(of_cells):
        compared = known.places[known.orbits.first[c] : known.orbits.last[c]]
        assert [known.attractors[k] for k in compared] == [a for a in attractors if a.period <= LONGEST_KNOWN]
    for place, contraction in zip(known.places, known.orbits.contraction, strict=True):
        found = known.attractors[place]
        assert contraction == pytest.approx(1.0 - np.exp(found.result["largest"] * found.period), rel=1e-12)
