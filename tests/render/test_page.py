"""Claims about the page of a picture: its size in a file, its type and scale, axes of one's own; nothing is clipped."""

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import atlas
from atlas import render
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.query.compare import Comparison
from atlas.render import maps, text
from atlas.render.kinds import KIND_TABLE
from atlas.render.layout import page as page_of
from atlas.render.request import PictureRequest
from tests.pictures import basin, branches, curves, keeping, labelled, line, orbit, plane
from tests.synthetic import complete

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _curves() -> Iterator[None]:
    with keeping(curves()):
        yield


def draw(kind: str, **look: Any) -> Figure:
    if kind.startswith("beside"):
        others = [plane().assign_coords(R=r, zeta=r / 7.0, mu_m=7.5 * r) for r in (0.75, 0.875, 0.925)]
        return render.figure([plane(), *others[: int(kind[-1]) - 1]], **look)
    if kind == "named":
        return render.figure([plane()] * 3, "period", titles=["a_long_name_of_a_store.zarr", "b", "c"], **look)
    if kind == "compared":
        other = plane().roll(omega=1).assign_coords(R=0.75)
        return render.figure(Comparison.from_atlases(plane(), other), **look)
    if kind == "portrait":
        return render.figure(orbit(), **look)
    if kind == "hysteresis":
        return render.figure(line("forward", 5), against=line("backward", 3), **look)
    if kind == "coexistence":
        return render.figure(branches(), kind, **look)
    if kind in (render.BASINS, "labels"):
        page = page_of(**look)
        where = "query.basins.table" if kind == render.BASINS else "render.class_maps.branches"
        ds, table = basin() if kind == render.BASINS else labelled()
        with patch(f"atlas.{where}", return_value=table):
            figure = maps.draw(KIND_TABLE[kind], ds, PictureRequest(page))
        page.wrap_texts(figure)
        return figure
    if kind in render.MAPS:
        return render.figure(plane(), kind, overlay=render.MAP_OVERLAYS, **look)
    return render.figure(line(), kind, **look)


class _Notes(RendererAgg):
    """Draws, and notes every text that it draws: an axis has more labels than it shows."""

    def draw_text(self, *args: Any, mtext: Text | None = None, **kwargs: Any) -> None:
        self.__dict__.setdefault("drawn", []).append(mtext)
        super().draw_text(*args, mtext=mtext, **kwargs)


def texts(figure: Figure) -> list[Text]:
    """Every text that is drawn."""
    notes = _Notes(*figure.bbox.size, figure.dpi)
    figure.draw(notes)
    return [artist for artist in notes.__dict__["drawn"] if artist is not None]


@pytest.mark.parametrize("width", ["85mm", "180mm"])
@pytest.mark.parametrize("kind", [*render.KINDS, "portrait", "beside2", "beside3", "beside4", "named", "compared"])
def test_no_text_is_clipped_and_none_overlaps_another(kind: str, width: str) -> None:
    figure = draw(kind, width=width)
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts(figure)]
    page = figure.bbox
    clipped = [
        t for t, b in boxes if b.x0 < page.x0 - 1 or b.x1 > page.x1 + 1 or b.y0 < page.y0 - 1 or b.y1 > page.y1 + 1
    ]
    assert not clipped
    over = [(s, t) for (s, a), (t, b) in itertools.combinations(boxes, 2) if a.padded(-1.5).overlaps(b.padded(-1.5))]
    assert not over


@pytest.mark.parametrize(("width", "inches"), [("85mm", 85 / 25.4), ("8.5 cm", 85 / 25.4), ("3in", 3.0), (4, 4.0)])
def test_a_file_has_the_width_that_was_asked_for(tmp_path: Path, width: str | float, inches: float) -> None:
    with Image.open(render.render(plane(), tmp_path / "map.png", width=width, height="60mm", dpi=200)) as image:
        assert image.size == (pytest.approx(inches * 200, abs=1), pytest.approx(60 / 25.4 * 200, abs=1))
        assert image.info["dpi"] == pytest.approx((200, 200), abs=0.1)


@pytest.mark.parametrize(
    ("look", "says"),
    [
        ({"width": "85"}, r"width: found '85', must be a length such as 85mm, 8.5cm or 3.35in"),
        ({"width": "85px"}, "must be a length such as"),
        ({"height": "5km"}, "height: found '5km'"),
        ({"width": "2mm"}, r"must be 0.8 to 60 inches"),
        ({"dpi": -1}, "dpi: found -1, must be positive"),
        ({"font_size": float("nan")}, "font_size: found nan, must be a number"),
        ({"vmin": 2.0, "vmax": 1.0}, "colour limits: found 2 to 1, must increase"),
        ({"vmin": 0.5, "vmax": 1.0}, "must have zero between them"),
        ({"style": "no-such-style"}, "style no-such-style: neither a style of matplotlib nor a readable file"),
        ({"style": "/dev/zero"}, "style /dev/zero: not a regular file"),
        ({"colour": 1}, "unknown option 'colour'; possible: width, height"),
    ],
)
def test_what_makes_no_page_is_refused_in_one_line(look: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        render.figure(plane(), **look)


@pytest.mark.parametrize("kind", ["period", "impacts"])
def test_ends_of_a_scale_are_refused_where_there_is_none(kind: str) -> None:
    with pytest.raises(InputError, match=f"kind '{kind}' draws classes"):
        render.figure(plane(), kind, vmax=1.0)


@pytest.mark.parametrize(
    ("asked", "low"),
    [({"kind": "exponent"}, -2.0), ({"kind": "combined"}, 0.0), ({"variable": "periods_used"}, 1.0),
     ({"variable": "stuck_fraction"}, 0.0)],
)  # fmt: skip
def test_two_planes_can_be_drawn_on_one_scale(asked: dict[str, Any], low: float) -> None:
    bars = [render.figure(part, **asked, vmin=low, vmax=3e4).axes[1] for part in (plane(), plane().isel(b=slice(1, 6)))]
    assert [bar.get_ylim() for bar in bars] == [pytest.approx((low, 3e4))] * 2


def test_maps_side_by_side_take_the_ends_of_their_scale() -> None:
    assert draw("beside2", vmin=-2.0, vmax=1.0).axes[-1].get_ylim() == (-2.0, 1.0)
    with pytest.raises(InputError, match="kind 'period' draws classes"):
        draw("named", vmax=1.0)


def test_the_scale_of_differences_takes_its_ends_and_one_decides_the_other() -> None:
    assert draw("compared", vmin=-2.0, vmax=1.0).axes[-1].get_xlim() == (-2.0, 1.0)
    assert draw("compared", vmax=3.0).axes[-1].get_xlim() == (-3.0, 3.0)
    with pytest.raises(InputError, match="found 1 to 3, must have zero between them"):
        draw("compared", vmin=1.0, vmax=3.0)
    without = plane().drop_vars("largest")
    with pytest.raises(InputError, match="a comparison without exponents draws classes"):
        render.figure(Comparison.from_atlases(without, without), vmax=1.0)


@pytest.mark.parametrize("kind", ["beside2", "compared"])
def test_a_figure_of_several_maps_shows_itself_in_a_notebook_and_is_not_drawn_into_axes(kind: str) -> None:
    assert draw(kind)._repr_png_()[0].startswith(b"\x89PNG")  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="several maps need a figure of their own"):
        draw(kind, ax=Figure().subplots())


def test_sweeps_take_the_ends_of_the_axis_of_exponents() -> None:
    top, bottom = render.figure(line(), vmin=-1.0, vmax=0.5).axes
    assert bottom.get_ylim() == (-1.0, 0.5)
    assert top.get_ylim() != (-1.0, 0.5)


@pytest.mark.parametrize("width", ["85mm", "120mm", "180mm"])
def test_a_legend_beside_a_map_is_not_printed_over_its_title(width: str) -> None:
    long = plane().assign_coords(R=0.812345, zeta=0.0512345, mu_m=2.123456, mu_k=5.123456, f2=0.123456, tau=1.234567)
    figure = render.figure(long, "period", overlay=["grazing", "boundaries"], width=width)
    figure.draw_without_rendering()
    title = next(text for text in figure.findobj(Text) if text.get_gid() == "title")
    (legend,) = figure.legends
    assert not legend.get_window_extent().overlaps(title.get_window_extent())


def test_the_title_can_be_left_out() -> None:
    assert render.figure(plane(), title=False).axes[0].get_title(loc="left") == ""
    assert render.figure(orbit(), title=False).get_suptitle() == ""
    assert draw("compared", title=False).get_suptitle() == ""
    beside = draw("beside2", title=False)
    assert (beside.get_suptitle(), "R = 0.75" in beside.axes[1].get_title("left")) == ("", True)


def test_all_type_follows_the_size_that_was_asked_for() -> None:
    small, large = (render.figure(plane(), font_size=size).axes[0].xaxis.label.get_fontsize() for size in (6.0, 12.0))
    assert large == pytest.approx(2 * small)


def test_a_style_file_decides_what_the_options_do_not(tmp_path: Path) -> None:
    (tmp_path / "my.mplstyle").write_text(
        "font.family: DejaVu Sans\nfont.size: 6\nsavefig.bbox: tight\nsavefig.dpi: 100\n"
    )
    label = render.figure(plane(), style=tmp_path / "my.mplstyle").axes[0].xaxis.label
    assert (label.get_fontfamily(), label.get_fontsize()) == (["DejaVu Sans"], pytest.approx(6.6))
    with Image.open(render.render(plane(), tmp_path / "map.png", width=4, style=tmp_path / "my.mplstyle")) as image:
        assert image.width == 400


def inks(figure: Figure) -> list[str]:
    """The colours of the background and of a text, by name."""
    return [to_hex(color) for color in (figure.get_facecolor(), figure.axes[0].xaxis.label.get_color())]


def test_a_dark_style_is_dark_everywhere(tmp_path: Path) -> None:
    assert inks(render.figure(plane(), style="dark_background")) == ["#000000", "#ffffff"]
    with Image.open(render.render(plane(), tmp_path / "map.png", style="dark_background")) as image:
        assert image.convert("RGB").getpixel((1, 1)) == (0, 0, 0)


def test_what_a_user_has_set_counts_for_a_picture_if_it_is_asked_for() -> None:
    with plt.rc_context():
        plt.style.use("dark_background")
        plt.rcParams["font.family"] = ["DejaVu Sans"]
        assert inks(render.figure(plane())) == ["#ffffff", "#000000"]
        asked = render.figure(plane(), style="current")
    assert inks(asked) == ["#000000", "#ffffff"]
    assert asked.axes[0].xaxis.label.get_fontfamily() == ["DejaVu Sans"]
    assert inks(render.figure(plane(), style="current")) == ["#ffffff", "#000000"]


@pytest.mark.parametrize(("kind", "shape"), [("period", (1, 1)), ("combined", (1, 2)), ("exponent", (2, 1))])
def test_a_legend_in_plain_axes_of_ones_own_is_within_the_figure(kind: str, shape: tuple[int, int]) -> None:
    figure, axes = plt.subplots(*shape, squeeze=False)
    for ax in axes.flat:
        render.figure(plane(), kind, ax=ax)
    figure.canvas.draw()
    for ax in axes.flat:
        place, page = ax.get_legend().get_window_extent(), figure.bbox
        assert page.x0 <= place.x0 and place.x1 <= page.x1 and page.y0 <= place.y0 and place.y1 <= page.y1
    figure.tight_layout()
    plt.close(figure)


def test_axes_at_a_place_of_their_own_stay_there() -> None:
    figure = plt.figure()
    ax = figure.add_axes((0.1, 0.3, 0.5, 0.5))
    render.figure(plane(), "period", ax=ax)
    figure.canvas.draw()
    assert ax.get_position().bounds == pytest.approx((0.1, 0.3, 0.5, 0.5))
    plt.close(figure)


def test_the_title_of_a_machine_whose_constants_are_numbers_is_its_own() -> None:
    """There is no parameter but those of the axes, the phase of the force and initial states."""
    table = {
        "name": "mine", "title": "a mass for $3", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]],
        "stiffness": [[1.0]], "force": [1.0], "gap": [1.0], "upper": 1.0, "restitution": 0.5,
        "parameters": {"omega": {"default": 1.0}},
    }  # fmt: skip
    spec = atlas.Spec(table, {"omega": [1.0, 2.0]})
    ds = xr.Dataset(
        coords={"omega": [1.0, 2.0], "tau": 0.0, "x": 0.0, "v": 0.0}, attrs={"spec": json.dumps(spec.to_resolved())}
    )
    assert text.title_line(ds) == r"a mass for \$3"
    assert text.title_line(ds.assign_coords(tau=0.5)) == r"a mass for \$3,  $\tau = 0.5$"
    assert text.title_line(ds.assign_coords(x=0.5)).startswith("$")


def test_a_picture_that_cannot_be_saved_leaves_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    path.write_bytes(b"the old one")

    def full(self: Figure, target: Path, **options: Any) -> None:
        Path(target).write_bytes(b"begun")
        raise OSError(28, "No space left on device")

    with (
        patch.object(Figure, "savefig", full),
        pytest.raises(InputError, match=r"map\.png: cannot be written: No space"),
    ):
        render.render(plane(), path)
    assert path.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [path]


def test_a_map_is_drawn_into_axes_of_ones_own() -> None:
    figure, axes = plt.subplots(1, 2, layout="constrained")
    assert render.figure(plane(), "combined", ax=axes[1], overlay="grazing") is axes[1]
    assert axes[1].images and not axes[0].images
    assert axes[1].get_legend() is not None
    figure.draw_without_rendering()
    plt.close(figure)


def test_a_sweep_is_drawn_into_one_of_ones_own_axes_for_each_plot() -> None:
    figure, axes = plt.subplots(2, 1)
    assert list(render.figure(line(), ax=axes)) == list(axes)
    assert all(ax.lines for ax in axes)
    with pytest.raises(InputError, match="ax: found 1 axes, must be 2, one for each plot"):
        render.figure(line(), ax=axes[0])
    with pytest.raises(InputError, match="width: the given axes have a size already"):
        render.figure(line(), ax=axes, width=3)
    plt.close(figure)


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("ax", r"^ax: found 3, must be matplotlib axes"),
        ("overlay", r"^overlay: found 3, must be a name or a list of names$"),
        ("curves", r"^curves: found 3, must be a name or a list of names$"),
        ("style", r"^style: found 3, must be a style of matplotlib, 'current' or the path of a file$"),
    ],
)
def test_a_number_where_an_option_is_none_is_named_in_one_line(option: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        render.figure(plane(), **{option: 3})


def test_one_overlay_may_be_given_as_a_text() -> None:
    one, several = (
        render.figure(plane(), overlay=count).legends[0].get_texts()[-1] for count in ("grazing", ["grazing"])
    )
    assert one.get_text() == several.get_text() == r"grazing, $|Y| = b$"


def test_a_portrait_to_another_format_is_refused_before_the_cell_is_even_looked_for(tmp_path: Path) -> None:
    ds = atlas.open(complete(tmp_path / "plane.zarr").path)
    with pytest.raises(InputError, match=r"found '.gif'"):
        ds.atlas.portrait(omega=99.0, b=0.2, path=tmp_path / "c.gif")
    ended = CliRunner().invoke(main, ["portrait", "-o", str(tmp_path / "c.gif")])
    assert ended.exit_code == 2
    assert "solving" not in ended.output


@pytest.mark.parametrize(
    "args", [("plot", "STORE"), ("plot", "STORE", "STORE"), ("compare", "STORE", "STORE")], ids=" ".join
)
def test_the_command_takes_size_type_and_scale(tmp_path: Path, args: tuple[str, ...]) -> None:
    store, out = complete(tmp_path / "plane.zarr").path, tmp_path / "map.png"
    command = [str(store) if arg == "STORE" else arg for arg in args]
    look = ["--width", "85mm", "--height", "3in", "--dpi", "150", "--font-size", "7", "--vmin=-2", "--vmax=1"]
    look += ["--no-title", "--style", "classic"]
    ended = CliRunner().invoke(main, [*command, "-o", str(out), *look])
    assert ended.exit_code == 0, ended.output
    with Image.open(out) as image:
        assert image.size == (int(85 / 25.4 * 150), 450)
    refused = CliRunner().invoke(main, [*command, "-o", str(tmp_path / "no.png"), "--width", "85"])
    assert refused.exit_code == 2
    assert not (tmp_path / "no.png").exists()


@pytest.mark.parametrize("option", [("--width", "85mm"), ("--vmin", "0"), ("--no-title",)], ids=" ".join)
def test_how_a_comparison_looks_is_refused_without_a_picture(tmp_path: Path, option: tuple[str, ...]) -> None:
    store = str(complete(tmp_path / "plane.zarr").path)
    ended = CliRunner().invoke(main, ["compare", store, store, *option])
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert f"{option[0]} needs -o, the picture" in ended.stderr


def test_a_period_has_one_colour_in_every_map() -> None:
    maps = [np.asarray(render.figure(plane(), kind).axes[0].images[0].get_array()) for kind in ("period", "combined")]
    periodic = plane()["regime"].values == 1
    assert (maps[0][periodic] == maps[1][periodic]).all()
