"""The modules that both pages run, joined into one script, and the style sheet of their keys."""

import html
import json
import re
from collections.abc import Iterable, Iterator
from importlib.resources import files
from typing import Any

SHARED = ("numbers.mjs", "colors.mjs", "words.mjs", "elements.mjs", "plane.mjs", "key.mjs", "look.mjs")
"""The modules of both pages, in an order in which each follows its imports."""


LIVE = ("live.mjs", "keys.mjs", "widgets.mjs")
"""Those of the explorer's page."""
TICKS = "return atlasPage.tickText(tick, base, unit, decimals)"


def program(package: str, *own: str) -> str:
    """The shared modules and those of a package as one script, whose names their exports become."""
    return "".join(_joined(text) for text in (*_texts(__package__, SHARED), *_texts(package, own)))


def page_script() -> str:
    """The script of the explorer's page, which calls the exports of its modules ``atlasPage``."""
    own = "".join(_texts(__package__, LIVE))
    names = ", ".join(re.findall(r"^export (?:function|const) (\w+)", own, re.MULTILINE))
    return (
        f"const atlasPage = (() => {{\n{program(__package__, *LIVE)}\nreturn {{ {names} }};\n}})();\n"
        'customElements.define("atlas-part", atlasPage.Part);'
    )


def call(function: str, **given: Any) -> Any:
    """What has Bokeh call an exported function with these models and values, and the model that has changed."""
    from bokeh.models import CustomJS

    return CustomJS(args={"given": given}, code=f"atlasPage.{function}(given, cb_obj)")


def html_part(name: str, given: Any = None) -> str:
    """The HTML of a part of the page that a module fills, by the JSON that it is given."""
    return f'<atlas-part class="{name}" data-of="{name}" data-given="{html.escape(json.dumps(given))}"></atlas-part>'


def legend_css() -> str:
    """The style sheet of the key of a map."""
    return files(__package__).joinpath("key.css").read_text("utf-8")


def _texts(package: str, names: Iterable[str]) -> Iterator[str]:
    return (files(package).joinpath(name).read_text("utf-8") for name in names)


def _joined(module: str) -> str:
    return re.sub(r"^import .*?;\n|^export ", "", module, flags=re.MULTILINE | re.DOTALL)
