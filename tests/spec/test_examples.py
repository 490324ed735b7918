"""Claims about the examples in docstrings: what they show is what happens.

They run in a folder with the store of a small plane, plane.zarr; ``client`` is a Dask client.
"""

import doctest
import importlib
import shutil
from pathlib import Path

import pytest
from distributed import Client

import atlas
from tests.project.test_docs import ROOT

EXAMPLES = sorted(
    path.relative_to(ROOT)
    for package in ("atlas", "workers")
    for path in (ROOT / package).rglob("*.py")
    if ">>> " in path.read_text()
)
WITHOUT = {"errors", "find_curves", "label_attractors", "measure_attractors", "System", "__version__"}
"""Public names without an example here: searches of a whole plane, and the class of machines, whose page has many."""


@pytest.mark.parametrize("path", EXAMPLES, ids=str)
def test_the_examples_of_a_module_give_what_they_show(
    path: Path, solved_plane: Path, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(solved_plane, tmp_path / "plane.zarr")
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(".".join(path.with_suffix("").parts))
    found = doctest.testmod(module, extraglobs={"client": client})
    assert found.attempted > 0
    assert found.failed == 0


def test_public_names_have_an_example() -> None:
    assert {name for name in atlas.__all__ if ">>> " not in (getattr(atlas, name).__doc__ or "")} <= WITHOUT
