"""Claims about the portrait of a cell: its path is the solver's motion, and each panel shows what it says."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import atlas
from atlas import render
from atlas.cell.portrait_data import impact_times, path
from atlas.cell.trajectory import SAMPLES, CellTrajectory, cell_orbit, describe, modulation
from atlas.errors import InputError
from tests import naive
from tests.pictures import orbit
from workers import Settings, trace
from workers.model.system import find_system
from workers.results import CHAOTIC, PERIODIC, QUASIPERIODIC, UNDETERMINED

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def chaotic() -> CellTrajectory:
    return cell_orbit(naive.FIGURES[5], settings=Settings(tolerance=0.1))


@pytest.fixture(scope="module")
def sticking() -> CellTrajectory:
    return cell_orbit(naive.STICKING)


@pytest.fixture(scope="module")
def closed() -> CellTrajectory:
    return cell_orbit(naive.FIGURES[4])


def at_sections(found: CellTrajectory) -> np.ndarray:
    """The states of a path at t = 0, T, 2T."""
    whole = [i for i in range(round(found.times[-1] / found.period) + 1)]
    return found.states[[np.argmin(np.abs(found.times - i * found.period)) for i in whole]]


@pytest.mark.parametrize("which", ["chaotic", "closed", "sticking"])
def test_the_path_goes_through_the_sections_of_the_solver(which: str, request: pytest.FixtureRequest) -> None:
    """Truth: trace, which takes whole periods where the path takes 400 pieces; chaos parts them after some periods."""
    found: CellTrajectory = request.getfixturevalue(which)
    start = dict(zip(("x1", "x2", "v1", "v2"), map(float, found.cell["state"]), strict=True))
    periods = min(3, round(found.times[-1] / found.period))
    history = trace("two-mass", dict(found.parameters) | start, periods)
    assert at_sections(found)[: periods + 1] == pytest.approx(history.states, abs=1e-8)


def test_the_path_has_the_impacts_of_the_solver(chaotic: CellTrajectory) -> None:
    start = dict(zip(("x1", "x2", "v1", "v2"), map(float, chaotic.cell["state"]), strict=True))
    expected = trace("two-mass", dict(chaotic.parameters) | start, 3).impacts
    assert chaotic.impacts[: len(expected)] == pytest.approx(expected, abs=1e-6)


def test_a_velocity_jumps_on_the_stop_and_nowhere_else(chaotic: CellTrajectory) -> None:
    b, R = chaotic.parameters["b"], chaotic.parameters["R"]
    jumps = np.flatnonzero(np.diff(chaotic.times) == 0.0)
    assert len(jumps) == len(chaotic.impacts) > 50
    assert np.abs(chaotic.states[jumps, 0]) == pytest.approx(np.full(jumps.size, b), rel=1e-12)
    assert chaotic.states[jumps + 1, 2] == pytest.approx(-R * chaotic.states[jumps, 2], rel=1e-9)
    steps = np.diff(chaotic.states[:, 2])
    assert np.abs(np.delete(steps, jumps)).max() < 0.1 < np.abs(steps[jumps]).max()


@pytest.mark.parametrize("which", ["chaotic", "closed", "sticking"])
def test_the_path_never_leaves_the_gap(which: str, request: pytest.FixtureRequest) -> None:
    found: CellTrajectory = request.getfixturevalue(which)
    assert np.abs(found.states[:, 0]).max() <= found.parameters["b"] * (1 + 1e-12)


def test_a_mass_at_rest_stays_on_its_stop(sticking: CellTrajectory) -> None:
    resting = (np.abs(sticking.states[:, 0]) == sticking.parameters["b"]) & (sticking.states[:, 2] == 0.0)
    assert np.count_nonzero(resting) / SAMPLES == pytest.approx(float(sticking.cell["stuck_fraction"]), abs=0.02)


def test_a_closed_path_ends_where_it_began(closed: CellTrajectory) -> None:
    assert closed.states[-1] == pytest.approx(closed.states[0], abs=1e-9)
    assert len(closed.section) == 1


def test_a_path_that_is_shorter_than_the_periods_shown_begins_again(closed: CellTrajectory) -> None:
    own = round(closed.times[-1] / closed.period)
    times, states = path(closed, 2 * own + 1)
    assert times[-1] == pytest.approx(3 * own * closed.period)
    assert np.array_equal(states, np.concatenate([closed.states] * 3))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_impacts_beyond_the_path_are_those_of_its_turns(closed: CellTrajectory, side: float) -> None:
    own = round(closed.times[-1] / closed.period)
    once = impact_times(closed, side, own)
    assert len(once)
    thrice = np.concatenate([once + turn * own * closed.period for turn in range(3)])
    assert impact_times(closed, side, 3 * own) == pytest.approx(thrice)


def test_the_running_exponents_approach_the_exact_ones(closed: CellTrajectory) -> None:
    assert closed.has_exact_exponents
    assert np.sort(closed.running[-1])[::-1] == pytest.approx(closed.cell["spectrum"], abs=2e-3)


def test_a_motion_of_very_many_impacts_is_averaged_over_fewer_periods() -> None:
    """Truth: its periods cost over 2000 evaluations each; trace gives up after two million."""
    found = cell_orbit({"omega": 0.3, "b": 0.001, "R": 0.98}, settings=Settings(max_periods=100))
    assert len(found.running) == 100
    assert len(found.impacts) > 500


def test_averages_are_not_called_exact(chaotic: CellTrajectory) -> None:
    assert not chaotic.has_exact_exponents


def test_the_exponents_of_a_periodic_motion_are_exact_by_either_method(closed: CellTrajectory) -> None:
    schedule = cell_orbit(naive.FIGURES[4], settings=Settings(method="fixed", transient_periods=50, periods=50))
    assert schedule.has_exact_exponents
    assert schedule.cell["spectrum"] == pytest.approx(closed.cell["spectrum"], abs=1e-12)


def test_the_digest_is_that_of_the_parameters_and_settings(closed: CellTrajectory) -> None:
    assert closed.digest == cell_orbit(dict(naive.FIGURES[4])).digest
    assert closed.digest != cell_orbit(naive.FIGURES[4] | {"x1": 0.01}).digest


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"omega": 0.0}, "0 < omega"),
        ({"omg": 1.0}, "did you mean 'omega'"),
        ({"x1": 1.0}, "no motion to show: the initial"),
    ],
)
def test_a_cell_without_a_motion_is_refused_in_one_line(given: dict[str, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        cell_orbit(given)


def test_a_motion_is_described_in_words(
    closed: CellTrajectory, chaotic: CellTrajectory, sticking: CellTrajectory
) -> None:
    assert describe(closed) == "periodic, period 1, impacts 2 above and 2 below, symmetric"
    assert describe(chaotic).startswith("chaotic, 2.6")
    assert "at rest on a stop" in describe(sticking)
    assert (closed.cell["regime"], chaotic.cell["regime"]) == (PERIODIC, CHAOTIC)


# The figure


@pytest.fixture(scope="module")
def page() -> Figure:
    return render.figure(orbit())


def test_a_portrait_has_all_its_panels_with_symbols_and_units(page: Figure) -> None:
    found = [(ax.get_xlabel(), ax.get_ylabel()) for ax in page.axes]
    assert found == [
        ("", "$x_1$"),
        ("time $t/T$ [forcing periods]", "$x_2$"),
        ("$x_1$", r"$\dot x_1$"),
        ("$x_2$", r"$\dot x_2$"),
        ("$x_1$", "$x_2$"),
        ("$x_1$ at $t = kT$", r"$\dot x_1$"),
        ("forcing periods averaged over", r"$\lambda_i$ [per forcing period]"),
        ("", ""),
    ]


def test_impacts_are_marked_in_both_histories(page: Figure) -> None:
    for i, ax in enumerate(page.axes[:2]):
        (marks,) = (line for line in ax.lines if line.get_marker() in "^v" and len(line.get_xdata()))
        assert list(marks.get_xdata()) == pytest.approx([0, 1, 2, 3, 4, 5, 6][: len(marks.get_xdata())])
        assert marks.get_ydata()[0] == pytest.approx(orbit().states[0, i])


def test_the_stops_are_drawn_where_they_are(page: Figure) -> None:
    levels = [line.get_ydata()[0] for line in page.axes[0].lines if len(set(line.get_ydata())) == 1]
    assert {-0.15, 0.15} <= set(levels)


def test_exact_exponents_are_written_in_numbers_and_a_lost_one_as_infinite(page: Figure) -> None:
    texts = [text.get_text() for text in page.axes[-1].texts]
    assert texts == [
        "dotted: exact",
        *(rf"$\lambda_{{{i}}} = {v}$" for i, v in ((1, "-0.200000"), (2, "-0.300000"), (3, "-0.500000"))),
        r"$\lambda_{4} = -\infty$",
    ]


def test_exact_exponents_are_lines_that_the_averages_run_into(page: Figure) -> None:
    flat = {round(float(line.get_ydata()[0]), 6) for line in page.axes[6].lines if len(set(line.get_ydata())) == 1}
    assert {-0.2, -0.3, -0.5} <= flat


def test_the_title_names_the_parameters_and_the_motion(page: Figure) -> None:
    title = page.get_suptitle()
    assert r"$\omega = 4$" in title
    assert "period 1, impacts 1 above and 0 below" in title


def test_a_portrait_shows_the_mass_that_is_stopped_and_its_stop() -> None:
    """A chain's is the last: of three masses the first and the third are shown; a stop at infinity is not."""
    chain = find_system("chain-3")
    states = orbit().states[:, [0, 1, 0, 2, 3, 2]]
    found = replace(
        orbit(),
        system=chain,
        parameters={p.name: p.default for p in chain.parameters},
        states=states,
        section=states[:1],
        stops=(-math.inf, 1.0),
    )
    axes = render.figure(found).axes
    assert [ax.get_ylabel() for ax in axes[:2]] == ["$x_{1}$", "$x_{3}$"]
    heights = [[line.get_ydata()[0] for line in ax.lines if line.get_linestyle() == "--"] for ax in axes[:2]]
    assert heights == [[], [1.0]]


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_a_portrait_carries_its_digest(tmp_path: Path, suffix: str) -> None:
    path = render.render(orbit(), tmp_path / f"cell.{suffix}")
    if suffix == "png":
        with Image.open(path) as image:
            assert image.info["Digest"] == orbit().digest
    else:
        assert orbit().digest.encode() in path.read_bytes()


def test_a_portrait_is_drawn_and_written(tmp_path: Path) -> None:
    figure = atlas.portrait({"omega": 4.0, "b": 0.6}, path=tmp_path / "cell.png")
    assert (tmp_path / "cell.png").exists()
    assert "no impact" in figure.get_suptitle()


def test_a_bad_suffix_is_refused_before_anything_is_solved(tmp_path: Path) -> None:
    """Once solved, this cell would be refused for having no motion to show."""
    with pytest.raises(InputError, match=r"possible: \.png, \.svg, \.pdf"):
        atlas.portrait({"x1": 1.0}, path=tmp_path / "cell.gif")


# What a motion needs to be seen


def test_the_modulation_of_a_torus_is_how_long_it_takes_to_come_back() -> None:
    """Truth: the frequencies that the section is made of."""
    k = np.arange(4000)
    for f, expected in ((0.02, 50.0), (1 / 3 + 0.01, 100.0), (0.5 - 0.004, 250.0)):
        assert modulation(np.cos(2 * np.pi * f * k)) == pytest.approx(expected, rel=0.05)
    assert modulation(np.ones(10)) == 1.0


def test_a_torus_is_shown_until_its_modulation_has_come_round() -> None:
    k = np.arange(200)
    found = orbit()
    times = np.linspace(0.0, 60 * found.period, found.times.size)
    torus = replace(
        found,
        cell={**found.cell, "regime": QUASIPERIODIC, "period": 0},
        section=0.1 * np.cos(2 * np.pi * 0.05 * k)[:, None] * np.ones(4),
        times=times,
    )
    assert render.figure(torus).axes[0].get_xlim() == pytest.approx((0.0, 30.0), rel=1e-12)


def test_a_chatter_is_enlarged_and_other_motions_are_not(sticking: CellTrajectory, closed: CellTrajectory) -> None:
    titles = [[ax.get_title(loc="left") for ax in render.figure(drawn).axes] for drawn in (sticking, closed)]
    assert "chatter, enlarged" in titles[0]
    assert "chatter, enlarged" not in titles[1]
    (zoom,) = (ax for ax in render.figure(sticking).axes if ax.get_title(loc="left"))
    impacts = next(line for line in zoom.lines if line.get_marker() in "^v")
    flights = np.diff(impacts.get_xdata())
    assert len(flights) > 3 and (np.diff(flights) < 0).all()
    assert np.ptp(zoom.get_xlim()) < 0.5  # forcing periods


def test_the_exponents_written_of_an_undetermined_cell_are_where_its_curves_end() -> None:
    found = orbit()
    running = np.tile([-0.02, -0.3, -0.5, -0.9], (100, 1))
    cell = {**found.cell, "regime": UNDETERMINED, "spectrum": np.array([0.223, -0.3, -0.5, -0.9])}
    figure = render.figure(replace(found, cell=cell, running=running))
    written = [text.get_text() for text in figure.axes[-1].texts]
    assert written[:2] == ["dotted: averaged\nover 100 periods", r"$\lambda_{1} = -0.020$"]
