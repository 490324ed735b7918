"""Claims about what goes with the code: types, the citation, and versions that are said in several places."""

import ast
import re
import tomllib
from collections import defaultdict

import pytest

import atlas
import workers
from tests.project.test_docs import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.mark.parametrize("package", [atlas, workers])
def test_a_package_that_is_installed_says_that_it_is_typed(package: object) -> None:
    name = package.__name__  # type: ignore[attr-defined]
    assert (ROOT / name / "py.typed").exists()
    assert "py.typed" in PROJECT["tool"]["setuptools"]["package-data"][name]


def test_the_citation_names_the_authors_and_the_paper_of_the_method() -> None:
    text = (ROOT / "CITATION.cff").read_text()
    assert "10.1088/1674-1056/20/4/040505" in text
    assert all(author["name"] in text for author in PROJECT["project"]["authors"])


def test_the_page_on_citing_names_the_version() -> None:
    assert f"version = {{{PROJECT['project']['version']}}}" in (ROOT / "docs/paper.md").read_text()


def test_every_python_from_the_oldest_that_is_allowed_on_is_classified() -> None:
    found = re.findall(r"Python :: 3\.(\d+)", " ".join(PROJECT["project"]["classifiers"]))
    oldest = re.fullmatch(r">=3\.(\d+)", PROJECT["project"]["requires-python"])
    assert oldest is not None
    assert [*map(int, found)] == [*range(int(oldest[1]), int(oldest[1]) + len(found))]


def test_what_builds_the_pages_is_pinned() -> None:
    names = [re.split(r"[><=\[]", line)[0] for line in PROJECT["project"]["optional-dependencies"]["docs"]]
    pinned = (ROOT / "constraints.txt").read_text().lower()
    assert not [name for name in names if f"\n{name}==" not in pinned]


@pytest.mark.parametrize(
    ("folder", "unknown"),
    [
        ("scripts", r"tests(?!\.support\b)"),
        ("tests/support", r"tests(?!\.support\b)|scripts"),
        ("docs", r"tests|scripts"),
    ],
)
def test_scripts_import_of_the_tests_their_support_alone(folder: str, unknown: str) -> None:
    found = []
    for file in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found += [f"{file.relative_to(ROOT)}: {name}" for name in names if re.match(unknown, name)]
    assert found == []


def test_no_cluster_takes_a_fixed_port() -> None:
    """Without an address of its own, and with None, the dashboard of Dask's clusters is at 8787, which may be taken."""
    found = []
    files = {
        file: file.read_text(encoding="utf-8")
        for folder in ("tests", "scripts")
        for file in (ROOT / folder).rglob("*.py")
    }
    for page in sorted((ROOT / "docs/tutorials").glob("*.md")):
        cells = re.findall(r"^```{code-cell}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        files[page] = "\n".join(cell for cell in cells if "LocalCluster(" in cell)
    for file, text in files.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("LocalCluster", "Client"):
                given = {word.arg: ast.unparse(word.value) for word in node.keywords}
                if not given.get("dashboard_address", "").endswith(":0'") and (
                    node.func.id == "LocalCluster" or {"processes", "n_workers"} & given.keys()
                ):
                    found.append(f"{file.relative_to(ROOT)}:{node.lineno}")
    assert found == []


def test_no_class_name_stands_for_two_classes() -> None:
    found = defaultdict(list)
    for package in ("atlas", "workers"):
        for file in sorted((ROOT / package).rglob("*.py")):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef):
                    found[node.name].append(str(file.relative_to(ROOT)))
    assert {name: files for name, files in found.items() if len(files) > 1} == {}
