"""The picture of a plane, whose numbers the browser colours: other ends of the scale need no new picture."""

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, CustomJS, NumericInput
from numpy.typing import NDArray

from atlas.explore.painter import Painted

EMPTY: dict[str, Any] = {name: [] for name in ("coded", "x", "y", "dw", "dh", "form", "colors", "least", "most")}
COLOR = """
const dark = window.atlasDark ??= matchMedia("(prefers-color-scheme: dark)")
dark.onchange = () => sent.properties.data.change.emit()
const {coded: [coded], form: [form], colors: [colors], least: [least], most: [most], x, y, dw, dh} = sent.data
if (!coded) {
    image.setv({data: {image: [], x, y, dw, dh}}, {sync: false})
    return
}
const out = new coded.constructor(coded)
const low = vmin.value ?? ends.data.low[0], high = vmax.value ?? ends.data.high[0]
if (form) {
    const rises = low != null && high != null && low < high
    if (!rises || (form === "log" ? low <= 0 : form !== "linear" && !(low < 0 && high > 0))) return
    const to = form === "log" ? Math.log : (value) => value
    const [first, last, begin, end] = [least, most, low, high].map(to)
    const share = {
        "two-sided": (value) => 0.5 + 0.5 * (value < 0 ? -value / begin : value / end),
        "signed": (value) => 0.5 + 0.5 * Math.min(end, Math.max(begin, value)) / Math.max(-begin, end),
    }[form] ?? ((value) => (value - begin) / (end - begin))
    for (let k = 0; k < coded.length; k++) {
        if (coded[k] >> 24) continue
        const place = Math.floor(share(first + (last - first) * (coded[k] & MOST) / MOST) * colors.length)
        out[k] = colors[Math.min(colors.length - 1, Math.max(0, place))]
    }
}
if (dark.matches) for (let k = 0; k < out.length; k++) out[k] ^= 0xffffff
image.setv({data: {image: [out], x, y, dw, dh}}, {sync: false})
""".replace("MOST", "0xffffff")
"""See ``atlas.render.numbered``; the server sends a new picture for ends that a form does not take.

In dark mode the page is inverted: colours that are inverted before it stay what they are.
"""


class Picture:
    """The image of a plot as the server sends it, and as the browser colours it into the source ``image``.

    The ends of the scale are those in two inputs, and where these are empty those that suit the picture.
    """

    def __init__(self, image: ColumnDataSource, vmin: NumericInput, vmax: NumericInput) -> None:
        self._sent, self._ends = ColumnDataSource(EMPTY), ColumnDataSource({"low": [], "high": []})
        image.tags = [self._sent, self._ends]  # sources without a view are sent along, and heard, as tags
        inputs = {"vmin": vmin, "vmax": vmax}
        color = CustomJS(args={"sent": self._sent, "ends": self._ends, "image": image, **inputs}, code=COLOR)
        for source in (self._sent, self._ends):
            source.js_on_change("data", color)
        for each in inputs.values():
            each.js_on_change("value", color)

    def show(self, painted: Painted) -> None:
        """Send what the browser does not have yet."""
        ends = {name: [end] for name, end in zip(("low", "high"), painted.ends, strict=True)}
        if ends != self._ends.data:
            self._ends.data = ends
        (left, right), (low, high), scale = painted.x, painted.y, painted.screen.scale
        data: dict[str, Any] = {"x": left, "y": low, "dw": right - left, "dh": high - low}
        data["coded"] = _words(painted.screen.cells[::-1])
        data |= {"form": "", "colors": _words(np.zeros((1, 4), np.uint8)), "least": 0.0, "most": 1.0}
        if scale is not None:
            data |= {"form": scale.form, "colors": _words(scale.colors), "least": scale.span[0], "most": scale.span[1]}
        old = self._sent.data
        if not old["x"] or any(not np.array_equal(value, old[name][0]) for name, value in data.items()):
            self._sent.data = {name: [value] for name, value in data.items()}

    def clear(self) -> None:
        """Show no picture."""
        self._sent.data = EMPTY


def _words(colors: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Colours (..., 4) in bytes as Bokeh takes them."""
    return np.ascontiguousarray(colors).view(np.uint32)[..., 0]
