"""The equation of a user's own system, which `atlas systems` writes out of its definition where it has no text."""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from atlas.cli.main import main
from atlas.spec.equation import equation_of
from tests.project.test_docs import ROOT, files
from workers import System
from workers.model.system import find_system

OWN = files(ROOT / "docs/systems.md")["gear-pair.toml"]
"""The definition that the page shows: the equations below are written by hand from its tables and the next ones."""
UNEQUAL = """
[system]
name = "damper"
coordinates = ["x1", "x2"]
mass = [[1.0, 0.0], [0.0, "mu"]]
damping = [["2 * zeta + c", "-c"], ["-c", "c"]]
stiffness = [["1 + k", "-k"], ["-k", "k"]]
force = [1.0, 0.0]
gap = [-1.0, 1.0]
upper = "b"
lower = "-ratio * b"
restitution = "R"
[system.let]
c = "2 * xi * mu"
k = "phi**2 * mu"
[system.parameters]
mu = 0.1
zeta = 0.02
xi = 0.02
phi = 0.2
b = 5.0
ratio = 1.5
R = 0.6
"""

GEARS = """\
y'' + beta * y' = -drag + alpha * omega**2 * sin(omega t + tau) + 4 * alpha2 * omega**2 * sin(2 (omega t + tau) + psi)
-nu / 2 <= y <= nu / 2
at a stop y' -> -R * y'"""
DAMPER = """\
x1'' + (2 * zeta + c) * x1' - c * x2' + (1 + k) * x1 - k * x2 = sin(omega t + tau)
mu * x2'' - c * x1' + c * x2' - k * x1 + k * x2 = 0
gap = -x1 + x2
-ratio * b <= gap <= b
at a stop gap' -> -R * gap'
c = 2 * xi * mu
k = phi**2 * mu"""


@pytest.mark.parametrize(("definition", "written"), [(OWN, GEARS), (UNEQUAL, DAMPER)], ids=["gears", "damper"])
def test_a_system_without_an_equation_in_words_has_it_written_out(definition: str, written: str) -> None:
    assert equation_of(System.from_toml(definition)) == written


def test_the_authors_own_words_stand_where_there_are_any() -> None:
    named = find_system("two-mass")
    assert equation_of(named) == named.equation != equation_of(replace(named, equation=""))


@pytest.mark.parametrize(
    ("entry", "shown"),
    [
        ("1.50*a", "1.5 * a * sin(omega t + tau)"),
        ("a - -b", "(a - -b) * sin(omega t + tau)"),
        ("-(a+b)", "-(a + b) * sin(omega t + tau)"),
        ("(a+b)*(b-1)", "(a + b) * (b - 1) * sin(omega t + tau)"),
        ("a**-2 / sqrt(a+b)", "a**-2 / sqrt(a + b) * sin(omega t + tau)"),
        ("max(a, -b)", "max(a, -b) * sin(omega t + tau)"),
        (-1.0, "-sin(omega t + tau)"),
        (0.0, "0"),
    ],
)
def test_an_entry_stands_in_the_equation_as_one_writes_it(entry: str | float, shown: str) -> None:
    """A sum in parentheses, a sign without a space, a whole number without its point, nothing where it is zero."""
    own = System.from_mapping({
        "name": "own", "coordinates": ["x"], "mass": [[1.0]], "stiffness": [[4.0]], "force": [entry], "gap": [1.0],
        "lower": -3.0, "restitution": 0.5, "parameters": {"a": {"default": 9.0}, "b": {"default": 2.0}},
    })  # fmt: skip
    assert equation_of(own).splitlines() == [f"x'' + 4 * x = {shown}", "-3 <= x", "at a stop x' -> -0.5 * x'"]


def test_the_command_shows_it(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN)
    shown = CliRunner().invoke(main, ["systems", str(tmp_path / "own.toml")])
    assert shown.exit_code == 0
    assert [f"    {line}" for line in GEARS.splitlines()] == shown.stdout.splitlines()[2:5]


@pytest.mark.parametrize(
    ("belt", "line"),
    [(0.0, "friction rub: 0.1 against v"), (0.5, "friction rub: 0.1 against v = v - 0.5")],
)
def test_a_sliding_velocity_that_is_the_masss_own_is_named_once(belt: float, line: str) -> None:
    rub = {"name": "rub", "row": [1.0], "kinetic": 0.1, "belt": belt}
    made = System.from_mapping(
        {
            "name": "rubbed",
            "coordinates": ["x"],
            "mass": [[1.0]],
            "stiffness": [[1.0]],
            "force": [1.0],
            "friction": [rub],
        }
    )
    assert line in equation_of(made).splitlines()


def test_each_phase_has_its_expressions_in_the_equation() -> None:
    definition = {
        "name": "meshing", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]],
        "stiffness": [[2.0, 0.0], [0.0, 2.0]], "force": [1.0, 0.0], "load": [0.0, 0.0],
        "contacts": [{"name": "mesh", "gap": [1.0, 0.0], "upper": 0.0, "stiffness": 9.0, "damping": 0.1,
                      "release": "displacement"}],
        "phases": [
            {"start": 0.0, "contacts": {"mesh": {"stiffness": "k", "damping": 0.3}}},
            {"start": 0.25, "contacts": {"mesh": {"stiffness": "2 * k"}}, "stiffness": [["k", 0.0], [0.0, 3.0]]},
            {"start": 0.5, "load": [0.0, "k + 1"]},
        ],
        "parameters": {"k": {"default": 4.0}},
    }  # fmt: skip
    lines = equation_of(System.from_mapping(definition)).splitlines()
    assert [line for line in lines if line.startswith("from")] == [
        "from 0 of the period on: stiffness of mesh = k, damping of mesh = 0.3",
        "from 0.25 of the period on: stiffness ((k, 0), (0, 3)), stiffness of mesh = 2 * k",
        "from 0.5 of the period on: load (0, k + 1)",
    ]
