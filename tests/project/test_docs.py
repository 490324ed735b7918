"""Claims about README.md and the pages in docs: what they name exists, what they show can be typed."""

import ast
import importlib.util
import json
import re
import shlex
import tomllib
from pathlib import Path

import click
import nbformat
import pytest
import yaml

from atlas.cli.main import main
from atlas.spec.spec import Spec
from atlas.store.origin import ALLOWANCES
from atlas.store.schema import FORMAT_VERSION
from tests.paths import ROOT
from workers import SOLVER_VERSION, Settings, System
from workers.results import REASONS, REGIMES, result_variables

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
INDEX = ROOT / "docs/index.md"
LANGUAGES = ("sh", "toml", "python")

_SPEC = importlib.util.spec_from_file_location("modules", ROOT / "docs/_ext/modules.py")
assert _SPEC is not None and _SPEC.loader is not None
modules = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(modules)

each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def blocks(page: Path, language: str) -> list[str]:
    """The fenced code blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)


def prose(page: Path) -> str:
    """A page without its fenced code blocks."""
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def spans(page: Path) -> list[str]:
    """What the text of a page sets in backticks, each on one line."""
    return [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose(page))]


def code(page: Path) -> list[str]:
    """Everything a page sets as code: the spans of its text and the lines of its blocks."""
    return spans(page) + [line for name in LANGUAGES for block in blocks(page, name) for line in block.splitlines()]


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links(page: Path) -> list[tuple[Path, str]]:
    """The relative links and images of a page: file and anchor."""
    found = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    parts = [target.partition("#") for target in found if "://" not in target]
    return [((page.parent / path).resolve() if path else page, anchor) for path, _, anchor in parts]


def parse(words: list[str]) -> None:
    """Let click parse a command line, as far as it does so before it runs the command."""
    group = click.Context(main, info_name="atlas")
    command = main.get_command(group, words[0])
    assert command is not None, f"no command {words[0]}"
    while isinstance(command, click.Group):
        group = command.make_context(words[0], words[1:2], parent=group)
        words = words[1:]
        name, command = words[0], command.get_command(group, words[0])
        assert command is not None, f"no command {name}"
    command.make_context(words[0], words[1:], parent=group)


def script_calls(page: Path) -> list[list[str]]:
    """Calls of scripts on a page, as words: the script's path, then its arguments."""
    calls = []
    for line in code(page):
        words = shlex.split(line, comments=True) if "scripts" in line else []
        if words[:2] == ["python", "-m"] and words[2].startswith("scripts."):
            module = words[2].replace(".", "/")
            file = f"{module}/__main__.py" if (ROOT / module).is_dir() else f"{module}.py"
            calls.append([file, *words[3:]])
    return calls


def test_the_readme_is_at_most_80_lines() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 80


def test_the_readme_says_how_the_command_is_found_before_it_uses_it() -> None:
    lines = [line for block in blocks(ROOT / "README.md", "sh") for line in block.splitlines()]
    used = next(number for number, line in enumerate(lines) if line.startswith("atlas "))
    assert "source .venv/bin/activate" in [line.partition("#")[0].strip() for line in lines[:used]]


def stores_made(page: Path) -> dict[str, set[str]]:
    """The specs that a page runs into each store, by the store's path as it is written there."""
    made: dict[str, set[str]] = {}
    for block in blocks(page, "sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            runs = words[:2] == ["atlas", "run"] and "-o" in words
            if runs and "--points" not in words:  # a table of points replaces a spec's axes
                made.setdefault(words[words.index("-o") + 1], set()).add(words[2])
    for block in blocks(page, "python"):
        for spec, store in re.findall(r"atlas\.run\((.+), \"([^\"]+)\"", block):
            read = re.match(r'atlas\.Spec\.from_toml\("(.+)"\)', spec)
            made.setdefault(store, set()).add(read[1] if read else spec)
    return made


@each_page
def test_a_page_runs_no_two_specs_into_one_store(page: Path) -> None:
    assert not {store: specs for store, specs in stores_made(page).items() if len(specs) > 1}


def entries(page: Path) -> set[Path]:
    """The pages in the tables of contents of a page."""
    listed = [line for block in blocks(page, r"\{toctree\}") for line in block.splitlines() if line and line[0] != ":"]
    return {(page.parent / f"{entry}.md").resolve() for entry in listed}


def test_there_are_at_most_32_pages() -> None:
    assert len([page for page in PAGES if (ROOT / "docs") in page.parents]) <= 32


def test_the_contents_of_the_index_have_every_other_page_of_docs() -> None:
    assert entries(INDEX) | {INDEX} == {page for page in PAGES if (ROOT / "docs") in page.parents}


def test_the_index_alone_has_contents_and_links_to_all_of_them() -> None:
    assert [page for page in PAGES if entries(page)] == [INDEX]
    assert entries(INDEX) <= {path for path, _ in links(INDEX)}


@each_page
def test_what_a_page_links_to_exists(page: Path) -> None:
    missing = [f"{path}#{anchor}" for path, anchor in links(page) if not path.exists()]
    missing += [f"{path}#{anchor}" for path, anchor in links(page) if anchor and anchor not in anchors(path)]
    assert not missing


@each_page
def test_files_of_the_repository_that_a_page_names_exist(page: Path) -> None:
    named = re.findall(r"(?<![\w./])(?:atlas|workers|scripts|tests|docs)/[\w./*-]+", "\n".join(code(page)))
    assert not [name for name in named if not list(ROOT.glob(name.rstrip("./")))]


def test_the_page_of_modules_lists_each_with_a_sentence() -> None:
    """The build of the site fills the places of the page from the docstrings."""
    places = re.findall(r"^<!-- modules: (\w+) -->$", (ROOT / "docs/changing.md").read_text(), re.MULTILINE)
    assert {"atlas", "workers"} <= {*places}
    for folder in places:
        listed = re.findall(r"^#### `([\w/]+)/`\n((?:(?!####).*\n)*)", modules.tables(folder), re.MULTILINE)
        rows = [(package, re.findall(r"^\| `(\S+)` \| \S", text, re.MULTILINE)) for package, text in listed]
        named = {f"{package}/{name}" for package, names in rows for name in names}
        files = {path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob("*.py")}
        assert named == {name for name in files if not name.endswith("/__init__.py")}


def test_every_variable_regime_and_reason_is_explained() -> None:
    explained = {name for page in ("data.md", "regimes.md") for name in spans(ROOT / "docs" / page)}
    settings = [Settings(exponents="spectrum", method="fixed", section_samples=1), Settings(exponents="none")]
    variables = {variable.name for setting in settings for variable in result_variables(setting)}
    variables |= {allowance.name for allowance in ALLOWANCES}
    assert (variables | {reason.name for reason in REASONS}) <= explained
    regimes = re.findall(r"^\| (-?\d+) \| (\w+) \|", (ROOT / "docs/regimes.md").read_text(), re.MULTILINE)
    assert [(int(code), name) for code, name in regimes] == [(regime.code, regime.name) for regime in REGIMES]


@pytest.mark.parametrize("name", ["CHANGELOG.md", "docs/stability.md"])
def test_the_changelog_and_the_page_of_promises_are_at_most_80_lines(name: str) -> None:
    assert len((ROOT / name).read_text().splitlines()) <= 80


def test_pages_name_the_present_versions_of_solver_and_format() -> None:
    said = f"solver version {SOLVER_VERSION}, format version {FORMAT_VERSION}"
    assert said in (ROOT / "docs/stability.md").read_text()
    assert said in (ROOT / "CHANGELOG.md").read_text()
    accuracy = " ".join((ROOT / "docs/accuracy.md").read_text().split())
    assert f"The present solver version, {SOLVER_VERSION}," in accuracy


def test_pages_compare_periods_with_heyoka_by_the_table_on_accuracy() -> None:
    rows = [row[3:6] for row in json.loads((ROOT / "docs/measured/kernel.json").read_text())["rows"]]
    batch = [float(ratio) for _, _, ratio in rows]
    single = [float(heyoka) / float(alone) for alone, heyoka, _ in rows]
    text = " ".join((ROOT / "docs/accuracy.md").read_text().split())
    assert f"In a batch the solver is {min(batch):.0f} to {max(batch):.0f} times as fast as heyoka" in text
    assert f"One cell at a time it is {min(single):.2f} to {max(single):.1f} times as fast" in text
    said = [found for page in PAGES for found in re.findall(r"(\d+) to (\d+) times[a-z ]+heyoka", page.read_text())]
    assert {*said} == {(f"{min(batch):.0f}", f"{max(batch):.0f}")}


@each_page
def test_scripts_that_a_page_calls_have_the_options_it_gives(page: Path) -> None:
    calls = script_calls(page)
    assert not [
        call for call in calls for word in call[1:]
        if word.startswith("--") and f'"{word}"' not in (ROOT / call[0]).read_text()
    ]  # fmt: skip


@each_page
def test_command_lines_in_code_blocks_are_whole_and_valid(page: Path) -> None:
    for line in (line for block in blocks(page, "sh") for line in block.splitlines() if line.startswith("atlas ")):
        try:
            parse(shlex.split(line, comments=True)[1:])
        except click.UsageError as error:
            pytest.fail(f"{line}: {error.format_message()}")


@each_page
def test_command_lines_in_the_text_name_commands_and_options_that_exist(page: Path) -> None:
    for line in (line for line in spans(page) if line.startswith("atlas ")):
        try:
            parse(shlex.split(line, comments=True)[1:])
        except click.BadParameter:
            pass  # in the text a line may leave out its arguments, or have placeholders for them
        except click.UsageError as error:
            pytest.fail(f"{line}: {error.format_message()}")


@pytest.mark.parametrize("page", [page for page in PAGES if page.read_text().startswith("---")], ids=lambda p: p.name)
def test_the_head_of_a_page_that_is_run_is_that_of_a_notebook(page: Path) -> None:
    """By the schema of notebooks, as programs that convert pages need it."""
    head = yaml.safe_load(page.read_text().split("---")[1])
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": head["kernelspec"]})
    nbformat.validate(notebook)


@each_page
def test_code_in_python_is_python(page: Path) -> None:
    for block in blocks(page, "python"):
        ast.parse(block)


def files(page: Path) -> dict[str, str]:
    """The blocks of a page that are whole files, which say so in their first line, by the files' names."""
    return {found[1]: block for block in blocks(page, "toml") if (found := re.match(r"# ([\w-]+\.toml)\n", block))}


@each_page
def test_whole_specs_are_specs_whole_systems_systems_and_parts_of_them_toml(page: Path, tmp_path: Path) -> None:
    for name, text in files(page).items():
        (tmp_path / name).write_text(text)
    for block in blocks(page, "toml"):
        given = tomllib.loads(block)
        if "axes" in given and "system" in given:
            Spec.from_mapping(given, tmp_path)
        elif "system" in given:
            System.from_toml(block)


@each_page
def test_code_blocks_are_in_languages_that_these_tests_read(page: Path) -> None:
    fences = re.findall(r"^```(.*)$", page.read_text(), re.MULTILINE)
    languages = {fence for fence in fences[::2] if not fence.startswith("{")}  # those are directives, for Sphinx
    assert languages <= {*LANGUAGES} and {*fences[1::2]} <= {""}
