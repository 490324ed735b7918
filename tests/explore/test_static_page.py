"""Claims about the page of an atlas that is one file: its numbers, its colours, its size, and what it refuses."""

import json
import re
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.explore.front.numbers import DIGITS, MANTISSA, PackedArray, pack, pack_within, round_mantissa, unpack
from atlas.explore.static.page import LIMIT, lines_of, page_of, write_page
from atlas.query.plane import Plane
from atlas.query.window import select
from atlas.render.coded_maps import coded_maps, text_of
from atlas.render.kinds import BASINS, KIND_TABLE, LABELS, MAPS, SCALAR
from atlas.render.layers import MapView, paint
from atlas.render.layout import STANDARD
from atlas.render.painters import PAINTERS
from atlas.render.request import PictureRequest
from atlas.spec.spec import Spec
from atlas.store import create
from tests import pictures, synthetic
from tests.explore.modules import colored

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")

NX, NY = 45, 38
MODULES = sorted((Path(atlas.__file__).parent / "explore").rglob("*.mjs"))


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    """A small store of made-up results, with overviews."""
    path = tmp_path_factory.mktemp("page") / "plane.zarr"
    synthetic.complete(path)
    return atlas.open(path)


def described(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="atlas">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def numbers(page: str) -> dict[str, np.ndarray]:
    """The arrays of a page by name, read back."""
    known = described(page)
    width = len(known["axes"][0]["values"])
    texts = dict(re.findall(r'<script type="text/plain" id="([\w-]+)">(.*?)</script>', page))
    return {
        name: unpack(PackedArray(about["type"], b64decode(texts[name])), width)
        for name, about in known["arrays"].items()
    }


# Numbers


@pytest.mark.parametrize("kind", ["float64", "int32", "int8", "uint8", "uint16"])
def test_an_array_comes_back_to_the_bit(kind: str) -> None:
    rng = np.random.default_rng(1)
    values = rng.integers(0, 256, (7, 5 * np.dtype(kind).itemsize), np.uint8).view(kind)
    back = unpack(pack(values), 5)
    assert back.dtype == values.dtype
    assert back.tobytes() == values.tobytes()


@pytest.mark.parametrize(("bits", "digits"), DIGITS.items())
def test_rounding_changes_a_value_by_at_most_half_a_unit_of_the_last_digit_stated(bits: int, digits: int) -> None:
    rng = np.random.default_rng(2)
    exact = rng.choice([-1.0, 1.0], 20000) * 10.0 ** rng.uniform(-300, 300, 20000)
    unit = 10.0 ** (np.floor(np.log10(np.abs(exact))) - digits + 1)
    assert np.all(np.abs(round_mantissa(exact, bits) - exact) <= 0.5 * unit)


def test_rounding_leaves_alone_what_is_not_finite_or_would_not_stay_so() -> None:
    exact = np.array([np.nan, np.inf, -np.inf, np.finfo(float).max, 0.0, -0.0, 1.0])
    assert round_mantissa(exact, 10).tobytes() == exact.tobytes()


def test_what_does_not_fit_loses_digits_one_after_the_other_and_then_is_left_out() -> None:
    rng = np.random.default_rng(3)
    every = {name: rng.random((30, 30)) for name in ("error", "largest", "speed")} | {"period": np.ones((3, 3), int)}
    arrays = {name: partial(np.copy, values) for name, values in every.items()}
    whole = sum(len(file.text) for file in pack_within(arrays, 10**9, "largest", "error")[0].values())
    seen = []
    for limit in range(whole, 0, -100):
        found, left_out = pack_within(arrays, limit, "largest", "error")
        assert sum(len(file.text) for file in found.values()) <= limit or found.keys() == {"period"}
        assert {*left_out, *found} == {*arrays}
        seen.append(tuple(found[name].bits if name in found else 0 for name in ("error", "speed", "largest")))
    bits = [MANTISSA, *DIGITS, 0]
    turns = [
        corner for high, low in pairwise(bits) for corner in ((low, high, high), (low, low, high), (low, low, low))
    ]
    assert list(dict.fromkeys(seen)) == [(MANTISSA, MANTISSA, MANTISSA), *turns]


def test_a_page_has_every_number_of_the_store_to_the_bit(opened: xr.Dataset) -> None:
    page = page_of(opened)
    found, known = numbers(page), described(page)
    expected = [name for name in opened.data_vars if set(opened[name].dims) == {"omega", "b"}]
    assert known["variables"].keys() == set(expected)
    for name in expected:
        assert found[str(name)].tobytes() == opened[name].values.tobytes(), name
    for axis in known["axes"]:
        assert axis["values"] == opened[axis["name"]].values.tolist()
    assert known["leftOut"] == []


@pytest.mark.parametrize("start", [0.5, 2.0])
def test_a_plane_with_a_logarithmic_axis_has_a_page_that_draws_it_as_pictures_do(start: float, tmp_path: Path) -> None:
    """On a log scale from a ratio of 4 of its ends on; below, evenly."""
    create.create_store(tmp_path / "log.zarr", synthetic.spec_of(8, 6, start=start, stop=4.0, scale="log"), (6, 8))
    page = tmp_path / "log.html"
    assert atlas.open(tmp_path / "log.zarr").atlas.to_html(page) == page
    x, y = described(page.read_text("utf-8"))["axes"]
    assert (x["log"], y["log"]) == (start == 0.5, False)
    assert np.allclose(x["values"], np.geomspace(start, 4.0, 8), rtol=1e-12)


def test_a_page_that_must_be_small_states_the_digits_that_its_numbers_have(opened: xr.Dataset) -> None:
    whole = page_of(opened)
    limit = len(whole.encode()) - 8000
    page = page_of(opened, limit)
    assert len(page.encode()) <= limit
    found, known = numbers(page), described(page)
    digits = {name: about["digits"] for name, about in known["arrays"].items() if about["digits"]}
    assert digits
    for name, count in digits.items():
        values = opened[name].values
        finite = np.isfinite(values) & (values != 0)
        unit = 10.0 ** (np.floor(np.log10(np.abs(values[finite]))) - count + 1)
        assert np.all(np.abs(found[name][finite] - values[finite]) <= 0.5 * unit)
        assert np.array_equal(found[name][~finite], values[~finite], equal_nan=True)


def test_maps_of_variables_that_are_left_out_are_left_out_too(opened: xr.Dataset) -> None:
    limit = len(page_of(opened).encode())
    while not (known := described(page := page_of(opened, limit)))["leftOut"]:
        limit -= 10000
    assert len(page.encode()) <= limit
    assert all(set(entry["needs"]) <= known["arrays"].keys() for entry in known["maps"])
    assert all(entry["codes"] in known["arrays"] for entry in known["maps"])


def test_a_limit_that_nothing_fits_into_is_refused(opened: xr.Dataset) -> None:
    with pytest.raises(InputError, match=r"the page of this atlas would take .* at most 5 kB; select a part"):
        page_of(opened, 5000)


def test_an_atlas_of_more_cells_is_shown_by_its_overview(opened: xr.Dataset) -> None:
    page = page_of(atlas.open(opened.encoding["source"]), most_cells=200)
    found, known = numbers(page), described(page)
    assert known["block"] == [4, 4]
    assert found["regime"].shape == (-(-NY // 4), -(-NX // 4))
    assert known["command"] == ""
    mean = synthetic.each_block(opened.periods_used.values, 2, np.mean)
    np.testing.assert_allclose(found["periods_used"], mean, rtol=1e-12)


def test_the_same_atlas_gives_the_same_bytes(opened: xr.Dataset, tmp_path: Path) -> None:
    one, other = (write_page(opened, tmp_path / name) for name in ("one.html", "other.html"))
    assert one.read_bytes() == other.read_bytes()


@pytest.mark.slow
def test_a_million_cells_take_at_most_twenty_megabytes_even_where_no_two_numbers_are_alike(tmp_path: Path) -> None:
    handle = create.create_store(tmp_path / "large.zarr", synthetic.spec_of(1000, 1000), (250, 250))
    synthetic.fill(handle)
    rng = np.random.default_rng(4)
    group = zarr.open_group(handle.path, mode="r+", use_consolidated=False)
    for variable in handle.variables:
        if variable.dtype == "float64" and not variable.extra_dims:
            group[variable.name][...] = rng.random((1000, 1000))
    ds = atlas.open(handle.path)
    size = write_page(ds, tmp_path / "page.html").stat().st_size
    known = described((tmp_path / "page.html").read_text(encoding="utf-8"))
    print(f"{size / 1e6:.2f} MB; {known['leftOut']}")
    assert LIMIT == 20_000_000
    assert size <= LIMIT


# Colours


OTHER_ENDS = (-0.3, 0.7), (0.01, 0.2), (0.2, 3.0), (-2.0, 0.05)


def planes() -> Iterator[tuple[str, xr.Dataset, xr.Dataset | None]]:
    yield "plane", pictures.plane(), None
    yield "regimes", pictures.every_regime(), None
    yield "basin", *pictures.basin()
    yield "labelled", *pictures.labelled()


@pytest.mark.parametrize(
    ("name", "ds", "table"), list(planes()), ids=lambda value: value if isinstance(value, str) else ""
)
def test_javascript_has_the_colours_of_paint_to_the_bit_with_any_ends_of_the_scale(
    name: str, ds: xr.Dataset, table: xr.Dataset | None, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("atlas.query.basins.table", lambda _: table)
    monkeypatch.setattr("atlas.render.class_maps.branches", lambda _: table)
    maps = [(coded, Plane.from_dataset(ds, coded.needs)) for coded in coded_maps(ds, ds)]
    seen = {coded.name for coded, _ in maps}
    planes_of = {coded.name: plane for coded, plane in maps}
    for coded, ends, found in colored(browser, maps, [None, *OTHER_ENDS]):
        scalar = coded.name.removeprefix("number-")
        kind = KIND_TABLE[SCALAR if scalar != coded.name else coded.name]
        page = STANDARD if ends is None else replace(STANDARD, vmin=ends[0], vmax=ends[1])
        wanted = PictureRequest(page, kind.name, variable=scalar if kind.name == SCALAR else None)
        try:
            layers = PAINTERS[kind.name](MapView(kind, ds, planes_of[coded.name], wanted))
        except InputError:
            continue  # a scale that takes no such ends
        expected = paint(layers)
        expected[expected[..., 3] == 0] = 255
        assert np.array_equal(found, expected), (coded.name, ends)
    there = {
        "plane": {*MAPS},
        "regimes": {"exponent", "period", "combined"},
        "basin": {BASINS},
        "labelled": {LABELS},
    }
    assert seen - {word for word in seen if word.startswith("number-")} == there[name]


def test_cells_without_a_result_and_cells_without_impact_have_a_texture() -> None:
    maps = {coded.name: coded for coded in coded_maps(pictures.every_regime(), pictures.every_regime())}
    exponent = maps["exponent"]
    hatches = [exponent.described["entries"][code].get("hatch", "") for code in exponent.codes.ravel()]
    assert hatches == ["/", ".", "", "", "", "", "\\", "x"]
    period = maps["period"]
    assert "hatch" not in period.described["entries"][period.codes[0, 1]]


def test_a_label_of_a_picture_is_set_in_unicode() -> None:
    assert text_of(r"largest exponent $\lambda_1$ [per forcing period]") == "largest exponent λ₁ [per forcing period]"
    assert text_of(r"$-\infty$: rest") == "−∞: rest"
    assert text_of(r"$n$-$p$-$q$") == "n-p-q"
    assert text_of(r"clearance $\mathit{my\_gap}$") == "clearance my_gap"


def test_curves_are_those_of_the_store_where_their_orbit_is_otherwise_stable() -> None:
    with pictures.keeping(pictures.curves()):
        found = lines_of(pictures.plane(), pictures.plane())[0]["curves"]
    assert list(found["looks"]) == ["fold", "period_doubling", "graze"]
    assert [line["kind"] for line in found["lines"]] == ["fold", "period_doubling", "graze"]
    whole, doubling = (np.reshape(found["lines"][k]["points"], (-1, 2)) for k in (0, 1))
    assert np.allclose(whole, pictures.curves().curves[0].points, rtol=0.0, atol=4e-7)  # of a plane 4 wide
    assert doubling[:, 0].max() == 3.0
    assert found["corners"] == [["graze_period_doubling", 3.0, 0.37]]
    assert found["marks"]["graze_period_doubling"]["label"] == "graze–period doubling"


def test_a_store_without_curves_has_none_on_its_page(opened: xr.Dataset) -> None:
    assert described(page_of(opened))["lines"].keys() == {"grazing", "boundaries"}


# The file


class Loads(HTMLParser):
    """What a page would load: addresses of elements, but for anchors."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.policy = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.found += [f"{tag} {name}" for name in given if name in ("src", "href", "data", "action", "srcset")]
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = str(given["content"])


def test_a_page_loads_nothing_and_forbids_that_it_does(opened: xr.Dataset) -> None:
    page, parser = page_of(opened), Loads()
    parser.feed(page)
    assert parser.found == []
    assert parser.policy.startswith("default-src 'none'")
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL)
    assert style is not None
    assert "url(" not in style[1] and "@import" not in style[1]
    for path in MODULES:
        program = path.read_text(encoding="utf-8")
        loads = re.findall(r"https?://|fetch\(|XMLHttpRequest|import\(|WebSocket", program)
        assert {*loads} == ({"WebSocket"} if path.name == "link.mjs" else set())  # of the live page alone


def test_a_module_of_a_page_has_at_most_400_lines() -> None:
    assert len(MODULES) > 7
    assert max(len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES) <= 400


def test_the_spec_on_a_page_has_the_digest_of_the_atlas(opened: xr.Dataset, tmp_path: Path) -> None:
    spec = re.search(r'<pre id="spec"[^>]*>(.*?)</pre>', page_of(opened), re.DOTALL)
    assert spec is not None
    (tmp_path / "spec.toml").write_text(spec[1].replace("&quot;", '"'), encoding="utf-8")
    assert Spec.from_toml(tmp_path / "spec.toml").digest == opened.attrs["digest"]


def test_a_page_says_where_its_numbers_are_from_and_what_to_cite(opened: xr.Dataset) -> None:
    page = page_of(opened)
    for name in ("digest", "solver_version", "software", "run_id"):
        assert str(opened.attrs[name]) in page
    assert "@software{impact-atlas" in page
    assert "doi     = {10.1088/1674-1056/20/4/040505}" in page


def test_the_command_of_an_atlas_with_default_parameters_sets_none(opened: xr.Dataset) -> None:
    assert described(page_of(opened))["command"] == "atlas point"


def test_text_of_an_atlas_cannot_end_its_script(opened: xr.Dataset) -> None:
    ds = opened.assign_attrs(title="</script><b>", software="impact-atlas 1, <i>")
    ds["omega"].attrs["long_name"] = "</script><script>alert(1)"
    ds.encoding = dict(opened.encoding)
    page = page_of(ds)
    assert "</script><b>" not in page and "<script>alert" not in page and "<i>" not in page
    assert described(page)["axes"][0]["label"].startswith("</script>")


# The command and the method


def call(*words: str | Path) -> Any:
    return CliRunner().invoke(main, ["explore", *map(str, words)])


def test_the_command_and_the_method_write_the_same_page(opened: xr.Dataset, tmp_path: Path) -> None:
    done = call(opened.encoding["source"], "-o", tmp_path / "one.html")
    assert (done.exit_code, done.stdout) == (0, f"{tmp_path / 'one.html'}\n")
    assert opened.atlas.to_html(tmp_path / "other.html") == tmp_path / "other.html"
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "other.html").read_bytes()


def test_a_window_gives_its_cells_alone(opened: xr.Dataset, tmp_path: Path) -> None:
    window = ("--window", "omega=2:3", "--window", "b=0.2:0.3")
    assert call(opened.encoding["source"], "-o", tmp_path / "part.html", *window).exit_code == 0
    page = (tmp_path / "part.html").read_text(encoding="utf-8")
    part = opened.sel(omega=slice(2, 3), b=slice(0.2, 0.3))
    assert numbers(page)["largest"].tobytes() == part.largest.values.tobytes()
    assert [axis["values"] for axis in described(page)["axes"]] == [part.omega.values.tolist(), part.b.values.tolist()]


def test_a_page_takes_the_place_of_an_older_file_and_leaves_nothing_else(opened: xr.Dataset, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("old")
    opened.atlas.to_html(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["{store}", "-o", "{folder}/page.htm"],
            "page.htm: the suffix chooses the format, found '.htm'; possible: .html",
        ),
        (["{store}", "-o", "{folder}/page"], "page: the suffix chooses the format, found none; possible: .html"),
        (["{store}", "-o", "{folder}/no/page.html"], "cannot be written: there is no folder"),
        (["{store}", "-o", "{folder}/page.html", "--port", "80"], "--port is for the explorer in the browser"),
        (["{store}", "-o", "{folder}/page.html", "--no-browser"], "--browser/--no-browser is for the explorer in the"),
        (["{store}", "-o", "{folder}/page.html", "--select", "R=0.8"], "R is not an axis here"),
        (["-o", "{folder}/page.html"], "omega-b: -o takes a store, found a spec; compute it first: atlas run omega-b"),
        (["my.toml", "-o", "{folder}/page.html"], "my.toml: -o takes a store, found a spec"),
        (["{store}", "--window", "omega=1:2"], "--window needs -o"),
        (["{store}", "-o", "{folder}/page.html", "--window", "omega=7:8"], "no cell centre with omega from 7 to 8"),
        (["none.zarr", "-o", "{folder}/page.html"], "no such store"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    words: list[str], message: str, opened: xr.Dataset, tmp_path: Path
) -> None:
    done = call(*(word.format(store=opened.encoding["source"], folder=tmp_path) for word in words))
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stack") / "stack.zarr"
    axes = {"omega": np.linspace(1, 4, 9), "b": np.linspace(0.1, 0.5, 6), "R": [0.5, 0.6]}
    handle = create.create_store(path, atlas.Spec("two-mass", axes=axes), (1, 6, 9))
    synthetic.fill(handle)
    return path


def test_one_plane_of_a_stack_is_shown_and_a_whole_stack_is_refused(stack: Path, tmp_path: Path) -> None:
    done = call(stack, "-o", tmp_path / "page.html")
    assert done.exit_code == 2
    assert "a page shows one plane, found a stack of 2; pick one by --select R=0.5" in done.stderr
    assert call(stack, "-o", tmp_path / "page.html", "--select", "R=0.6").exit_code == 0
    found = numbers((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert found["largest"].tobytes() == atlas.open(stack).largest.sel(R=0.6).values.tobytes()


def test_a_line_and_exponents_in_another_unit_are_refused(opened: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a page shows two axes, found one \(omega\)"):
        opened.isel(b=0).atlas.to_html(tmp_path / "page.html")
    with pytest.raises(InputError, match="pictures need exponents per forcing period"):
        opened.atlas.per_unit_time().atlas.to_html(tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []


def test_changed_values_which_no_overview_has_are_refused_where_there_are_too_many(opened: xr.Dataset) -> None:
    changed = opened.assign(largest=opened.largest + 0.0)
    changed.encoding = dict(opened.encoding)
    with pytest.raises(InputError, match="at most 200 cells of values in memory, found 1710"):
        page_of(changed.load(), most_cells=200)


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An atlas of all attractors, two kept in a cell, whose second ones are pending in the lower half."""
    path = tmp_path_factory.mktemp("several") / "several.zarr"
    axes = {"omega": np.linspace(1, 4, 6), "b": np.linspace(0.1, 0.5, 4)}
    handle = create.create_store(path, atlas.Spec("two-mass", axes, attractors={"starts": 4, "keep": 2}), (4, 6))
    group = zarr.open_group(handle.path, mode="r+", use_consolidated=False)
    regime, largest = np.full((4, 6, 2), 1, np.int8), np.zeros((4, 6, 2))
    regime[:2, :, 1], largest[..., 1] = -1, -1.0
    given = {"largest": largest, "share": largest + 1.0, "regime": regime}
    for variable in handle.variables:
        array: Any = group[variable.name]
        array.with_config({"write_empty_chunks": True})[...] = given.get(variable.name, variable.fill)
    return path


def test_of_an_atlas_of_all_attractors_the_page_says_which_it_shows(several: Path) -> None:
    ds = atlas.open(several)
    first = page_of(ds)
    assert described(first)["attractor"] == 0
    assert np.all(numbers(first)["largest"] == 0.0)
    assert np.all(numbers(first)["largest-1"] == -1.0)
    assert np.array_equal(numbers(first)["regime-1"], ds.regime[..., 1])
    assert described(first)["others"]["share-1"].endswith("of attractor number 2")
    second = page_of(select(ds, {"attractor": 1}))
    known = described(second)
    assert known["attractor"] == 1
    assert np.all(numbers(second)["largest"] == -1.0)
    assert known["others"] == {}
    assert known["regimes"]["-1"] == "not more than 1"
    exponent = next(entry for entry in known["maps"] if entry["name"] == "exponent")
    assert "not more than 1" in [entry["label"] for entry in exponent["legend"]]


def test_a_page_gives_no_command_where_a_cell_starts_from_a_state_that_it_does_not_hold(
    several: Path, opened: xr.Dataset, tmp_path: Path
) -> None:
    axes = {"omega": {"start": 1.0, "stop": 4.0, "num": 6, "continuation": "forward"}, "b": [0.1, 0.2, 0.3]}
    handle = create.create_store(tmp_path / "swept.zarr", atlas.Spec("two-mass", axes), (3, 6))
    synthetic.fill(handle)
    for ds in (atlas.open(several), select(atlas.open(several), {"attractor": 1}), atlas.open(handle.path)):
        assert described(page_of(ds))["command"] == ""
    assert described(page_of(opened))["command"] == "atlas point"
