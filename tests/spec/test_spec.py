import json
import os
from pathlib import Path

import numpy as np
import pytest

from atlas import Spec
from atlas.errors import InputError
from atlas.spec.examples import example_names
from atlas.spec.resolved import resolved_digest
from workers import Settings
from workers.model.system import system_names

OMEGA = {"start": 2.0, "stop": 4.0, "num": 5}
B = {"values": [0.1, 0.2, 0.4]}


def make(**changes: object) -> Spec:
    return Spec(**({"system": "two-mass", "axes": {"omega": OMEGA, "b": B}} | changes))


def test_the_first_axis_is_the_last_dimension() -> None:
    assert make().dims == ("b", "omega")
    assert make().shape == (3, 5)


def test_a_single_axis_makes_a_sweep() -> None:
    assert make(axes={"omega": OMEGA}).dims == ("omega",)


def test_parameters_not_given_have_their_defaults_and_axes_are_not_among_them() -> None:
    spec = make(parameters={"R": 0.5})
    assert spec.parameters["R"] == 0.5
    assert spec.parameters["mu_k"] == 5.0
    assert not {"omega", "b"} & spec.parameters.keys()


def test_an_axis_may_be_given_as_an_array() -> None:
    assert make(axes={"omega": np.linspace(2.0, 4.0, 5)}).axes == make(axes={"omega": OMEGA}).axes


def test_a_log_axis_grows_by_a_constant_factor() -> None:
    (axis,) = make(axes={"omega": {"start": 1, "stop": 100, "num": 3, "scale": "log"}}).axes
    assert axis.values == pytest.approx((1.0, 10.0, 100.0))


def test_a_resolved_spec_survives_json_exactly() -> None:
    spec = make(parameters={"R": 0.1}, solve={"exponents": "spectrum"})
    assert Spec.from_resolved(json.loads(json.dumps(spec.to_resolved()))) == spec


def test_settings_may_be_given_as_their_record() -> None:
    assert make(solve=Settings(max_periods=7)).digest == make(solve={"max_periods": 7}).digest


def test_a_survival_at_its_default_does_not_enter_the_digest() -> None:
    """Specs from before there was that setting keep theirs."""
    default = Settings().survival
    resolved = make(solve={"survival": default}).to_resolved()
    assert resolved["solve"].pop("survival") == default
    assert resolved_digest(resolved) == make(solve={"survival": default}).digest == make().digest


def test_tile_shape_does_not_enter_the_digest() -> None:
    assert make(store={"tile": [1, 2]}).digest == make().digest


@pytest.mark.parametrize(
    "changes",
    [
        {"axes": {"b": B, "omega": OMEGA}},
        {"parameters": {"R": 0.5}},
        {"solve": {"tolerance": 0.5}},
        {"solve": {"survival": 0}},
        {"axes": {"omega": OMEGA, "b": {"values": [0.1, 0.2, 0.4000000000000001]}}},
    ],
    ids=["axis order", "parameter", "setting", "setting of later", "last bit of an axis value"],
)
def test_the_digest_distinguishes(changes: dict[str, object]) -> None:
    assert make(**changes).digest != make().digest


def test_equal_numbers_written_differently_have_one_digest() -> None:
    assert make(parameters={"mu_k": 5, "f2": -0.0}, solve={"tolerance": 1}).digest == (
        make(parameters={"mu_k": 5.0, "f2": 0.0}, solve={"tolerance": 1.0}).digest
    )


def test_cell_params_broadcast_to_the_shape_of_the_block() -> None:
    params = make().cell_params((slice(0, 2), slice(1, 5)))
    assert np.broadcast_shapes(*(np.shape(value) for value in params.values())) == (2, 4)
    assert params["b"].ravel().tolist() == [0.1, 0.2]
    assert isinstance(params["R"], float)


def test_cell_params_of_a_sweep_are_one_dimensional() -> None:
    assert make(axes={"omega": OMEGA}).cell_params((slice(1, 3),))["omega"].shape == (2,)


@pytest.mark.parametrize("name", example_names())
def test_every_packaged_example_is_a_valid_spec(name: str) -> None:
    spec = Spec.from_toml(name)
    assert spec.system_def.packaged == (spec.system in system_names())


def test_a_file_is_preferred_to_an_example_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tiny").write_text('system = "two-mass"\n[axes.tau]\nvalues = [0.0, 1.0]\n')
    monkeypatch.chdir(tmp_path)
    assert Spec.from_toml("tiny").dims == ("tau",)


BAD = [
    ({"system": "three-mass"}, "unknown system 'three-mass'; did you mean 'two-mass'?"),
    ({"parameters": {"mu_kk": 1.0}}, "unknown parameter 'mu_kk'; did you mean 'mu_k'?"),
    ({"parameters": {"R": 1.2}}, "R = 1.2: must satisfy 0 <= R <= 1"),
    ({"parameters": {"mu_m": -1.0}}, "mu_m = -1.0: must satisfy 0 < mu_m"),
    ({"parameters": {"R": float("nan")}}, "R = nan: must be a finite number"),
    ({"parameters": {"f2": float("inf")}}, "f2 = inf: must be a finite number"),
    ({"parameters": {"R": True}}, "R: found True, must be a number"),
    ({"parameters": {"R": "0.5"}}, "R: found '0.5', must be a number"),
    ({"parameters": {"f2": 10**400}}, "must be a finite number"),
    ({"parameters": {"b": 0.1}}, "b is both a parameter and an axis"),
    ({"parameters": [1]}, "parameters: found [1], must be a table"),
    ({"axes": {}}, "axes: found none, must be one to three"),
    ({"axes": {"omega": OMEGA, "b": B, "tau": B, "R": B}}, "axes: found 4 (omega, b, tau, R), must be one to three"),
    ({"axes": {"omgea": OMEGA}}, "unknown parameter in axes 'omgea'; did you mean 'omega'?"),
    ({"axes": {"omega": 3.0}}, "axes.omega: found 3.0, must be a table"),
    ({"axes": {"omega": OMEGA | {"step": 1}}}, "unknown key in axes.omega 'step'"),
    ({"axes": {"omega": OMEGA | {"num": 0}}}, "axes.omega.num: found 0 points"),
    ({"axes": {"omega": OMEGA | {"num": True}}}, "axes.omega.num: found True, must be a whole number"),
    ({"axes": {"omega": OMEGA | {"num": 2.5}}}, "axes.omega.num: found 2.5, must be a whole number"),
    ({"axes": {"omega": OMEGA | {"num": 10**12}}}, "axes.omega.num: found 1000000000000 points"),
    ({"axes": {"omega": OMEGA | {"start": 0.0}}}, "omega = 0.0: must satisfy 0 < omega"),
    ({"axes": {"omega": OMEGA | {"start": float("nan")}}}, "axes.omega.start = nan: must be a finite number"),
    ({"axes": {"omega": OMEGA | {"stop": 1.0}}}, "axes.omega: start 2.0 must be less than stop 1.0"),
    ({"axes": {"omega": OMEGA | {"scale": "cubic"}}}, "axes.omega.scale: found 'cubic', must be one of linear, log"),
    ({"axes": {"f2": {"start": 0, "stop": 1, "num": 3, "scale": "log"}}}, "found 0.0 on a log scale, must be > 0"),
    ({"axes": {"f2": {"values": [-1.0, 1.0], "scale": "log"}}}, "found -1.0 on a log scale, must be > 0"),
    ({"axes": {"omega": {"start": 1}}}, "axes.omega: stop, num missing"),
    ({"axes": {"omega": {}}}, "axes.omega: start, stop, num missing"),
    ({"axes": {"x1": {"start": -1e308, "stop": 1e308, "num": 3}}}, "from start -1e+308 to stop 1e+308 is farther"),
    ({"axes": None}, "axes: found None, must be a table"),
    ({"axes": {"omega": OMEGA | {"num": 10**5000}}}, "axes.omega.num: found a whole number of thousands of digits"),
    ({"parameters": {"f2": 10**5000}}, "f2: found a whole number of thousands of digits, must be a finite number"),
    ({"parameters": {"R": "x" * 6000}}, "xxx...xxx"),
    ({"system": ["two-mass"]}, "system: found ['two-mass'], must be the name of a system, a .toml file or a table"),
    ({"solve": []}, "solve: found [], must be a table"),
    ({"solve": {"tolerance": 10**400}}, "solve.tolerance: found 1000"),
    ({"solve": {"survival": -1}}, "solve.survival: found -1, must be a whole number, 0 to 500000000"),
    ({"solve": {"survival": 500_000_001}}, "solve.survival: found 500000001, must be a whole number"),
    ({"solve": {"survival": 2.5}}, "solve.survival: found 2.5, must be a whole number"),
    ({"solve": {"surviv": 5}}, "unknown key in solve 'surviv'; did you mean 'survival'?"),
    ({"solve": {"max_periods": 10**5000}}, "solve.max_periods: found a whole number of thousands of digits"),
    ({"axes": {"omega": {"values": []}}}, "axes.omega.values: found 0 points"),
    ({"axes": {"omega": {"values": 3.0}}}, "axes.omega.values: found 3.0, must be a list of numbers"),
    ({"axes": {"omega": OMEGA | B}}, "axes.omega: found values and start"),
    ({"axes": {"omega": {"values": [1.0, 3.0, 2.0]}}}, "found 2.0 after 3.0, must be strictly increasing"),
    ({"axes": {"b": {"values": [-0.1, 0.1]}}}, "b = -0.1: must satisfy 0 < b"),
    ({"solve": {"tolerence": 1.0}}, "unknown key in solve 'tolerence'; did you mean 'tolerance'?"),
    ({"solve": {"tolerance": True}}, "solve.tolerance: found True"),
    ({"solve": {"exponents": "some"}}, "solve.exponents: found 'some', must be one of none, largest, spectrum"),
    ({"store": {"tiles": [1, 1]}}, "unknown key in store 'tiles'; did you mean 'tile'?"),
    ({"store": {"tile": [4]}}, "store.tile: found [4], must be two whole numbers (y, x)"),
    ({"store": {"tile": [0, 4]}}, "store.tile: found [0, 4]"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message for _, message in BAD])
def test_bad_input_is_reported_in_one_line(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        make(**changes)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


BAD_FILES = [
    ("not toml at all", "not a TOML file"),
    ('%%writefile plane.toml\nsystem = "two-mass"\n', "begins with a line of a notebook; leave out the line with %%"),
    ('system = "two-mass"\n[axes.omega]\nnum = 1\n[axes.omega]\nnum = 2\n', "not a TOML file"),
    ('system = "two-mass"\n', "axes missing"),
    ("[axes.omega]\nvalues = [1.0]\n", "system missing"),
    ("a = " + "9" * 5000, "not a TOML file: Exceeds the limit (4300 digits)"),
    ("a = " + "[" * 5000, "nested too deeply"),
    ("a" + ".a" * 200_000 + " = 1", "nested too deeply"),
    ("system" + ".a" * 90 + " = 1\n[axes]", "unknown key in system 'a'"),
    ("#" * 1_000_001, "too large: more than 1000000 bytes"),
    ("\ufeffsystem = 'two-mass'", "begins with a byte order mark"),
    ('system = "two-mass"\naxis = 1\n', "unknown key 'axis'; did you mean 'axes'?"),
]


@pytest.mark.parametrize(("text", "message"), BAD_FILES, ids=[message for _, message in BAD_FILES])
def test_a_bad_file_is_reported_with_its_name(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"bad\.toml") as caught:
        Spec.from_toml(path)
    assert message in str(caught.value)


def test_a_missing_file_names_the_nearest_example() -> None:
    with pytest.raises(InputError, match="no such file, and unknown example 'tinny'; did you mean 'tiny'"):
        Spec.from_toml("tinny")


def test_bytes_that_are_not_text_are_reported_with_their_place(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"system = '\xff'")
    with pytest.raises(InputError, match="not a TOML file: byte 10 is not UTF-8 text"):
        Spec.from_toml(tmp_path / "a.toml")


def test_what_is_no_regular_file_is_not_read(tmp_path: Path) -> None:
    """A pipe without a writer would keep its reader waiting, /dev/zero has no end."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match="cannot be read: not a regular file"):
            Spec.from_toml(path)


def test_a_folder_is_no_spec(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        Spec.from_toml(tmp_path)
