"""Bad options are refused before slow work: before stores are read, kernels compiled, cells solved."""

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.render.request import PictureRequest
from atlas.service.cluster import Tls
from atlas.service.plan import MANY_OBJECTS, make_plan
from tests import synthetic


@pytest.fixture
def at_work(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The slow work that was begun: none is done."""
    begun: list[str] = []

    def slow(*given: object, **options: object) -> None:
        begun.append("slow work")
        raise InputError("slow work began")

    for name in (
        "atlas.query.open.open_atlas",
        "atlas.cli.compare.open_atlas",
        "atlas.cli.cell.prepare_kernels",
        "atlas.cli.branch.prepare_kernels",
        "atlas.cli.explore.prepare_kernels",
    ):
        monkeypatch.setattr(name, slow)
    return begun


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("plot a.zarr -o a.png --kind expnent", "unknown kind of picture 'expnent'; did you mean 'exponent'?"),
        ("plot a.zarr -o a.png --curves fold,grze", "unknown kind of curve 'grze'; did you mean 'graze'?"),
        ("plot a.zarr b.zarr -o a.png --width 3", "width: found '3', must be a length such as 85mm"),
        ("plot a.zarr -o no/a.png", "no/a.png: cannot be written: there is no folder"),
        ("export a.zarr -o no/a.csv", "no/a.csv: cannot be written: there is no folder"),
        ("find regions a.zarr chaotic -o no/a.csv", "no/a.csv: cannot be written: there is no folder"),
        ("compare a.zarr b.zarr -o a.png --dpi 1", "dpi: found 1, with type of 10 points"),
        ("portrait --set omega=3 -o a.png --font-size 0", "font_size: found 0, must be positive"),
        ("branch --along omega --from 2 --to 3 -o no/a.csv", "no/a.csv: cannot be written: there is no folder"),
        ("branch --along omega --from 2 --to 3 -o a.png --style no", "style no: neither a style of matplotlib"),
    ],
)
def test_a_bad_option_is_found_before_slow_work(
    words: str, message: str, at_work: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, words.split())
    assert (done.exit_code, at_work) == (2, [])
    assert message in done.stderr and len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_port_that_is_taken_is_found_before_kernels_are_compiled(at_work: list[str]) -> None:
    import socket

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        done = CliRunner().invoke(main, ["explore", "omega-b", "--no-browser", "--port", str(port)])
    assert (done.exit_code, at_work) == (2, [])
    assert f"port {port}" in done.stderr


def test_a_kind_of_picture_is_checked_without_an_atlas() -> None:
    with pytest.raises(InputError, match="did you mean 'period'"):
        PictureRequest.from_arguments("perod")


def test_files_of_a_connection_are_refused_without_a_scheduler(tmp_path: Path) -> None:
    authority = tmp_path / "ca.pem"
    authority.write_text("")
    with pytest.raises(InputError, match="tls: found files for a connection to a scheduler, but no scheduler"):
        atlas.RunOptions(tls=Tls(str(authority)))
    done = CliRunner().invoke(main, ["run", "tiny", "-o", str(tmp_path / "a.zarr"), "--tls-ca-file", str(authority)])
    assert done.exit_code == 2 and "but no scheduler" in done.stderr
    assert list(tmp_path.iterdir()) == [authority]


@pytest.mark.parametrize("words", ["query PATH", "run tiny -o PATH", "plot PATH -o a.png", "status file://PATH"])
def test_access_options_are_refused_without_a_url(words: str, tmp_path: Path) -> None:
    given = words.replace("PATH", str(tmp_path / "a.zarr")).split()
    done = CliRunner().invoke(main, [*given, "--storage-option", "anon=true"])
    message = "Error: --storage-option: sets the access of a store at a URL, found no URL of a server\n"
    assert (done.exit_code, done.stderr) == (2, message)


@pytest.mark.skipif(os.name == "nt", reason="links need a privilege there")
@pytest.mark.parametrize("words", ["run tiny -o PATH", "query PATH", "run tiny -o PATH/below.zarr"])
def test_a_link_to_nothing_is_called_so(words: str, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "missing")
    done = CliRunner().invoke(main, words.replace("PATH", str(link)).split())
    assert done.exit_code == 2
    assert f"found a link to {tmp_path / 'missing'}, which does not exist" in done.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == [link]


def test_a_plan_tells_how_many_objects_a_store_has(tmp_path: Path) -> None:
    """Those of a store with an overview are counted; metadata and coordinates come on top."""
    spec = synthetic.spec_of(300, 260)
    synthetic.complete(tmp_path / "a.zarr", (50, 50), spec, side=256, least=128)
    made = sum(path.is_file() and path.name != "zarr.json" for path in (tmp_path / "a.zarr").rglob("*"))
    plan = make_plan(spec, workers=1, tile=(50, 50))
    assert plan.objects == pytest.approx(made, rel=0.25)
    assert f"in about {plan.objects}" in str(plan)


@pytest.mark.parametrize(("tile", "warned"), [(None, False), ((64, 64), True)])
def test_a_plan_of_ten_billion_cells_warns_of_more_objects_than_buckets_take(
    tile: tuple[int, int] | None, warned: bool
) -> None:
    spans = {"omega": {"start": 2, "stop": 4, "num": 100_000}, "b": {"start": 0.1, "stop": 0.5, "num": 100_000}}
    plan = make_plan(atlas.Spec("two-mass", spans), workers=4, tile=tile)
    assert (plan.objects > MANY_OBJECTS) == warned
    assert ("than some providers take in a bucket" in str(plan)) == warned
    assert "million files or objects" in str(plan)
