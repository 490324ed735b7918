"""Claims about the site that scripts/docs builds: no warning, whole links, and nothing from another host."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.cli_runner import commands
from tests.project.test_docs import ROOT

pytestmark = pytest.mark.slow

LOADED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "object": "data"}
"""Elements that make a browser load something, and the attribute that says from where."""


class Page(HTMLParser):
    """What a page links to, loads and can be linked at."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if LOADED.get(tag) in given:
            self.loaded.append(given[LOADED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, one_processor: None) -> Path:
    """The site, built without any address that a program could reach the network by; its commands are forked."""
    out = tmp_path_factory.mktemp("site")
    nowhere = {
        "http_proxy": "http://127.0.0.1:9",
        "https_proxy": "http://127.0.0.1:9",
        "no_proxy": "127.0.0.1,localhost",
    }
    with commands(tmp_path_factory.mktemp("forked")) as atlas:
        found = os.pathsep.join([str(atlas.parent), str(Path(sys.executable).parent), os.environ["PATH"]])
        built = subprocess.run(
            [sys.executable, "-m", "sphinx", "--quiet", "--fresh-env", "--fail-on-warning", "-d", str(out / "read"),
             "docs", str(out / "html")],
            cwd=ROOT, env=os.environ | nowhere | {"PATH": found, "PYTHONPATH": str(ROOT)}, capture_output=True,
            text=True, timeout=3000,
        )  # fmt: skip
    assert built.returncode == 0, built.stderr[-6000:]
    return out / "html"


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text()) for path in site.rglob("*.html")}


def test_every_page_of_docs_is_in_the_site(site: Path) -> None:
    sources = [path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")]
    assert not [path for path in sources if not (site / path).exists()]


def test_no_page_shows_the_magic_of_a_cell(site: Path) -> None:
    """What a reader copies is the file, or the commands."""
    shown = {path: re.sub(r"<[^>]*>", "", path.read_text()) for path in site.rglob("*.html")}
    assert not [path for path, text in shown.items() if "%%writefile" in text or "%%sh" in text]
    assert '<span class="caption-text">plane.toml</span>' in (site / "tutorials/first-plane.html").read_text()


def test_links_inside_the_site_lead_somewhere(pages: dict[Path, Page]) -> None:
    missing = []
    for path, page in pages.items():
        for link in page.links:
            where, _, anchor = unquote(link).partition("#")
            if re.match(r"[a-z]+:", where):
                continue
            target = (path.parent / where).resolve() if where else path
            known = target in pages and (not anchor or anchor in pages[target].anchors)
            if not known and not (target.is_file() and target.suffix != ".html"):
                missing.append(f"{path.name}: {link}")
    assert not missing


def test_no_page_loads_anything_from_another_host(site: Path, pages: dict[Path, Page]) -> None:
    assert not [
        (path.name, address) for path, page in pages.items() for address in page.loaded
        if re.match(r"([a-z]+:)?//", address)
    ]  # fmt: skip
    sheets = [
        path for path in site.rglob("*.css") if re.search(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//", path.read_text())
    ]
    assert not sheets


def test_notebooks_were_run_and_drew_their_pictures(site: Path, pages: dict[Path, Page]) -> None:
    docs = ROOT / "docs"
    notebooks = [path for path in docs.rglob("*.md") if "```{code-cell}" in path.read_text()]
    assert notebooks
    for notebook in notebooks:
        page = pages[site / notebook.relative_to(docs).with_suffix(".html")]
        drawn = [address for address in page.loaded if re.search(r"_images/[0-9a-f]{32,}", address)]
        assert len(drawn) >= notebook.read_text().count('Image("'), notebook.name


def test_formulas_are_drawn_and_none_is_left_as_source(site: Path) -> None:
    text = (site / "machine.html").read_text()
    assert text.count('<div class="formula"><svg ') == (ROOT / "docs/machine.md").read_text().count("\n$$\n") // 2
    assert not re.search(r">[^<]*\\(?:frac|ddot|begin)[^<]*<", text)
