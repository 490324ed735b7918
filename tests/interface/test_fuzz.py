"""Any input whatever, a spec or an option: done, or one line and exit code 2, and nothing written."""

import json
import math
from collections.abc import Mapping
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from click.testing import CliRunner
from hypothesis import example, given
from hypothesis import strategies as st

from atlas import Spec
from atlas.cli.main import main
from atlas.errors import MAX_MESSAGE_LENGTH, InputError
from atlas.spec.extension import refine_spec
from atlas.store.create import create_store
from atlas.store.object_backend import open_backend
from tests.fuzzing import fuzz
from tests.synthetic import fill, spec_of
from workers.model.system import find_system

TWO_MASS = find_system("two-mass")

pytestmark = pytest.mark.slow

GOOD: dict[str, dict[str, str]] = {
    "": {"system": '"two-mass"'},
    "parameters": {"R": "0.7", "f2": "0.0"},
    "axes.omega": {"start": "2.0", "stop": "4.0", "num": "5"},
    "axes.x1": {"values": "[-0.1, 0.0, 0.1]"},
    "solve": {"max_periods": "400", "tolerance": "0.1"},
    "store": {"tile": "[1, 2]"},
}
NUMBERS = ["0", "-0.0", "1e300", "-1e308", "1.7e308", "5e-324", "1e400", "nan", "-inf", "9" * 400, "9" * 5000, "١"]
LITERALS = [
    *NUMBERS, "true", "[]", "{}", "[1, 2]", "[0.1, nan]", "[1e308, -1e308]", "['a']", "0x" + "f" * 5000, '""',
    "'" + "x" * 6000 + "'", "[" * 5000, "[" * 90 + "]" * 90, "{a=" * 50 + "1" + "}" * 50, "1979-05-27", "'log'",
    "'forward'", "'spectrum'", "'fixed'", '"two-mas"', "99999999999", "4294967296",
]  # fmt: skip
SECTIONS = [*GOOD, "axes", "axes.b", "axes.omgea", "axes.omega.values", "solver", "parameters.R"]
KEYS = [
    *{key for table in GOOD.values() for key in table}, "scale", "continuation", "exponents", "method", "omega", "b",
    "section_samples", "transient_periods", "a.b", '"\\u0000"', "R" * 6000, ".".join("a" * 20_000), "",
]  # fmt: skip


def written(number: float) -> str:
    """As TOML writes it."""
    return repr(number)


literals = st.one_of(
    st.sampled_from(LITERALS),
    st.floats().map(written),
    st.integers(-(2**70), 2**70).map(str),
    st.lists(st.floats(0.01, 9.0), max_size=4).map(lambda values: str(sorted(values))),
    st.text(max_size=20).map(lambda text: json.dumps(text, ensure_ascii=False)),
)
edits = st.lists(
    st.tuples(st.sampled_from(SECTIONS), st.sampled_from(KEYS), st.none() | literals), min_size=1, max_size=3
)


def toml_of(changes: list[tuple[str, str, str | None]]) -> str:
    """The good spec with some of its lines changed, added or left out."""
    tables = {name: dict(table) for name, table in GOOD.items()}
    for section, key, value in changes:
        table = tables.setdefault(section, {})
        if value is None:
            table.pop(key, None)
        else:
            table[key] = value
    blocks = (
        (f"[{name}]\n" if name else "") + "".join(f"{k} = {v}\n" for k, v in t.items()) for name, t in tables.items()
    )
    return "\n".join(blocks)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A spec's bytes, some of them left out or replaced by others."""
    whole = toml_of(draw(edits)).encode()
    first, last = sorted(draw(st.tuples(st.integers(0, len(whole)), st.integers(0, len(whole)))))
    return whole[:first] + draw(st.binary(max_size=8)) + whole[last:]


def check(args: list[str], folder: Path) -> int:
    """The exit code of a command that either does its work or refuses it in one line; it writes nothing."""
    before = sorted(folder.rglob("*"))
    shown = CliRunner().invoke(main, args)
    if shown.exit_code:
        assert shown.exit_code == 2, shown.stderr
        assert shown.stdout == ""
        assert len(shown.stderr.splitlines()) == 1, shown.stderr
        assert shown.stderr.startswith("Error: ")
        assert len(shown.stderr) < MAX_MESSAGE_LENGTH + 20
    assert sorted(folder.rglob("*")) == before
    return shown.exit_code


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store of made-up results."""
    made = tmp_path_factory.mktemp("fuzz")
    fill(create_store(open_backend(made / "out.zarr"), spec_of(5, 4), (4, 5)))
    return made


def plan(folder: Path, content: bytes) -> int:
    spec = folder / "spec.toml"
    spec.write_bytes(content)
    return check(["plan", str(spec), "-o", str(folder / "new.zarr"), "--no-probe", "--workers", "2"], folder)


def test_the_spec_that_the_others_are_made_from_is_good(folder: Path) -> None:
    assert plan(folder, toml_of([]).encode()) == 0


@fuzz(examples=200)
@given(edits)
@example(
    [("axes.x1", "values", None), ("axes.x1", "start", "-1e308"), ("axes.x1", "stop", "1e308"), ("axes.x1", "num", "9")]
)
@example([("", ".".join("a" * 20_000), "1")])
@example([("", "system.a" + ".a" * 90, "1"), ("", "system", None)])
def test_a_spec_with_changed_lines_is_planned_or_refused_in_one_line(
    folder: Path, changes: list[tuple[str, str, str | None]]
) -> None:
    plan(folder, toml_of(changes).encode())


@fuzz(examples=100)
@given(damaged() | st.binary(max_size=40))
def test_a_damaged_spec_is_planned_or_refused_in_one_line(folder: Path, content: bytes) -> None:
    plan(folder, content)


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.just(5000).map(lambda digits: 10**digits)
    | st.floats()
    | st.text(max_size=5)
    | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS) | st.text(), inner, max_size=3),
    max_leaves=6,
)
names = st.sampled_from([parameter.name for parameter in TWO_MASS.parameters])
axis = st.fixed_dictionaries(
    {}, optional=dict.fromkeys(("start", "stop", "num", "values", "scale", "continuation"), values)
)
mappings = st.fixed_dictionaries(
    {"system": st.just("two-mass") | values, "axes": st.dictionaries(names, axis | values, max_size=3) | values},
    optional={
        "parameters": st.dictionaries(names, values, max_size=3) | values,
        "solve": st.dictionaries(st.sampled_from(KEYS), values, max_size=3) | values,
        "store": st.fixed_dictionaries({"tile": values}) | values,
        "other": values,
    },
)


@fuzz(examples=200)
@given(mappings)
def test_a_mapping_is_a_spec_or_refused_in_one_line(mapping: Mapping[str, Any]) -> None:
    try:
        Spec.from_mapping(mapping)
    except InputError as error:
        assert len(str(error).splitlines()) == 1
        assert len(str(error)) <= MAX_MESSAGE_LENGTH


numbers = st.sampled_from(NUMBERS) | st.floats().map(repr) | st.text(max_size=8)
windows = st.tuples(numbers, numbers).map(":".join) | numbers
known = names | st.sampled_from(["omega", "b"]) | st.text(max_size=5)


def options(option: str, value: st.SearchStrategy[str]) -> st.SearchStrategy[list[str]]:
    """Up to three times the option, with NAME=VALUE or any text."""
    given_one = st.tuples(known, value).map("=".join) | st.text(max_size=12) | value
    return st.lists(given_one.map(lambda text: f"{option}={text}"), max_size=3)


@fuzz(examples=100)
@given(st.tuples(*(options(name, numbers) for name in ("--set", "--tolerance", "--max-periods"))))
def test_any_cell_asked_for_is_solved_or_refused_in_one_line(folder: Path, found: tuple[list[str], ...]) -> None:
    """Solved by a stand-in: test_out_of_range has the real one."""
    with patch.object(import_module("atlas.cell.point"), "point", return_value={}):
        check(["point", *chain.from_iterable(found), "--json"], folder)


@fuzz(examples=60)
@given(options("--at", numbers))
def test_any_point_is_answered_or_refused_in_one_line(folder: Path, given_options: list[str]) -> None:
    check(["query", str(folder / "out.zarr"), *given_options], folder)


@fuzz(examples=60)
@given(options("--window", windows))
def test_any_window_is_answered_or_refused_in_one_line(folder: Path, given_options: list[str]) -> None:
    check(["query", str(folder / "out.zarr"), *given_options], folder)


@fuzz(examples=60)
@given(
    st.sampled_from(["--sample", "--refine", "--workers", "--retry", "--scheduler", "--kind", "--system", "--no-such"]),
    numbers | st.text(max_size=30),
    st.sampled_from(["verify", "extend", "run", "plot", "point", "plan", "status"]),
)
def test_any_option_of_a_command_without_its_input_is_refused_in_one_line(
    folder: Path, option: str, value: str, command: str
) -> None:
    missing = str(folder / "none.toml")
    args = [] if command == "point" else [missing] if command in ("verify", "status") else [missing, "-o", missing]
    check([command, *args, f"{option}={value}"], folder)


factors = (
    st.integers(-3, 40)
    | st.integers(min_value=10**7)
    | st.just(5000).map(lambda digits: 10**digits)
    | st.booleans()
    | st.floats()
)


@fuzz(examples=100)
@given(factors | st.dictionaries(st.sampled_from(["omega", "b", "R"]), factors))
def test_any_factor_refines_or_is_refused_in_one_line(factor: Any) -> None:
    try:
        assert math.prod(refine_spec(spec_of(5, 4), factor).shape) > 20
    except InputError as error:
        assert len(str(error)) <= MAX_MESSAGE_LENGTH
