"""Claims about names that an atlas has for something of its own: no parameter of a user's system gets one of them.

Truth is what the package writes: the groups, arrays and dimensions of a store, and the columns of its tables.
"""

import inspect
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import atlas
from atlas.accessor import AtlasAccessor
from atlas.errors import InputError
from atlas.explore.view_state import ARGUMENTS
from atlas.orbits.curves.queries import to_frames
from atlas.orbits.curves.table import Curves, as_arrays
from atlas.orbits.labels.table import BRANCH, OF_BRANCHES
from atlas.overview.coarsen import SHARE, level_variables
from atlas.overview.coordinates import bounds_name, coarse_name
from atlas.render import figure, text
from atlas.robustness.table import MEASURES
from atlas.spec.points import POINT
from atlas.spec.system import parse_system
from atlas.store import create
from atlas.store.host import HOSTS
from atlas.store.origin import ALLOWANCES
from atlas.store.parts import PARTS
from atlas.store.record_format import TILES
from atlas.store.schema import CURVES, OVERVIEWS, TABLES
from tests.workers.model.test_systems import table
from workers import Settings, System
from workers.model.entries import DefinitionError
from workers.model.system import packaged_system, system_names
from workers.results import result_variables

PAGE = Path(atlas.__file__).with_name("explore").joinpath("static", "page.mjs").read_text(encoding="utf-8")
EVERYTHING = Settings(exponents="spectrum", method="fixed", section_samples=1)


def own_names() -> Iterator[str]:
    """What the package calls its own things."""
    yield from (*TABLES, CURVES, PARTS, TILES, HOSTS, OVERVIEWS, BRANCH, POINT, "component", *MEASURES)
    for kind in ({}, {"attractors": True}, {"basins": True}):
        results = result_variables(EVERYTHING, **kind)
        for variable in (*results, *ALLOWANCES, *level_variables(results), SHARE):
            yield from (variable.name, *variable.extra_dims)
    for name, array in as_arrays(Curves(("omega", "b"), ())).items():
        yield from (name, *array.dims)
    yield from (variable.name for variable in OF_BRANCHES)
    yield from set(to_frames(Curves(("omega", "b"), ())).corners.columns) - {"omega", "b"}
    yield from (coarse_name("omega"), bounds_name(coarse_name("omega")))
    yield from ARGUMENTS
    yield from set(re.findall(r"`(\w+)=", PAGE))
    for function in vars(AtlasAccessor).values():
        if inspect.isfunction(function) and "point" in inspect.signature(function).parameters:
            named = inspect.signature(function).parameters.values()
            yield from {parameter.name for parameter in named if parameter.kind is not parameter.POSITIONAL_ONLY} - {
                "point"
            }


def with_parameter(name: str) -> dict[str, object]:
    given = table()
    return given | {"parameters": given["parameters"] | {name: {"default": 1.0}}}


@pytest.mark.parametrize("name", sorted(set(own_names())))
def test_a_name_that_an_atlas_has_for_its_own_is_no_parameters(name: str) -> None:
    why = "has another meaning already" if name.isidentifier() else "must be a name of letters"
    with pytest.raises(DefinitionError, match=f"system.parameters.{name}: .*{why}"):
        System.from_mapping(with_parameter(name))


def test_no_packaged_system_has_such_a_name() -> None:
    for name in system_names():
        System.from_mapping(packaged_system(name).table())


def test_a_store_from_before_its_parameters_name_was_taken_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workers.model.parse_definition.is_taken", lambda name: False)
    spec = atlas.Spec(with_parameter("distance"), {"omega": [1.0, 2.0]})
    create.create_store(tmp_path / "old.zarr", spec, (2,))
    monkeypatch.undo()
    assert atlas.open(tmp_path / "old.zarr").coords["distance"] == 1.0
    with pytest.raises(InputError, match="'distance' has another meaning"):
        parse_system(json.loads(json.dumps(spec.to_resolved()))["system"])


@pytest.mark.parametrize("symbol", ["\\frac{", "a_b_c", "\\nosuch", ""])
def test_a_symbol_that_is_no_mathtext_is_shown_as_the_name(tmp_path: Path, symbol: str) -> None:
    given = with_parameter("stiff_2")
    given["parameters"] |= {name: {"default": 1.0, "symbol": symbol} for name in ("stiff_2", "p")}
    handle = create.create_store(
        tmp_path / "a.zarr", atlas.Spec(given, {"stiff_2": [1.0, 2.0], "r": [0.5, 0.6]}), (2, 2)
    )
    drawn = figure(atlas.open(handle.path))
    drawn.canvas.draw()
    assert drawn.axes[0].get_xlabel() == r"$\mathit{stiff\_2}$"
    assert text.state_symbol(handle.spec.system_def, "p") == r"\mathit{p}"


@pytest.mark.filterwarnings("error")
def test_a_mass_beyond_double_precision_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"^system.mass: found .*double precision"):
        parse_system(table() | {"mass": [[1e-320, 0.0], [0.0, 1e-320]]})
