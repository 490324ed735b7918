"""The JSON Schema of a spec: true of every spec that is accepted, and refuses what the checker refuses.

Truth: the checker itself, ``Spec``; the independent implementation of JSON Schema is ``jsonschema``.
"""

import json
from typing import Any

import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.spec.examples import example_names, example_text
from atlas.spec.json_schema import DRAFT, spec_schema
from workers.model.system import find_system, system_names
from workers.model.toml_text import parse_toml

VALIDATOR = Draft202012Validator(spec_schema())
AXES = "[axes.omega]\nstart = 2.0\nstop = 4.0\nnum = 5\n"
GOOD = f'system = "two-mass"\n{AXES}'
OWN = """
[system]
name = "own"
coordinates = ["x"]
mass = [[1.0]]
stiffness = [["k"]]
force = [1.0]
gap = [1.0]
upper = "b"
restitution = 0.8
parameters = { k = 1.0, b = { default = 0.1, low = -inf, high = inf, unit = "m" } }
"""


def faults(text: str) -> list[str]:
    return [error.message for error in VALIDATOR.iter_errors(parse_toml(text))]


def test_the_schema_is_one_of_draft_2020_12_and_the_command_prints_it() -> None:
    Draft202012Validator.check_schema(spec_schema())
    printed = CliRunner().invoke(main, ["schema"])
    assert printed.exit_code == 0
    assert json.loads(printed.stdout) == spec_schema()
    assert spec_schema()["$schema"] == DRAFT


@pytest.mark.parametrize("name", example_names())
def test_every_packaged_example_is_valid(name: str) -> None:
    assert faults(example_text(name)) == []


@pytest.mark.parametrize("name", system_names())
def test_every_packaged_machine_in_full_is_valid(name: str) -> None:
    """All entries of a definition, with the kinds of elements that packaged machines have."""
    given = {"system": find_system(name).table(), "axes": {"omega": {"values": [1.0, 2.0]}}}
    assert [error.message for error in VALIDATOR.iter_errors(given)] == []


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        f"{OWN}{AXES}",
        f'system = "machine.toml"\n{AXES}',
        'system = "two-mass"\n[points]\nfile = "sets.csv"\n',
        'system = "two-mass"\n[points]\nomega = [2.0, 3.0]\nb = [0.1, 0.2]\n',
        'system = "two-mass"\n[axes]\nomega = [2.0, 3.0]\nb = { values = [0.1, 0.2], scale = "log" }\n',
        f"{OWN}cosine = [1.0]\nharmonics = [{{ order = '3/2', force = ['pi'], cosine = [0.1] }}]\n{AXES}",
        f"{GOOD}continuation = 'forward'\n[store]\ntile = [5]\n",
        f"{GOOD}[solve]\ntolerance = 1\n[attractors]\nstarts = 8\nbox = {{ x1 = [-0.1, 0.1] }}\n",
    ],
)
def test_other_forms_that_the_checker_takes_are_valid(text: str) -> None:
    assert faults(text) == []
    if ".toml" not in text and ".csv" not in text:
        atlas.Spec.from_mapping(parse_toml(text))


WRONG = {
    "a key that does not exist": f"{GOOD}[sovle]\ntolerance = 0.1\n",
    "a system that does not exist": f'system = "two-masses"\n{AXES}',
    "no system": AXES,
    "no cells": 'system = "two-mass"\n',
    "axes and points": f"{GOOD}[points]\nb = [0.1]\n",
    "four axes": GOOD + "".join(f"[axes.{name}]\nvalues = [0.1]\n" for name in ("b", "R", "zeta")),
    "a parameter of another system": f"{GOOD}[parameters]\nclearance = 1.0\n",
    "a parameter out of its range": f"{GOOD}[parameters]\nR = 1.5\n",
    "a value of an axis out of its range": 'system = "two-mass"\n[axes]\nR = [0.5, 1.5]\n',
    "an end of an axis out of its range": GOOD.replace("2.0", "-2.0"),
    "an axis without a number of values": 'system = "two-mass"\n[axes.omega]\nstart = 2.0\nstop = 4.0\n',
    "values and a start": f"{GOOD}values = [1.0]\n",
    "a text for a number": GOOD.replace("2.0", "'2.0'"),
    "a broken number of values": GOOD.replace("num = 5", "num = 5.5"),
    "a log axis from 0": 'system = "two-mass"\n[axes.x1]\nstart = 0.0\nstop = 1.0\nnum = 5\nscale = "log"\n',
    "a scale that does not exist": f'{GOOD}scale = "cubic"\n',
    "a word for a setting": f'{GOOD}[solve]\nexponents = "all"\n',
    "a tolerance of 0": f"{GOOD}[solve]\ntolerance = 0\n",
    "a setting beyond its limit": f"{GOOD}[solve]\nmax_period = 10001\n",
    "more attractors kept than can be": f"{GOOD}[attractors]\nkeep = 65\n",
    "a box of a component that does not exist": f"{GOOD}[attractors]\nbox = {{ x9 = [0.0, 1.0] }}\n",
    "a tile of no cells": f"{GOOD}[store]\ntile = [0]\n",
    "a machine without a mass": f"{OWN.replace('mass = [[1.0]]', '')}{AXES}",
    "a machine with a key that does not exist": f"{OWN.replace('gap', 'gpa')}{AXES}",
    "a name with a space": f"{OWN.replace('own', 'my own')}{AXES}",
    "an order beyond the highest": f"{OWN}harmonics = [{{ order = 33, force = [1.0] }}]\n{AXES}",
    "an order of 0": f"{OWN}harmonics = [{{ order = '0/2', force = [1.0] }}]\n{AXES}",
    "a harmonic with a waveform": f"{OWN}harmonics = [{{ order = 1, force = [1.0], waveform = 'triangle' }}]\n{AXES}",
    "a measure of what cannot be reported": f"{OWN}measures.d = {{ velocity = [1.0], report = ['sum'] }}\n{AXES}",
}


@pytest.mark.parametrize("what", WRONG)
def test_what_the_checker_refuses_the_schema_refuses(what: str) -> None:
    given: Any = parse_toml(WRONG[what])
    with pytest.raises(InputError):
        atlas.Spec.from_mapping(given)
    assert faults(WRONG[what])
