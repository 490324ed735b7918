"""The JavaScript modules of the explorer's page and of the static page, joined into one script each."""

import html
import json
import re
from collections.abc import Iterable, Iterator
from importlib.resources import files
from typing import Any

SHARED = ("numbers.mjs", "colors.mjs", "words.mjs", "elements.mjs", "plane.mjs", "key.mjs", "look.mjs")
"""The JavaScript modules of both pages, each after the modules that it imports."""


LIVE = ("live.mjs", "keys.mjs", "widgets.mjs")
"""The JavaScript modules of the explorer's page only."""
TICKS = "return atlasPage.tickText(tick, base, unit, decimals)"


def program(package: str, *names: str) -> str:
    """Return the modules that both pages share and the modules ``names`` of a package as one script.

    In the script all exports are plain names.
    """
    return "".join(_joined(text) for text in (*_texts(__package__, SHARED), *_texts(package, names)))


def page_script() -> str:
    """Return the script of the explorer's page.

    Its object ``atlasPage`` has the exports of the modules that only this page has.
    """
    source = "".join(_texts(__package__, LIVE))
    names = ", ".join(re.findall(r"^export (?:function|const) (\w+)", source, re.MULTILINE))
    return (
        f"const atlasPage = (() => {{\n{program(__package__, *LIVE)}\nreturn {{ {names} }};\n}})();\n"
        'customElements.define("atlas-part", atlasPage.Part);'
    )


def call(function: str, **arguments: Any) -> Any:
    """Return the Bokeh callback that calls an exported function of the page's script in the browser.

    function    name of the function
    arguments   models and values that the function receives, besides the model that has changed
    """
    from bokeh.models import CustomJS

    return CustomJS(args={"given": arguments}, code=f"atlasPage.{function}(given, cb_obj)")


def html_part(name: str, data: Any = None) -> str:
    """Return the HTML element that the script's module for parts of class ``name`` fills from the JSON ``data``."""
    return f'<atlas-part class="{name}" data-of="{name}" data-given="{html.escape(json.dumps(data))}"></atlas-part>'


def legend_css() -> str:
    """Return the style sheet of a map's legend."""
    return files(__package__).joinpath("key.css").read_text("utf-8")


def _texts(package: str, names: Iterable[str]) -> Iterator[str]:
    return (files(package).joinpath(name).read_text("utf-8") for name in names)


def _joined(module: str) -> str:
    return re.sub(r"^import .*?;\n|^export ", "", module, flags=re.MULTILINE | re.DOTALL)
