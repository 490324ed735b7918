"""Claims about the paper's figures and the commands that draw."""

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from distributed import Client
from PIL import Image

import atlas
from atlas.cell.trajectory import cell_orbit, describe
from atlas.cli import paper_figures
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.options import RunOptions
from atlas.spec.spec import Spec
from tests import naive
from workers import Settings


def test_the_cells_are_those_of_the_paper() -> None:
    for number in (3, 4, 5):
        assert naive.FIGURES[number].items() <= paper_figures.CELLS[f"fig{number}"].items() | {("R", 0.8)}


@pytest.mark.slow
def test_fig_5_is_solved_to_the_digits_of_the_paper() -> None:
    """Truth: 1.123, -1.577, -1.582, -4.38 within .002, and 2.637 impacts a period."""
    orbit = cell_orbit(paper_figures.CELLS["fig5"], settings=paper_figures.SETTINGS)
    assert orbit.cell["largest"] == pytest.approx(1.123, abs=0.007)
    assert orbit.cell["error"] <= 0.002
    assert orbit.cell["impacts_per_period"] == pytest.approx(2.637, abs=0.01)


@pytest.mark.parametrize(
    ("name", "words"), [("fig3", "impacts 1 above and 1 below"), ("fig4", "impacts 2 above and 2 below")]
)
def test_figs_3_and_4_show_the_motions_that_the_paper_describes(name: str, words: str) -> None:
    assert words in describe(cell_orbit(paper_figures.CELLS[name]))


@pytest.mark.slow
def test_all_figures_are_drawn_into_a_folder(tmp_path: Path, client: Client) -> None:
    """Fig. 6 on six cells of its own spec, in this process: the cluster has tests of its own."""
    whole = Spec.from_toml(paper_figures.SWEEP)
    axis = list(whole.axes[0].values[::200])
    short = Spec(whole.system, {"omega": axis}, whole.parameters, whole.settings)
    stages: list[str] = []
    written = paper_figures.figures(
        tmp_path / "paper",
        ("png", "pdf"),
        client,
        RunOptions(on_progress=lambda progress: stages.append(progress.stage)),
        settings=Settings(tolerance=0.1),
        sweep=short,
    )
    assert [path.name for path in written] == [f"fig{i}.{suffix}" for i in (3, 4, 5, 6) for suffix in ("png", "pdf")]
    assert all(path.stat().st_size > 5000 for path in written)
    named = [stage.partition(":")[0] for stage in stages if stage.startswith("fig")]  # the others are of the run
    assert named == ["fig3", "fig4", "fig5", "fig6", "fig6"]
    with Image.open(tmp_path / "paper" / "fig6.png") as image:
        assert image.info["Digest"] == short.digest


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: cannot be written"):
        paper_figures.figures(tmp_path / "file")


def test_an_unknown_format_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown format 'gif'; possible: png, svg, pdf"):
        paper_figures.figures(tmp_path / "new", ("gif",))
    assert not (tmp_path / "new").exists()


# The commands


def test_the_portrait_command_writes_what_it_names(tmp_path: Path) -> None:
    out = tmp_path / "cell.svg"
    result = CliRunner().invoke(main, ["portrait", "--set", "b=0.6", "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(out)
    assert out.read_text().startswith("<?xml")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["portrait", "--set", "b=0", "-o", "x.png"], "b = 0.0: must satisfy 0 < b"),
        (["portrait", "--set", "b=0.1", "-o", "x.gif"], "the suffix chooses the format"),
        (["portrait", "--set", "x1=9", "-o", "x.png"], "no motion to show"),
    ],
)
def test_a_drawing_that_cannot_be_made_ends_in_one_line_and_nothing_written(
    tmp_path: Path, words: list[str], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert says in result.stderr
    assert "Traceback" not in result.output
    assert not list(tmp_path.iterdir())


def test_the_render_command_takes_overlays_and_a_second_atlas(
    solved_plane: Path, tmp_path: Path, client: Client
) -> None:
    shutil.copytree(solved_plane, tmp_path / "plane.zarr")
    for direction in ("forward", "backward"):
        omega = {"start": 2.0, "stop": 3.0, "num": 3, "continuation": direction}
        spec = Spec("two-mass", {"omega": omega}, {"b": 0.4}, {"max_periods": 300})
        atlas.run(spec, tmp_path / f"{direction}.zarr", client=client)
    runner = CliRunner()
    drawn = [
        ["plane.zarr", "-o", "map.png", "--kind", "impacts", "--overlay", "grazing", "--overlay", "boundaries"],
        ["forward.zarr", "-o", "both.png", "--against", "backward.zarr"],
    ]
    for store, dash, out, *options in drawn:
        words = [str(tmp_path / option) if option.endswith(".zarr") else option for option in options]
        result = runner.invoke(main, ["plot", str(tmp_path / store), dash, str(tmp_path / out), *words])
        assert result.exit_code == 0, result.output
        assert (tmp_path / out).exists()
    result = runner.invoke(
        main, ["plot", str(tmp_path / "plane.zarr"), "-o", "x.png", "--against", str(tmp_path / "none.zarr")]
    )
    assert result.exit_code == 2
    assert "no such store" in result.stderr
