"""The second plane of a page: of whom it is, what it shows, and its address; nothing is solved."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import pytest
from click.testing import CliRunner

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.explore.beside import nearby, second
from atlas.explore.chosen import Beside, beginning, carried, from_address, to_address
from atlas.explore.explorer import Explorer
from atlas.explore.patches import Patches
from atlas.explore.session import explore
from atlas.explore.state import State, Store
from atlas.explore.subject import Subject, check_axes, exploring, subject_of
from workers.model.system import find_system


def subject_over(R: float = 0.8, **axes: Any) -> Subject:
    spec = atlas.Spec("two-mass", axes or {"omega": [1.0, 2.0, 3.0], "b": [0.1, 0.2]}, parameters={"R": R})
    return Subject(spec, exploring(spec.settings))


@contextmanager
def nowhere() -> Iterator[Any]:
    raise InputError("there is no cluster")
    yield


@pytest.fixture
def home() -> Iterator[Explorer]:
    """An explorer with another atlas, and without a cluster."""
    patches = Patches(nowhere)
    made = Explorer(subject_over(), patches, other=subject_over(R=0.6))
    yield made
    made.stop()


def state(home: Explorer, beside: Beside, **fields: Any) -> State:
    return State(replace(beginning(home.subject), beside=beside, **fields), ends=(-0.5, 0.25))


def test_the_same_map_at_another_value_is_on_the_scale_of_the_first(home: Explorer) -> None:
    there, chosen = second(home, home, state(home, Beside("R", 0.7)))
    assert there is home and chosen.plane == home.subject.plane.moved("R", 0.7)
    assert (chosen.kind, chosen.vmin, chosen.vmax, chosen.beside) == ("exponent", -0.5, 0.25, None)


def test_ends_of_a_scale_are_forgotten_with_the_map_that_has_them(home: Explorer) -> None:
    store = Store(state(home, Beside("R", 0.7)))
    store.choose(x=(1.5, 2.5))
    assert store.now.ends == (-0.5, 0.25)
    store.choose(kind="cost")
    assert store.now.ends == (None, None)


def test_another_map_of_the_same_plane_has_a_scale_of_its_own(home: Explorer) -> None:
    there, chosen = second(home, home, state(home, Beside("plane", drawn="scalar:peak_to_peak"), vmin=-1.0))
    assert there is home and chosen.plane == home.subject.plane
    assert (chosen.kind, chosen.variable, chosen.vmin, chosen.vmax) == ("scalar", "peak_to_peak", None, None)


def test_a_difference_takes_the_plane_of_the_first_off_the_second(home: Explorer) -> None:
    _, chosen = second(home, home, state(home, Beside("R", 0.7, "difference"), overlays=("grazing",)))
    assert chosen.less == home.subject.plane and chosen.overlays == () and chosen.vmin is None
    assert dict(chosen.plane.parameters)["R"] == 0.7


def test_another_atlas_has_its_own_parameters_and_over_other_axes_lies_where_the_first_does(home: Explorer) -> None:
    there, chosen = second(home, home, state(home, Beside("atlas")))
    assert there is home.other and dict(chosen.plane.parameters)["R"] == 0.6
    turned = home.turned(("zeta", "b"))
    begun = replace(beginning(turned.subject), beside=Beside("atlas"))
    begun = replace(begun, plane=begun.plane.moved("omega", 2.75))
    there, chosen = second(home, turned, State(begun))
    assert there.subject.axes == ("zeta", "b")
    assert (dict(chosen.plane.parameters)["omega"], dict(chosen.plane.parameters)["R"]) == (2.75, 0.6)


def test_another_value_that_is_a_layer_of_the_stack_is_that_layer(tmp_path: Path) -> None:
    spec = tmp_path / "stack.toml"
    spec.write_text('system = "two-mass"\n[axes]\nomega = [1.0, 2.0]\nb = [0.1, 0.2]\nzeta = [0.02, 0.05]\n')
    home = Explorer(subject_of(str(spec)), Patches(nowhere))
    try:
        layer, chosen = second(home, home, state(home, Beside("zeta", 0.05)))
        assert layer.subject.layer_value == 0.05 and chosen.plane == layer.subject.plane
        assert second(home, home, state(home, Beside("zeta", 0.03)))[0] is home
    finally:
        home.stop()


@pytest.mark.parametrize(
    ("beside", "message"),
    [
        (Beside("R", 1.5), "R = 1.5: must satisfy 0 <= R <= 1"),
        (Beside("omega", 1.5), "omega is no parameter of this plane"),
        (Beside("R"), "second.of: found 'R', must be plane, atlas or PARAMETER,VALUE"),
        (Beside("plane", drawn="regions"), "second.drawn: two-mass has no 'regions'"),
        (Beside("plane", drawn="scalar:colour"), "second.drawn: two-mass has no 'colour'"),
    ],
)
def test_a_second_plane_that_there_is_not_is_refused(home: Explorer, beside: Beside, message: str) -> None:
    with pytest.raises(InputError, match=message):
        second(home, home, state(home, beside))


def test_without_another_atlas_there_is_none_to_be_shown(home: Explorer) -> None:
    home.other = None
    with pytest.raises(InputError, match="there is no second atlas; name it by --with"):
        second(home, home, state(home, Beside("atlas")))


@pytest.mark.parametrize(
    "beside", [Beside("R", 0.7), Beside("atlas", drawn="difference"), Beside("plane", drawn="scalar:period")]
)
def test_an_address_restores_the_second_plane(home: Explorer, beside: Beside) -> None:
    chosen = replace(beginning(home.subject), beside=beside)
    pairs = parse_qs(to_address(home.subject, home.subject, chosen))
    arguments = {name: [text.encode() for text in texts] for name, texts in pairs.items()}
    assert from_address(home.subject, arguments) == chosen


def test_the_second_plane_goes_along_to_other_axes_unless_its_parameter_is_one_of_them(home: Explorer) -> None:
    chosen = replace(beginning(home.subject), beside=Beside("R", 0.7))
    values = {"omega": 2.0, "b": 0.1} | dict(chosen.plane.parameters)
    assert carried(home.turned(("zeta", "b")).subject, chosen, values).beside == chosen.beside
    assert carried(home.turned(("R", "b")).subject, chosen, values).beside is None


def test_atlases_of_other_axes_or_scales_are_refused_in_one_line_that_names_both() -> None:
    found = r"found zeta \(linear\), b \(linear\); must be those of the first, omega \(linear\), b \(linear\)"
    with pytest.raises(InputError, match=found):
        check_axes(subject_over(), subject_over(zeta=[0.01, 0.02], b=[0.1, 0.2]))
    log = {"start": 1, "stop": 3, "num": 3, "scale": "log"}
    with pytest.raises(InputError, match=r"found omega \(log\)"):
        check_axes(subject_over(), subject_over(omega=log, b=[0.1, 0.2]))
    with pytest.raises(InputError, match="found b"):
        explore(subject_over(), other=subject_over(b=[0.1, 0.2], omega=[1.0, 2.0]))


def test_the_command_refuses_them_before_it_loads_kernels(tmp_path: Path) -> None:
    spec = tmp_path / "other.toml"
    spec.write_text('system = "two-mass"\n[axes]\nR = [0.5, 0.6]\nb = [0.1, 0.2]\n')
    assert subject_of(str(spec)).axes == ("R", "b")
    ran = CliRunner().invoke(main, ["explore", "omega-b", "--with", str(spec), "--no-browser"])
    assert ran.exit_code == 2 and "the axes of the second atlas: found R (linear)" in ran.stderr
    assert "kernels" not in ran.stderr
    ran = CliRunner().invoke(main, ["explore", "omega-b", "--with", str(spec), "-o", str(tmp_path / "a.html")])
    assert ran.exit_code == 2 and "--with is for the explorer in the browser" in ran.stderr


@pytest.mark.parametrize(
    ("name", "value", "expected"), [("R", 0.8, 0.72), ("zeta", 0.0, 0.1), ("R", 0.0, 0.1), ("mu_m", 2.0, 1.8)]
)
def test_a_second_plane_begins_with_another_value_that_is_valid(name: str, value: float, expected: float) -> None:
    assert nearby(find_system("two-mass").parameter(name), value) == expected
