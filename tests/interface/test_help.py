"""Claims about what the command says of itself: whole summaries, an example for each command, kinds with meanings."""

import inspect
import shlex
from dataclasses import fields
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

import atlas
from atlas.accessor import AtlasAccessor
from atlas.cli.main import main
from atlas.render import KINDS, OVERLAYS, SCALAR
from atlas.render.kinds import KIND_MEANINGS, OVERLAY_MEANINGS
from atlas.spec.examples import example_names
from atlas.spec.spec import SETTING_MEANINGS, Spec
from tests.project.test_docs import parse
from workers import Settings


def shown(*words: str) -> str:
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    return result.output


def examples(text: str) -> list[str]:
    """The lines to type in a help."""
    return [line.strip() for line in text.partition("Examples:")[2].splitlines() if line.strip()]


def all_commands(group: click.Group = main, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], click.Command]:
    """All commands that do something, by the words before their arguments."""
    found: dict[tuple[str, ...], click.Command] = {}
    for name, command in group.commands.items():
        inner = all_commands(command, (*path, name)) if isinstance(command, click.Group) else {(*path, name): command}
        found |= inner
    return found


@pytest.mark.parametrize("words", [(), ("find",), ("attractors",)])
def test_a_list_of_commands_fits_one_screen_and_no_summary_is_cut(words: tuple[str, ...]) -> None:
    listed = shown(*words, "--help")
    group = main.commands[words[0]] if words else main
    assert isinstance(group, click.Group)
    assert all(f"\n  {name} " in listed for name in group.commands)
    assert "..." not in listed.replace("[ARGS]...", "")
    assert len(listed.splitlines()) < 55 and max(map(len, listed.splitlines())) <= 80


@pytest.mark.parametrize("path", all_commands(), ids=" ".join)
def test_the_help_of_a_command_ends_with_lines_that_can_be_typed(path: tuple[str, ...]) -> None:
    lines = examples(shown(*path, "--help"))
    assert lines
    for line in lines:
        words = shlex.split(line.partition(">")[0])
        assert words[: len(path) + 1] == ["atlas", *path]
        parse(words[1:])


@pytest.mark.parametrize("path", all_commands(), ids=" ".join)
def test_every_option_of_a_command_says_what_it_does(path: tuple[str, ...]) -> None:
    options = [param for param in all_commands()[path].params if isinstance(param, click.Option)]
    assert not [option.name for option in options if not option.help]


def test_every_kind_and_overlay_has_a_meaning_in_the_help() -> None:
    assert sorted(KIND_MEANINGS) == sorted((*KINDS, SCALAR))
    assert sorted(OVERLAY_MEANINGS) == sorted(OVERLAYS)
    listed = shown("plot", "--help")
    assert all(meaning in listed for meaning in [*KIND_MEANINGS.values(), *OVERLAY_MEANINGS.values()])


def test_every_setting_has_a_meaning() -> None:
    assert [*SETTING_MEANINGS] == [field.name for field in fields(Settings)]


@pytest.mark.parametrize("name", example_names())
def test_an_example_that_is_printed_is_the_spec_of_its_name(name: str, tmp_path: Path) -> None:
    (tmp_path / "copy.toml").write_text(shown("example", name))
    assert Spec.from_toml(tmp_path / "copy.toml").digest == Spec.from_toml(name).digest


def test_without_a_name_the_examples_are_listed() -> None:
    listed = shown("example")
    assert all(f"\n{name} " in listed for name in example_names())


def test_an_unknown_example_is_answered_with_the_nearest() -> None:
    result = CliRunner().invoke(main, ["example", "tinny"])
    assert (result.exit_code, result.output) == (2, "Error: unknown example 'tinny'; did you mean 'tiny'?\n")


def test_a_table_is_as_wide_as_it_needs_to_be_where_a_notebook_asks_for_colours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "40")
    listed = shown("systems", "two-mass")
    assert "\x1b" not in listed and "…" not in listed
    assert "clearance: half the gap between the stops" in listed


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("plto", "plot"), ("draw", "plot"), ("show", "plot"), ("render", "plot"), ("info", "status"),
        ("curves", "find curves"), ("label", "attractors label"), ("measure", "attractors measure"), ("help", "--help"),
    ],
)  # fmt: skip
def test_an_unknown_command_is_answered_with_the_one_that_is_meant(typed: str, meant: str) -> None:
    result = CliRunner().invoke(main, [typed, "plane.zarr"])
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"unknown command {typed!r}; did you mean" in result.stderr and f"{meant}'?" in result.stderr


IN_PYTHON_ALONE = {
    "at", "attractors", "basin_measures", "boundary", "count_reasons", "curves", "distance_to", "fractions", "is_",
    "labels", "open", "per_unit_time", "plot_side_by_side", "solve_tile", "time_history", "to_html", "where_regime",
}  # fmt: skip
"""Answers that are arrays, and parts of what one command prints: ``atlas query`` has shares, reasons and cells, and
``atlas trace`` prints a time history."""


def test_a_verb_has_one_name_in_python_and_on_the_command_line() -> None:
    functions = {name for name in atlas.__all__ if inspect.isfunction(getattr(atlas, name))}
    methods = {name for name in vars(AtlasAccessor) if not name.startswith("_")}
    commands = {name for path in all_commands() for name in (path[-1], "_".join(path), "_".join(reversed(path)))}
    assert (functions | methods) - IN_PYTHON_ALONE <= commands


def test_what_takes_a_store_takes_its_storage_options_in_python_and_on_the_command_line() -> None:
    for name in atlas.__all__:
        if inspect.isfunction(function := getattr(atlas, name)):
            names = set(inspect.signature(function).parameters)
            assert "store" not in names or names & {"storage_options", "options"}, name
    for path, command in all_commands().items():
        names = {str(parameter.name) for parameter in command.params}
        takes = names & {"store", "stores", "subject"} or path in (("run",), ("plan",))
        assert not takes or "storage_option" in names, path


@pytest.mark.parametrize(
    ("typed", "word", "offered"),
    [
        ((), "ex", {"example", "explore", "export", "extend"}),
        (("find",), "", {"regions", "extremes", "curves"}),
        (("plot", "a.zarr"), "--over", {"--overlay"}),
        (("plot", "a.zarr", "--overlay"), "gra", {"grazing"}),
    ],
)
def test_the_tab_key_completes_commands_options_and_words(typed: tuple[str, ...], word: str, offered: set[str]) -> None:
    found = ShellComplete(main, {}, "atlas", "_ATLAS_COMPLETE").get_completions(list(typed), word)
    assert {choice.value for choice in found if choice.type == "plain"} == offered


@pytest.mark.parametrize("typed", [("run",), ("query",), ("plot",), ("run", "a.toml", "-o"), ("point", "--system")])
def test_the_tab_key_completes_files(typed: tuple[str, ...]) -> None:
    found = ShellComplete(main, {}, "atlas", "_ATLAS_COMPLETE").get_completions(list(typed), "pl")
    assert [(choice.type, choice.value) for choice in found] == [("file", "pl")]


def test_the_help_of_a_run_in_python_shows_its_options_and_no_record_of_defaults() -> None:
    shown = str(inspect.signature(atlas.run))
    assert "options: atlas.service.options.RunOptions = RunOptions(), *, workers=None" in shown
    assert "connect" not in shown and "fields" not in shown
