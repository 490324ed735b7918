"""Every number that a store holds says what it means and has a unit that UDUNITS can parse.

Truth: UDUNITS's own table, of which this package needs the entries below (``udunits2 -A -H 1 -W rad``). Periods are in
none of its tables.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

import atlas
from atlas.orbits.curves.table import CodimTwoPoint, Curve, Curves, write_curves
from atlas.orbits.labels.table import AttractorLabels, LabelCounts, write_labels
from atlas.overview.coarsen import level_variables
from atlas.robustness.table import MEASURES, StoredMeasures, write_measures
from atlas.store import create, store
from atlas.store.origin import ALLOWANCES
from tests.synthetic import complete
from workers.model.system import find_system, system_names
from workers.results import result_variables

UNITS = {"1", "rad"}
TEXT = {"string", "variable_length_utf8"}


def arrays(path: Path) -> Iterator[tuple[str, str, tuple[str, ...], Mapping[str, Any]]]:
    """Name, type, dimensions and attributes of every array of every group of a store."""
    group: Any = zarr.open_group(path, mode="r", use_consolidated=False)
    for name, node in group.members(max_depth=None):
        if isinstance(node, zarr.Array):
            metadata: Any = node.metadata.to_dict()
            yield name, str(metadata["data_type"]), tuple(metadata.get("dimension_names") or ()), dict(node.attrs)


def wrong(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    """The arrays without a meaning or a unit. Text has no unit, bounds have that of their axis (CF 7.1).

    A position along ``axis`` has the units of the axes, one each.
    """
    found = list(arrays(path))
    bounds = {attributes.get("bounds") for *_, attributes in found}
    return [
        (name, attributes)
        for name, kind, dims, attributes in found
        if name.rpartition("/")[2] not in bounds
        and not (attributes.get("long_name") and (kind in TEXT or "axis" in dims or attributes.get("units") in UNITS))
    ]


@pytest.fixture(scope="module")
def handle(tmp_path_factory: pytest.TempPathFactory) -> store.AtlasStore:
    """A plane with overviews, curves and measures."""
    made = complete(tmp_path_factory.mktemp("units") / "a.zarr")
    counts, ends = np.zeros(2, dtype=np.int64), ("edge", "edge")
    curve = Curve(
        "fold", 1, counts, counts, False, np.zeros((2, 2)), counts, ends, (CodimTwoPoint("cusp", 0.0, 0.0, 0),)
    )
    write_curves(made, Curves(("omega", "b"), (curve,)))
    write_measures(
        made, StoredMeasures({name: np.zeros(made.spec.shape, measure.dtype) for name, measure in MEASURES.items()}, {})
    )
    return made


def test_every_array_of_every_group_has_a_meaning_and_a_unit(handle: store.AtlasStore) -> None:
    groups = {name.partition("/")[0] for name, *_ in arrays(handle.path) if "/" in name}
    assert groups == {"curves", "overviews", "stability", "tiles", "searches"}
    assert wrong(handle.path) == []


def test_so_have_labels_and_the_variables_of_all_attractors(tmp_path: Path) -> None:
    spec = atlas.Spec("two-mass", {"omega": [3.0, 3.5], "b": [0.1, 0.2]}, attractors={"starts": 2, "keep": 2})
    made = create.create_store(tmp_path / "a.zarr", spec, (2, 2))
    kinds = {name: np.zeros(1, dtype=np.int64) for name in ("regime", "period", "impacts_upper", "impacts_lower")}
    count = LabelCounts(*(0 for _ in LabelCounts.__dataclass_fields__))
    one = np.zeros(1, dtype=np.int64)
    values = np.zeros((2, 2, 2), dtype=np.int64)
    write_labels(made, AttractorLabels(values, one, np.ones(1), one, kinds | {"symmetric": one}, count))
    assert any(name.startswith("labels/") for name, *_ in arrays(made.path))
    assert wrong(made.path) == []


@pytest.mark.parametrize("name", system_names())
def test_so_have_the_parameters_and_the_results_of_each_packaged_machine(name: str) -> None:
    record = find_system(name)
    assert {parameter.unit for parameter in record.parameters} <= UNITS
    for settings in (atlas.Settings(exponents="spectrum", section_samples=1), atlas.Settings(method="fixed")):
        of_cells = result_variables(settings, own_variables=record.own_variables)
        of_all, of_basins = (result_variables(settings, **{kind: True}) for kind in ("attractors", "basins"))
        every = (*of_cells, *of_all, *of_basins, *level_variables(of_cells), *ALLOWANCES)
        assert not [variable for variable in every if variable.units not in UNITS or not variable.long_name]
