"""The modules of JavaScript that both pages run: they parse, fit together, and stand in files of their own."""

import re
from collections import Counter
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from atlas.explore.front.script import SHARED
from atlas.explore.live.page import PROGRAM as LIVE
from atlas.explore.static.page import PROGRAM
from tests.explore.modules import FRONT, run

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")

STATIC, OWN = FRONT.parent / "static", FRONT.parent / "live"
MODULES = sorted(FRONT.parent.rglob("*.mjs"))
DECLARED = re.compile(r"^(?:export )?(?:async )?(?:function|const|let|class) ([\w$]+)", re.MULTILINE)


def name_of(path: Path) -> str:
    return path.name


def test_every_module_parses_and_imports_what_is_exported(browser: Any) -> None:
    script = """
        const failed = {};
        for (const path of given) try { await import(path) } catch (error) { failed[path] = String(error) }
        return failed
    """
    failed = run(browser, script, [f"/{path.relative_to(FRONT.parent).as_posix()}" for path in MODULES])
    assert [error for error in failed.values() if not error.startswith("TypeError: Cannot")] == []
    pages = ["/live/live.mjs", "/static/atlas.mjs", "/static/cell.mjs", "/static/page.mjs"]
    assert sorted(failed) == pages  # they begin with elements that are not here
    assert "Failed to fetch" in run(browser, script, ["/front/none.css"])["/front/none.css"]


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_uses_what_it_imports_and_imports_what_is_exported(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    body = re.sub(r"^import .*?;\n", "", text, flags=re.MULTILINE | re.DOTALL)
    for names, source in re.findall(r'^import \{(.*?)\} from "(.*?)";', text, re.MULTILINE | re.DOTALL):
        exported = (path.parent / source).resolve().read_text(encoding="utf-8")
        for name in (word.strip() for word in names.split(",")):
            assert re.search(rf"^export .*\b{name}\b", exported, re.MULTILINE), f"{source} exports no {name}"
            assert re.search(rf"\b{name}\b", body), f"{name} is not used"


@pytest.mark.parametrize(
    "paths",
    [[FRONT / n for n in SHARED] + [folder / n for n in own] for folder, own in ((OWN, LIVE), (STATIC, PROGRAM))],
)
def test_modules_that_are_joined_into_one_script_share_no_name(paths: list[Path]) -> None:
    found = Counter(chain.from_iterable(DECLARED.findall(path.read_text(encoding="utf-8")) for path in paths))
    assert [name for name, count in found.items() if count > 1] == []
    assert len(found) > 40


def test_both_pages_have_every_shared_module_and_none_is_left_out() -> None:
    assert {*SHARED} == {path.name for path in FRONT.glob("*.mjs")}
    assert ({*LIVE}, {*PROGRAM}) == tuple({path.name for path in folder.glob("*.mjs")} for folder in (OWN, STATIC))


def test_no_python_file_holds_javascript() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in FRONT.parent.rglob("*.py")}
    script = re.compile(r"\bconst \w+ =|addEventListener|=> \{|getElementById")
    assert [path.name for path, text in texts.items() if script.search(text)] == []
