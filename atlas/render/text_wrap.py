"""Breaking labels and titles that are too long for their figure into lines."""

import re
from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

TITLE = "title"
"""Matplotlib group name of titles that may be broken at commas."""
_LEAST = 3.0
"""Minimum length of an upright label that may be broken, in its own widths: small plots have no room for lines."""
OWN_TITLE = "own title"
"""Matplotlib group name of titles of single plots, which must not be wider than their plot."""


def wrap_texts(fig: Figure) -> None:
    """Break labels and titles that are longer than the figure into lines."""
    for _ in range(3):  # a label in two lines leaves less room for all others
        fig.draw_without_rendering()
        titles: Any = fig.findobj(lambda artist: isinstance(artist, Text) and artist.get_gid() in (TITLE, OWN_TITLE))
        if not any([_fit_title(fig, title) for title in titles] + [_fit_labels(fig)]):
            return


def _fit_title(fig: Figure, text: Text) -> bool:
    """Put as many comma-separated parts of a title into each line as fit, and return True if the title has changed."""
    before = text.get_text()
    end = text.axes.bbox.x1 if text.axes and text.get_gid() == OWN_TITLE else fig.bbox.x1 - 3.0
    extent = text.get_window_extent()
    for legend in fig.legends:
        box = legend.get_window_extent()
        if box.x0 > extent.x0 and box.y1 > extent.y0:  # an artist beside the title
            end = min(end, box.x0 - 3.0)
    room = end - extent.x0
    lines = []
    for line in before.replace(",\n", ",  ").split("\n"):  # a line broken earlier may fit now
        text.set_text(line)
        if text.get_window_extent().width <= room:
            lines.append(line)
            continue
        current_line, *rest = re.split(r"(?<=,)( +)", line)
        for space, part in zip(rest[::2], rest[1::2], strict=True):
            text.set_text(f"{current_line}{space}{part}")
            if text.get_window_extent().width <= room:
                current_line = text.get_text()
            else:
                lines.append(current_line)
                current_line = part
        lines.append(current_line)
    text.set_text("\n".join(lines))
    return text.get_text() != before


def _fit_labels(fig: Figure) -> bool:
    """Break axis labels that leave the figure, are longer than an upright axis, or meet their neighbours.

    Return True if any label has changed.
    """
    levels = [ax.xaxis.label.get_window_extent() for ax in fig.axes if ax.get_xlabel()]
    uprights = [ax.yaxis.label.get_window_extent() for ax in fig.axes if ax.get_ylabel()]
    changed = False
    for ax in fig.axes:
        across, up = (text.get_window_extent() for text in (ax.xaxis.label, ax.yaxis.label))
        too_long = {
            ax.xaxis.label: across.x0 < 0.0 or across.x1 > fig.bbox.width or _meets(across, levels),
            ax.yaxis.label: up.y0 < 0.0
            or up.y1 > fig.bbox.height
            or up.height > max(ax.bbox.height, _LEAST * up.width)
            or _meets(up, uprights),
        }
        for text in [label for label, long in too_long.items() if long and label.get_text()]:
            before = text.get_text()
            text.set_text(_broken(before))
            changed |= text.get_text() != before
    return changed


def _meets(box: Bbox, boxes: Sequence[Bbox]) -> bool:
    """Return True if the box of a label overlaps another of ``boxes``."""
    return box.padded(2.0).count_overlaps([other for other in boxes if other.bounds != box.bounds]) > 0


def _broken(label: str) -> str:
    """Return a label with its longest line broken in two, at the space nearest to the middle of the line.

    Spaces in formulas and brackets do not count.
    """
    lines = label.split("\n")
    longest = max(range(len(lines)), key=lambda i: len(_read(lines[i])))
    line = lines[longest]
    spaces = [
        at
        for at, letter in enumerate(line)
        if letter == " " and line[:at].count("$") % 2 == 0 and line[:at].count("[") == line[:at].count("]")
    ]
    if not spaces:
        return label
    at = min(spaces, key=lambda i: abs(len(_read(line[:i])) - len(_read(line)) / 2))
    lines[longest : longest + 1] = [line[:at], line[at + 1 :]]
    return "\n".join(lines)


def _read(text: str) -> str:
    """Return a label's source shortened to about its visible length, with each symbol of mathtext as one letter."""
    return re.sub(r"\\[a-z]+", "x", text).translate(str.maketrans("", "", "${}_^"))
