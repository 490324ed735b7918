"""What a release promises and carries: names, columns, exit codes, metadata in several files, workflows, the wheel."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

import atlas
import workers
from atlas.cli.main import attractors, find, main
from atlas.errors import InputError, RunError
from atlas.orbits.branches.table import BranchTable
from atlas.orbits.curves.queries import to_frames
from atlas.orbits.curves.table import Curves
from atlas.spec.citation import bibtex, sources
from atlas.spec.examples import example_text
from atlas.store.create import make_store
from atlas.store.object_backend import open_backend
from tests.planes import plane_of
from tests.project.test_docs import ROOT, spans
from workers.model.reserved_names import _KINDS, _everything
from workers.model.system import System, find_system, system_names
from workers.results import result_variables

PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PAGE = (ROOT / "docs/stability.md").read_text(encoding="utf-8")

# The promise. A name may be added here; one that goes needs a major version.

PROMISED = """
atlas       CurveSettings RunOptions Settings Spec System __version__ attractors branch errors extend find_curves
            label_attractors measure_attractors open pack plan point portrait retry run saddles solve_tile stability
            status time_history trace verify
workers     SOLVER_VERSION Settings System solve_tile trace
commands    demo example schema systems plan run extend retry status cancel plot explore query find
            attractors compare point portrait trace branch verify pack export cite
find        regions extremes curves
attractors  label measure basins stability saddles
variables   attractors average error exact impact_energy impacts_lower impacts_per_period impacts_upper kaplan_yorke
            label largest max_impact_speed mean_impact_speed min_impact_speed mirror own_attractor peak_to_peak period
            periods_used reason regime section settled share share_error share_high share_low spectrum starts
            starts_by_statistics starts_unstored state statistical_distance sticks stuck_fraction sum_law_defect
            survived symmetric undecided unseen_share
branches    period impacts_upper impacts_lower symmetric leaves at points first_end last_end
points      branch omega x1 x2 v1 v2 multiplier unstable period impacts_upper impacts_lower symmetric event
events      branch kind omega x1 x2 v1 v2 unstable kappa period impacts_upper impacts_lower symmetric leaving
curves      curve kind period impacts_upper impacts_lower symmetric omega b unstable
regions     label period cells area share centre_omega centre_b cell_omega cell_b omega_from omega_to b_from b_to cut
extremes    regime extreme omega b value error cells
ds.atlas    at basin_measures boundary branch compare count_reasons curves distance_to explore extremes fractions is_
            labels per_unit_time plot plot_side_by_side portrait regions to_html where_regime
"""
JSON = """
plan SPEC: axes dims shape cells tile tiles bytes objects objects_per_tile workers seconds seconds_range
    seconds_per_cell processor_seconds periods cells_probed note
status STORE: store system axes parameters columns solve tile tiles tiles_done tiles_pending cells cells_done
    cells_pending cells_failed fraction regimes reasons run trouble workers cells_per_second seconds_left
    solver_version run_id digest
verify STORE: store sound complete tiles tiles_done chunks cells_checked cells_solved comparison seed faults doubts
    overview_chunks repaired dropped removed restored leftovers
query STORE: no_impact periodic chaotic
query STORE --at omega=3 --at b=.1: omega b distance regime error impact_energy impacts_lower impacts_per_period
    impacts_upper largest max_impact_speed mean_impact_speed min_impact_speed peak_to_peak period periods_used sticks
    stuck_fraction survived symmetric
find regions STORE period: by regions
find extremes STORE largest: variable by extremes
compare STORE STORE: parameters regimes same_share compared mean mean_abs largest
point --set omega=3: system parameters solve largest error period impacts_upper impacts_lower impacts_per_period
    symmetric sticks stuck_fraction min_impact_speed mean_impact_speed max_impact_speed impact_energy peak_to_peak
    periods_used survived state regime
point --set omega=3 --attractors --starts 4: system parameters solve search attractors starts own_attractor undecided
    starts_unstored unseen_share periods_used coexisting
attractors stability --set omega=4 --set b=.1 --starts 4: system parameters solve search norm attractors starts
    undecided unseen_share periods_used coexisting
branch --along omega --from 3.9 --to 4.1 --set omega=4: system parameters along window branches events untried
"""
"""Commands with their keys with --json. A key may be added."""

NAMES = {part[0]: part[1:] for part in map(str.split, re.split(r"\n(?=\w)", PROMISED.strip()))}
KEYS = dict(part.split(": ") for part in re.split(r"\n(?=\w)", JSON.strip()))


@pytest.mark.parametrize(("package", "names"), [(atlas, NAMES["atlas"]), (workers, NAMES["workers"])])
def test_the_public_names_of_a_package_are_the_promised_ones(package: Any, names: list[str]) -> None:
    assert sorted(package.__all__) == sorted(names)
    listed = re.search(rf"^`{package.__name__}`: (.*?)\.$", PAGE, re.MULTILINE | re.DOTALL)
    assert listed is not None
    assert re.findall(r"`(\w+)`", listed[1]) == names


def test_the_commands_are_the_promised_ones() -> None:
    assert list(main.commands) == NAMES["commands"]
    for group in (find, attractors):
        assert list(group.commands) == NAMES[str(group.name)]


def test_the_variables_of_a_store_are_the_promised_ones() -> None:
    assert sorted({v.name for kind in _KINDS for v in result_variables(_everything, *kind)}) == NAMES["variables"]


def test_the_columns_of_branches_and_curves_are_the_promised_ones() -> None:
    empty = BranchTable(find_system("two-mass"), {}, "omega", (1.0, 2.0), ())
    assert list(empty.branches.columns) == NAMES["branches"]
    assert list(empty.points.columns) == NAMES["points"]
    assert list(empty.events.columns) == NAMES["events"]
    assert list(to_frames(Curves(("omega", "b"), ())).points.columns) == NAMES["curves"]


def test_the_methods_of_a_dataset_and_the_columns_of_its_tables_are_the_promised_ones(solved_plane: Path) -> None:
    ds = atlas.open(solved_plane)
    assert [name for name in dir(ds.atlas) if not name.startswith("_")] == NAMES["ds.atlas"]
    assert list(ds.atlas.regions("period").columns) == NAMES["regions"]
    assert list(ds.atlas.extremes("largest").columns) == NAMES["extremes"]


@pytest.mark.parametrize("words", KEYS)
def test_a_command_has_the_promised_keys_with_json(words: str, solved_plane: Path, tmp_path: Path) -> None:
    (tmp_path / "spec.toml").write_text(example_text("omega-b").replace("280", "7").replace("220", "5"), "utf-8")
    here = {"STORE": str(solved_plane), "SPEC": str(tmp_path / "spec.toml")}
    done = CliRunner().invoke(main, [*(here.get(word, word) for word in words.split()), "--json"])
    assert done.exit_code == 0, done.output
    assert set(json.loads(done.stdout)) == set(KEYS[words].split())


def raised(error: BaseException) -> Any:
    """A command that ends so."""

    def command(**_: object) -> None:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "code"),
    [(KeyboardInterrupt(), 130), (InputError("given badly"), 2), (RunError("gone wrong"), 1), (OSError("no disk"), 1)],
)
def test_a_command_that_is_interrupted_or_fails_ends_with_the_exit_code_of_the_page(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    monkeypatch.setattr(main.commands["systems"], "callback", raised(error))
    assert CliRunner().invoke(main, ["systems"]).exit_code == code
    assert f"\n| {code} | " in PAGE


@pytest.mark.parametrize(
    ("words", "code"),
    [(["systems"], 0), (["status", "no-such-store"], 2), (["plan", "no-such-spec"], 2), (["plan", "--no-such"], 2)],
)
def test_a_command_ends_with_the_exit_code_of_the_page(words: list[str], code: int) -> None:
    assert CliRunner().invoke(main, words).exit_code == code
    assert f"\n| {code} | " in PAGE


# Metadata


def test_the_citation_the_changelog_and_the_page_on_stability_describe_this_version_of_the_package() -> None:
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    cited = [cff["title"], cff["license"], cff["keywords"], cff["abstract"].rstrip(".")]
    assert cited == [PROJECT[name] for name in ("name", "license", "keywords", "description")]
    assert f"## [{PROJECT['version']}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"Version {PROJECT['version']} " in PAGE


def test_the_conda_recipe_asks_for_the_dependencies_of_the_package_under_their_names_there(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "scripts.conda_recipe", tmp_path], cwd=ROOT, check=True, capture_output=True)
    recipe = yaml.safe_load((tmp_path / "recipe.yaml").read_text(encoding="utf-8"))
    run = recipe["requirements"]["run"]
    assert {"python >=3.11", "numpy >=2.0", "dask-core >=2025.1", "matplotlib-base >=3.9"} <= set(run)
    assert len(run) == 1 + len(PROJECT["dependencies"])
    assert recipe["build"]["python"]["entry_points"] == ["atlas = atlas.__main__:main"]


def test_the_description_in_an_index_has_no_picture_and_no_link_into_the_repository() -> None:
    assert "](" not in (ROOT / PROJECT["readme"]).read_text(encoding="utf-8")


def test_ruff_before_a_commit_is_the_ruff_of_the_tests() -> None:
    """mypy is that of the environment itself."""
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    pinned = re.findall(r"^ruff==.*$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert [hook["additional_dependencies"] for hook in hooks if hook["id"].startswith("ruff")] == 2 * [pinned]
    assert [hook["entry"] for hook in hooks if hook["id"] == "mypy"] == [".venv/bin/python -m mypy"]


WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_is_valid_and_calls_what_is_called_here(path: Path) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    steps = [step for job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].values() for step in job["steps"]]
    commands = [step["run"] for step in steps if "run" in step]
    assert commands
    for command in commands:
        script = re.fullmatch(r"PYTHON=python (scripts/\w+)( [\w -]+)?", command)
        assert script, f"a command that is not run here: {command}"
        assert (ROOT / script[1]).stat().st_mode & 0o100


def test_the_workflows_run_both_stages_of_the_tests() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in WORKFLOWS)
    assert {"scripts/test\n", "scripts/test slow\n"} <= set(re.findall(r"scripts/test[ \w]*\n", text))


# Citations


def test_an_atlas_is_cited_with_the_versions_that_computed_it_and_the_paper_of_the_method(tmp_path: Path) -> None:
    make_store(open_backend(tmp_path / "plane.zarr"), plane_of(), (2, 3), None, "0" * 32)
    done = CliRunner().invoke(main, ["cite", str(tmp_path / "plane.zarr")])
    assert done.exit_code == 0
    assert re.findall(r"^@(\w+)\{(.+),$", done.output, re.MULTILINE) == [
        ("software", "impact-atlas"), ("article", "li-tan-2011"),
    ]  # fmt: skip
    assert f"version = {{{atlas.__version__}}}" in done.output
    assert f"solver version {workers.SOLVER_VERSION}" in done.output


def test_the_page_on_citing_has_the_entry_of_the_method() -> None:
    page = " ".join((ROOT / "docs/paper.md").read_text(encoding="utf-8").split())
    assert " ".join(bibtex(find_system("two-mass"), "1", 1).partition("@article")[2].split()) in page


@pytest.mark.parametrize("name", [name for name in system_names() if name != "two-mass"])
def test_each_reference_of_a_packaged_system_becomes_an_entry_with_its_volume_year_and_page(name: str) -> None:
    system = find_system(name)
    references = re.findall(r"(\d+) \((\d{4})\) (\w+)", system.source)
    found = sources(system)
    assert len(found) == max(1, len(references))
    for (volume, year, page), entry in zip(references, found, strict=False):
        assert f"volume  = {{{volume}}},\n  pages   = {{{page}}},\n  year    = {{{year}}}" in entry
        assert entry.count("{") == entry.count("}")


def test_a_source_that_is_no_article_is_a_note_that_bibtex_can_read() -> None:
    given = find_system("two-mass").table() | {"name": "mine", "source": "my notes, 50% of {A & B}"}
    assert sources(System.from_mapping(given)) == ["@misc{mine,\n  note = {my notes, 50\\% of A \\& B},\n}"]


# The first minute


def test_the_demo_types_the_commands_that_it_shows(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    typed: list[tuple[str, dict[str, Any]]] = []
    for name in ("run", "plot", "query"):
        monkeypatch.setattr(main.commands[name], "callback", lambda name=name, **given: typed.append((name, given)))
    folder = tmp_path / "my demo"
    done = CliRunner().invoke(main, ["demo", str(folder)])
    assert done.exit_code == 0, done.output
    assert [name for name, _ in typed] == ["run", "plot", "query"]
    assert str(typed[0][1]["out"]) == str(folder / "omega-b.zarr")
    assert f"$ atlas run omega-b -o {folder}" in done.output


def test_the_demo_of_a_clone_is_the_command() -> None:
    assert ".venv/bin/atlas demo demo\n" in (ROOT / "scripts/demo").read_text(encoding="utf-8")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_page_on_installing_has_the_line_of_each_shell_that_click_completes_in(shell: str) -> None:
    assert f"_ATLAS_COMPLETE={shell}_source atlas" in (ROOT / "docs/install.md").read_text(encoding="utf-8")


def test_atlas_is_a_module_too() -> None:
    done = subprocess.run([sys.executable, "-m", "atlas", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"atlas, version {atlas.__version__}\n"
    assert "`python -m atlas`" in spans(ROOT / "docs/install.md") or "python -m atlas" in spans(
        ROOT / "docs/install.md"
    )


# What takes long


@pytest.mark.slow
def test_the_wheel_is_built_installed_and_used_without_the_sources() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/check_wheel.py"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
