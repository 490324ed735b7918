"""What an explorer looks at: levels of an axis, tiles of a view, the cells in view as a dataset; nothing is solved."""

from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import NoReturn

import numpy as np
import pytest

import atlas
from atlas.errors import InputError
from atlas.explore.compose import compose_view, seen_atlas
from atlas.explore.explorer import Explorer
from atlas.explore.jobs import ServiceState as Work
from atlas.explore.lattice import Lattice
from atlas.explore.live.page import page_of
from atlas.explore.picture_renderer import PictureRenderer, RenderedPicture
from atlas.explore.plane_message import maps_of
from atlas.explore.subject import PlaneParameters, Subject, exploration_settings, subject_of
from atlas.explore.text import first_compile_notice, mathtext_to_unicode, progress, refinement
from atlas.explore.tile_cache import MemoryTileCache, TileCache
from atlas.explore.view_state import from_address, initial_view, kinds, overlays
from atlas.explore.viewport import STAGES, TILE_CELLS, TileKey
from atlas.orbits.curves.queries import curves_of
from atlas.orbits.curves.table import write_curves
from atlas.spec.axis import Axis
from atlas.spec.cells import edges_of, nearest
from atlas.spec.toml_text import spec_toml
from atlas.store.store import open_store
from atlas.task.compile import ATTRACTORS
from tests.explore.messages import to_address
from tests.pictures import curves
from workers.results import PENDING, REGIME, empty_results, result_variables

LINEAR = Lattice(Axis("omega", tuple(np.linspace(2.0, 4.0, 101).tolist())))
LOG = Lattice(Axis("b", tuple(np.geomspace(0.01, 1.0, 51).tolist()), "log"))
UNEVEN = Lattice(Axis("omega", (1.0, 1.5, 3.0, 3.1)))
each_lattice = pytest.mark.parametrize("lattice", [LINEAR, LOG, UNEVEN], ids=["linear", "log", "uneven"])


@pytest.fixture(scope="module")
def subject() -> Subject:
    spec = atlas.Spec(
        "two-mass", {"omega": {"start": 2, "stop": 4, "num": 101}, "b": {"start": 0.1, "stop": 0.5, "num": 81}}
    )
    return Subject(spec, exploration_settings(spec.settings))


@each_lattice
def test_points_of_level_zero_are_those_of_the_axis_to_the_bit(lattice: Lattice) -> None:
    index = np.arange(len(lattice.axis))
    assert lattice.values(0, index).tolist() == list(lattice.axis.values)


@each_lattice
@pytest.mark.parametrize("level", [0, 1, 7, 20])
def test_a_point_has_the_same_bits_at_the_next_level(lattice: Lattice, level: int) -> None:
    index = np.arange(-50, 200, dtype=np.int64) * 3
    assert lattice.values(level, index).tolist() == lattice.values(level + 1, 2 * index).tolist()


@each_lattice
@pytest.mark.parametrize("level", [0, 3, 20, "deepest"])
def test_points_rise_strictly_at_every_level(lattice: Lattice, level: int | str) -> None:
    depth = lattice.deepest if level == "deepest" else int(level)
    middle = (len(lattice.axis) - 2) << depth
    values = lattice.values(depth, np.arange(middle - 40, middle + 40, dtype=np.int64))
    assert np.all(np.diff(values) > 0)


@each_lattice
def test_positions_are_the_inverse_of_values_to_a_thousandth_of_a_cell_a_million_times_deeper(lattice: Lattice) -> None:
    index = (np.int64(1) << 20) + np.arange(100, dtype=np.int64)
    assert np.abs(lattice.positions(lattice.values(20, index)) * 2.0**20 - index).max() < 1e-3


@each_lattice
def test_the_cell_that_is_marked_at_a_point_is_the_one_whose_numbers_are_read_there(lattice: Lattice) -> None:
    """The page marks by its lattice, and stores are read by the edges of their cells."""
    axis, low, high = lattice.axis, *lattice.ends
    values = np.array(axis.values)
    edges = edges_of(values, axis.scale == "log")
    for value in np.random.default_rng(5).uniform(low, high, 400):
        assert nearest(axis.name, values, edges, value) == lattice.nearest(0, value)


def test_cells_in_view_are_between_one_and_two_pixels_wide() -> None:
    for pixels in (100, 333, 640, 1000):
        cells = 100 * 2.0 ** LINEAR.level(2.0, 4.0, pixels)
        assert 0.84 <= pixels / cells <= 2.0


def test_an_axis_of_one_point_cannot_be_explored() -> None:
    with pytest.raises(InputError, match="axis omega: found one point, must have two or more to be explored"):
        Lattice(Axis("omega", (1.0,)))


def test_the_tiles_of_each_stage_are_of_its_level_and_come_from_the_centre_out(subject: Subject) -> None:
    sight = subject.viewport((2.3, 2.9), (0.2, 0.3), (640, 480))
    levels = [{key.level_x for key in sight.tiles(stage)} for stage in range(STAGES + 1)]
    assert levels == [{sight.x.level - stage} for stage in range(STAGES + 1)]
    finest = sight.tiles(0)
    middle = 0.5 * (sight.x.first + sight.x.last), 0.5 * (sight.y.first + sight.y.last)
    height, width = sight.shape
    away = [
        np.hypot(((k.x + 0.5) * TILE_CELLS - middle[0]) / width, ((k.y + 0.5) * TILE_CELLS - middle[1]) / height)
        for k in finest
    ]
    assert away == sorted(away)


def test_tiles_of_the_full_density_cover_each_cell_in_view_once(subject: Subject) -> None:
    sight = subject.viewport((2.3, 2.9), (0.2, 0.3), (640, 480))
    for stage in range(STAGES + 1):
        covered = np.zeros(sight.shape, int)
        for key in sight.tiles(stage):
            covered[sight.slices_of(key)] += 1
        assert np.all(covered == 1)


def test_the_tile_above_has_every_fourth_cell_of_a_tile() -> None:
    for key in (TileKey(3, 2, 5, -4), TileKey(1, 1, -1, 0)):
        rows, columns = key.quarter
        assert np.array_equal(2 * key.parent.columns.index[columns], key.columns.index[::2])
        assert np.array_equal(2 * key.parent.rows.index[rows], key.rows.index[::2])
        assert key.parent == TileKey(key.level_x - 1, key.level_y - 1, key.x // 2, key.y // 2)


def filled(subject: Subject, key: TileKey, value: float) -> dict[str, np.ndarray]:
    sizes = {"exponent": 4, "state": 4, "sample": 0}
    arrays = empty_results(result_variables(subject.settings), (TILE_CELLS, TILE_CELLS), sizes)
    arrays["largest"][:] = value
    arrays[REGIME.name][:] = 3
    return arrays


def memory_alone(subject: Subject) -> TileCache:
    """Tiles of which none is known."""
    return TileCache(subject)


def test_each_cell_in_view_is_that_of_the_finest_tile_that_is_known(subject: Subject) -> None:
    sight = subject.viewport((2.3, 2.9), (0.2, 0.3), (300, 200))
    coarse, fine = sight.tiles(2)[0], sight.tiles(0)[0]
    tiles = memory_alone(subject)
    for key, value in ((fine, 1.0), (coarse, 4.0)):
        tiles.put(subject.plane, key, filled(subject, key, value))
    ds = compose_view(subject, subject.plane, sight, tiles.visible_tiles(subject.plane, sight), ["largest"]).ds
    expected = np.full(sight.shape, np.nan)
    expected[sight.slices_of(coarse)] = 4.0
    expected[sight.slices_of(fine)] = 1.0
    assert np.array_equal(ds.largest.values, expected, equal_nan=True)
    assert np.array_equal(ds.regime.values == PENDING, np.isnan(expected))


def test_a_cell_of_a_coarse_tile_covers_the_fine_cells_nearest_to_it(subject: Subject) -> None:
    sight = subject.viewport((2.3, 2.9), (0.2, 0.3), (300, 200))
    key = sight.tiles(1)[0]
    arrays = filled(subject, key, 0.0)
    arrays["largest"] += subject.x.values(key.level_x, key.columns.index)
    tiles = memory_alone(subject)
    tiles.put(subject.plane, key, arrays)
    ds = compose_view(subject, subject.plane, sight, tiles.visible_tiles(subject.plane, sight), ["largest"]).ds
    off = np.abs(ds.largest.values - ds.omega.values)[sight.slices_of(key)] / np.diff(ds.omega.values).mean()
    assert off.max() <= 1.0 + 1e-6


def test_memory_drops_the_tiles_that_were_not_seen_for_longest(subject: Subject) -> None:
    keys = [TileKey(0, 0, i, 0) for i in range(4)]
    arrays = filled(subject, keys[0], 0.0)
    memory = MemoryTileCache(3 * sum(array.nbytes for array in arrays.values()))
    for key in keys[:3]:
        memory.put(None, subject.plane, key, arrays)
    memory.get(None, subject.plane, keys[0])
    memory.put(None, subject.plane, keys[3], arrays)
    assert [memory.get(None, subject.plane, key) is not None for key in keys] == [True, False, True, True]


def test_curves_are_those_of_the_store_and_of_its_own_plane(finished: Path) -> None:
    write_curves(open_store(finished), curves())
    stored = subject_of(str(finished))
    sight = stored.viewport((2.3, 2.9), (0.2, 0.3), (30, 20))
    assert len(curves_of(compose_view(stored, stored.plane, sight, [], ["largest"]).ds).curves) == len(curves().curves)
    chosen = from_address(stored, {"overlay": [b"grazing,curves"]})
    assert chosen.visible_overlays(stored) == ("grazing", "curves")
    assert replace(chosen, plane=stored.plane.with_value("R", 0.7)).visible_overlays(stored) == ("grazing",)


def test_every_kind_that_is_offered_is_drawn_from_the_variables_that_it_names(finished: Path) -> None:
    write_curves(open_store(finished), curves())
    stored = subject_of(str(finished))
    sight = stored.viewport((2.3, 2.9), (0.2, 0.3), (60, 40))
    tiles = [(key, filled(stored, key, 1.0)) for key in sight.tiles(0)]
    for kind in kinds(stored):
        chosen = from_address(stored, {"kind": [kind.encode()], "overlay": [b"boundaries"]})
        (made,) = maps_of(compose_view(stored, stored.plane, sight, tiles, chosen.names), chosen, others=False)
        assert made.codes.shape == sight.shape and {*made.needs} <= {*chosen.names}, kind


def test_curves_are_not_offered_where_there_is_no_store(subject: Subject) -> None:
    assert overlays(subject) == ["grazing", "boundaries"]


def test_an_address_restores_what_it_was_made_of(subject: Subject) -> None:
    from urllib.parse import parse_qs

    given = {"omega": [b"2.5:2.75"], "b": [b"0.2:0.21"], "kind": [b"scalar"], "variable": [b"peak_to_peak"],
             "log": [b"1"], "overlay": [b"grazing,boundaries"], "vmin": [b"0.1"], "R": [b"0.75"],
             "without": [b"graze,fold"]}  # fmt: skip
    chosen = from_address(subject, given)
    again = {
        name: [text.encode() for text in texts]
        for name, texts in parse_qs(to_address(subject, subject, chosen)).items()
    }
    assert from_address(subject, again) == chosen
    assert chosen.plane == subject.plane.with_value("R", 0.75)
    assert chosen.curves is not None and {"fold", "graze"}.isdisjoint(chosen.curves)


def test_an_address_keeps_a_cell_of_another_plane_and_its_followed_orbit(subject: Subject) -> None:
    given = {"R": [b"0.7"], "cell": [b"2.5,0.25"], "cell.R": [b"0.75"], "follow.orbit": [b"omega,2.0,3.0,1,2.5"]}
    chosen = from_address(subject, given)
    assert (
        chosen.cell is not None and dict(chosen.cell[0].parameters)["R"] == 0.75 != dict(chosen.plane.parameters)["R"]
    )
    address = to_address(subject, subject, chosen)
    assert "cell=2.5,0.25&cell.R=0.75&follow.orbit=omega,2.0,3.0,1,2.5" in address
    with pytest.raises(InputError, match="R = 7"):
        from_address(subject, given | {"cell.R": [b"7"]})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"omega": [b"3:2"]}, "omega: found '3:2', must be LOW:HIGH"),
        ({"R": [b"1.5"]}, "R = 1.5: must satisfy 0 <= R <= 1"),
        ({"kind": [b"sweep"]}, "kind: found 'sweep'; possible: exponent"),
        ({"overlay": [b"stars"]}, "overlay: found 'stars'; possible: grazing"),
        ({"without": [b"stars"]}, "without: found 'stars'; possible: fold"),
        ({"cut": [b"2.5,0.3,2.5,0.3"]}, "cut: found '2.5,0.3,2.5,0.3', must have two distinct ends"),
        ({"vmin": [b"nan"]}, "vmin: found 'nan', must be a finite number"),
        ({"b": [b"-1e308:1e308"]}, r"b: found -1e\+308, must be -1e\+100 to 1e\+100"),
        ({"b": [b"-1e308:-1e307"]}, r"b: found -1e\+308, must be"),
        ({"b": [b"0:5e-324"]}, "b: found '0:5e-324', must be wider than rounding"),
        ({"cut": [b"1e308,-1e308,1,1e308"]}, r"cut: found 1e\+308, must be"),
        ({"cut": [b"2.5,0.3,2.5,0.30000000000000004"]}, "must have two distinct ends"),
        ({"cell": [b"2.5,1e308"]}, r"cell: found 1e\+308, must be"),
    ],
)
def test_an_address_that_asks_for_what_there_is_not_is_refused(
    subject: Subject, given: dict[str, list[bytes]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        from_address(subject, given)


def unreachable() -> NoReturn:
    raise OSError("no cluster")


LOG_AXES = {
    "omega": {"start": 0.5, "stop": 8.0, "num": 60, "scale": "log"},
    "b": {"start": 0.1, "stop": 0.5, "num": 30},
}


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("cut=0,0.1,2,0.3", r"cut: found 0, must be 1e-100 to 1e\+100"),
        ("cut=2,0.1,-1,0.3", "cut: found -1, must be"),
        ("cell=0,0.1", "cell: found 0, must be"),
        ("omega=-1:1", "omega: found '-1:1', must be LOW:HIGH above zero"),
        ("omega=1e-320:1e308", r"omega: found 9.99989e-321, must be"),
        ("omega=1e-100:1e100", ""),
        ("b=-1e100:1e100", ""),
        ("b=0:1e-14", ""),
        ("omega=1e99:1e100&b=1e99:1e100", ""),
        ("cut=1e-100,-1e100,1e100,1e100", ""),
        ("cut=2,0.2,2,0.2000000000001", ""),
        ("cell=1e-100,-1e100", ""),
        ("cell=2,0.2&follow.orbit=omega,1e300,-1e300,5,1e308", ""),
    ],
)
def test_an_address_is_refused_or_has_a_page(query: str, message: str) -> None:
    """Truth: impossible cuts and windows ended in a blank page, since its server could not make it."""
    spec = atlas.Spec("two-mass", LOG_AXES)
    subject = Subject(spec, exploration_settings(spec.settings))
    given = {name: [value.encode()] for name, _, value in (part.partition("=") for part in query.split("&"))}
    if message:
        with pytest.raises(InputError, match=message):
            from_address(subject, given)
        return
    chosen = from_address(subject, given)
    explorer = Explorer(subject, unreachable)
    came = SimpleQueue[RenderedPicture | str]()
    assert "<title>two-mass: explorer</title>" in page_of(subject, subject, chosen)
    painter = PictureRenderer(explorer, came.put, came.put)
    try:
        painter.show(chosen, (300, 200))
        assert isinstance(came.get(timeout=60.0), RenderedPicture)
    finally:
        painter.close()
        explorer.stop()


def test_without_exponents_the_kinds_that_need_them_are_not_offered() -> None:
    spec = atlas.Spec("two-mass", {"omega": [1.0, 2.0], "b": [0.1, 0.2]}, solve={"exponents": "none"})
    offered = kinds(Subject(spec, exploration_settings(spec.settings)))
    assert "exponent" not in offered and initial_view(Subject(spec, spec.settings)).kind == "period"


@pytest.mark.parametrize(
    ("name", "message"),
    [("fig6", "explore shows a plane, found one axis"), ("omega-c", "no such file, and unknown example 'omega-c'")],
)
def test_what_is_no_plane_is_refused(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        subject_of(name)


def test_planes_that_differ_in_a_parameter_or_in_how_they_are_solved_have_digests_of_their_own(
    subject: Subject,
) -> None:
    finer = Subject(subject.spec, exploration_settings(subject.spec.settings, tolerance=0.1))
    planes = [
        subject.digest(subject.plane),
        subject.digest(subject.plane.with_value("R", 0.7)),
        finer.digest(subject.plane),
    ]
    assert len(set(planes)) == 3


def test_the_progress_of_a_view_is_how_densely_it_is_drawn_and_is_not_rounded_up_to_all() -> None:
    lines = {
        (0.0, 0.0, 0.0, 0.0): "drawn: 0 % at 1/8 of full resolution",
        (1.0, 0.5, 0.0, 0.0): "drawn at 1/8 of full resolution, 50 % at 1/4 of full resolution",
        (1.0, 1.0, 1.0, 0.9999): "drawn at 1/2 of full resolution, 99 % at full resolution",
        (1.0, 1.0, 1.0, 1.0): "all visible cells are solved",
    }
    assert {shares: refinement(shares) for shares in lines} == lines
    line = progress(Work("", 2, 1234.5), 3, [], (1.0, 0.5, 0.0, 0.0))
    assert "3 tiles left, 1\N{NARROW NO-BREAK SPACE}234 cells/s" in line


def test_a_page_that_has_no_picture_yet_does_not_claim_that_all_is_solved() -> None:
    assert progress(Work("", 2, 0.0), 0, []).startswith("no picture yet")


def test_symbols_of_mathtext_are_written_in_unicode() -> None:
    assert [mathtext_to_unicode(text) for text in (r"\mu_m", r"\dot x_1(0)", "f_2", r"x_{12}", "R")] == [
        "μₘ",
        "ẋ₁(0)",
        "f₂",
        "x₁₂",
        "R",
    ]


def test_the_text_of_a_spec_is_read_as_that_spec() -> None:
    from atlas.spec.spec import Spec
    from workers.model.toml_text import parse_toml

    axes = {
        "omega": {"start": 2.0, "stop": 4.0, "num": 9, "scale": "linear"},
        "b": {"start": 0.1, "stop": 1.0, "num": 5, "scale": "log"},
    }
    for system in ("two-mass", "bouncing-ball"):
        record = atlas.Spec(system, {"omega": [1.0, 2.0], "R": [0.5, 0.6]}).system_def
        sides = axes if system == "two-mass" else {"omega": axes["omega"], "A": axes["b"]}
        made = atlas.Spec(record, sides, {"R": 0.7}, atlas.Settings(tolerance=0.02))
        assert Spec.from_mapping(parse_toml(spec_toml(made))).digest == made.digest


def test_a_system_of_ones_own_is_written_whole_into_the_text_of_a_spec() -> None:
    from atlas.spec.spec import Spec
    from workers.model.toml_text import parse_toml

    record = replace(atlas.Spec("two-mass", {"omega": [1.0, 2.0]}).system_def, packaged=False, name="mine")
    sides = {"omega": {"start": 1.0, "stop": 2.0, "num": 3}}
    made = atlas.Spec(record, sides)
    assert Spec.from_mapping(parse_toml(spec_toml(made))).digest == made.digest


def test_words_beyond_ascii_survive_the_text_of_a_spec() -> None:
    from workers.model.toml_text import parse_toml

    own = {
        "packaged": False,
        "name": "mine",
        "title": 'a "ball" \\ \x7f \U0001f3b1',
        "equation": 'y\'\' = -g\n\t""" y >= 0',
    }
    record = replace(atlas.Spec("bouncing-ball", {"omega": [1.0, 2.0]}).system_def, **own)
    sides = {"omega": {"start": 1.0, "stop": 2.0, "num": 3}}
    assert parse_toml(spec_toml(atlas.Spec(record, sides)))["system"] == record.table()


def test_a_plane_is_told_by_its_parameters_alone() -> None:
    assert PlaneParameters.from_parameters({"R": 0.8, "tau": 1.0}) == PlaneParameters((("R", 0.8), ("tau", 1.0)))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fig6"], "explore shows a plane, found one axis"),
        (["omega-b", "--select", "R=0.7"], "--select picks a plane of a stack, found a plane of b, omega"),
        (["omega-b", "--tolerance", "0"], "tolerance: found 0.0, must be a number > 0"),
        (["omega-b", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "give only one"),
    ],
)
def test_the_command_refuses_in_one_line_what_cannot_be_explored(words: list[str], message: str) -> None:
    from click.testing import CliRunner

    from atlas.cli.main import main

    shown = CliRunner().invoke(main, ["explore", "--no-browser", *words])
    assert shown.exit_code == 2 and message in shown.stderr.splitlines()[-1]


def test_a_value_between_two_planes_of_a_stack_selects_the_nearest(tmp_path: Path) -> None:
    axes = "".join(
        f"[axes.{name}]\nvalues = {values}\n"
        for name, values in (("omega", [1.0, 2.0]), ("b", [0.1, 0.2]), ("R", [0.6, 0.7, 0.8]))
    )
    (tmp_path / "stack.toml").write_text(f'system = "two-mass"\n{axes}')
    picked = subject_of(str(tmp_path / "stack.toml"), {"R": 0.72})
    assert (picked.layer, picked.spec.parameters["R"]) == (1, 0.7)
    with pytest.raises(InputError, match=r"R = 1 lies outside the grid; valid: 0.55 to 0.85"):
        subject_of(str(tmp_path / "stack.toml"), {"R": 1.0})


def test_who_waits_for_kernels_reads_that_they_are_compiled_first(monkeypatch: pytest.MonkeyPatch) -> None:
    system = subject_of("omega-b").system
    for said, told in (
        ("loading the kernels", ""),
        ("compiling the kernels", "; workers on this machine begin by compiling the kernels"),
    ):
        monkeypatch.setattr("atlas.explore.text.compile_notice", lambda *parts, said=said: said)
        assert first_compile_notice(system, ATTRACTORS) == told


def test_tiles_that_are_finer_than_the_atlas_along_one_axis_lie_over_it(finished: Path) -> None:
    stored = subject_of(str(finished))
    x, y = ((axis.values[0], axis.values[-1]) for axis in stored.spec.axes)
    sight = stored.viewport(x, y, (3, 60))
    assert sight.x.level < 0 < sight.y.level
    base = seen_atlas(stored, sight, ["largest"])
    assert base is not None
    alone = compose_view(stored, stored.plane, sight, [], ["largest"], base)
    assert {*alone.stages.ravel()} == {min(sight.y.level, STAGES + 1)}
    tiles = [(key, filled(stored, key, 1.0)) for key in sight.tiles(0)]
    seen = compose_view(stored, stored.plane, sight, tiles, ["largest"], base)
    assert (seen.ds.largest == 1.0).all() and not seen.stages.any()
    coarse = [(key, filled(stored, key, 1.0)) for key in sight.tiles(sight.y.level)]
    covered = compose_view(stored, stored.plane, sight, coarse, ["largest"], base)
    assert np.array_equal(covered.ds.largest, alone.ds.largest, equal_nan=True)
