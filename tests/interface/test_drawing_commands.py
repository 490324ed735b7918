"""Claims about the commands that draw."""

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.spec.spec import Spec


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
