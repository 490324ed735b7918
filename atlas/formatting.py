"""Numbers, counts and times as text, and mathematical symbols in Unicode, for terminals and pages that cannot show
mathtext.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from html import escape
from typing import Any

SIGNS = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta": "θ",
    "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ", "sigma": "σ", "tau": "τ",
    "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω", "Gamma": "Γ", "Delta": "Δ", "Lambda": "Λ", "Omega": "Ω",
    "infty": "∞", "mathrm": "", "mathit": "",
}  # fmt: skip
_BELOW = str.maketrans("0123456789aehijklmnoprstuvx", "₀₁₂₃₄₅₆₇₈₉ₐₑₕᵢⱼₖₗₘₙₒₚᵣₛₜᵤᵥₓ")
_UNDERSCORE = "\0"
"""Placeholder for an underscore that belongs to a name while subscripts are converted."""


def duration(seconds: float) -> str:
    """Return a duration as text: 0.4 s, 12 s, 3 min 20 s, 5 h 10 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    if total < 3600:
        return f"{total // 60} min {total % 60} s"
    return f"{total // 3600} h {total % 3600 // 60} min"


def short_repr(value: Any) -> str:
    """Return a dataclass as the text of a call with the fields that differ from their defaults.

    Fields with ``repr=False`` are left out.
    """
    visible_fields = [entry for entry in fields(value) if entry.repr]
    changed = [
        f"{entry.name}={field_value!r}"
        for entry in visible_fields
        if (field_value := getattr(value, entry.name)) != entry.default
    ]
    return f"{type(value).__name__}({', '.join(changed)})"


def plural(count: int, noun: str, many: str = "") -> str:
    """Return a count with its noun: 1 tile, 2 tiles. ``many`` is an irregular plural."""
    return f"{count} {noun if count == 1 else many or f'{noun}s'}"


def motion_name(period: int, upper: int, lower: int) -> str:
    """Return the name n-p-q of a periodic motion: forcing periods, impacts at the upper and at the lower stop."""
    return f"{period}-{upper}-{lower}"


def count_of(number: int) -> str:
    """Return a large number as text: 8700, 12.3 thousand, 3.4 million."""
    for size, name in ((10**6, "million"), (10**3, "thousand")):
        if number >= 10 * size or number >= 10**6:
            return f"{number / size:.3g} {name}"
    return str(number)


def byte_size(count: int) -> str:
    """Return a number of bytes with a unit: 12 B, 3.4 kB, 1.2 GB."""
    size = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


class PrintableResult:
    """Base class of the results of commands, dataclasses that a terminal, a notebook and JSON show by their
    ``rows``.
    """

    @property
    def rows(self) -> Sequence[tuple[str, ...]]:
        """The facts to show, in order, each a tuple of texts: a sentence, a pair of a name and a text, or a row of a
        table.
        """
        raise NotImplementedError

    def __str__(self) -> str:
        return text_table(self.rows)

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return html_table(self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Return the facts as the dict that the command prints with ``--json``: by default the fields, by name."""
        return asdict(self)  # type: ignore[call-overload]


def text_table(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows as lines. Rows of the same length are aligned; the cells of a table stand to the right, indented."""
    widths = {
        columns: [max(map(len, column)) for column in zip(*(row for row in rows if len(row) == columns), strict=True)]
        for columns in {len(row) for row in rows}
    }

    def line(row: tuple[str, ...]) -> str:
        name, *cells = row
        if len(cells) < 2:
            return "  ".join([f"{name:<{widths[2][0]}}", *cells]) if cells else name
        return "  ".join(["", f"{name:<{widths[len(row)][0]}}", *map(str.rjust, cells, widths[len(row)][1:])])

    return "\n".join(map(line, rows))


def html_table(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows as an HTML table for a notebook; the last cell of a short row spans the remaining columns."""
    columns = max(map(len, rows), default=0)

    def cell(text: str, span: int) -> str:
        return f'<td colspan="{span}" style="text-align: left">{escape(text)}</td>'

    lines = ("".join(cell(text, 1) for text in row[:-1]) + cell(row[-1], columns - len(row) + 1) for row in rows)
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def shares(counts: Mapping[str, int]) -> str:
    """Return counts as shares of their sum, the largest first: ``periodic 62.1 %, chaotic 37.9 %``."""
    total = sum(counts.values())
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {100 * count / total:.1f} %" for name, count in ordered)


def mathtext_to_unicode(symbol: str) -> str:
    """Return a symbol of mathtext in Unicode: ``\\mu_m`` as μₘ."""
    text = symbol.replace(r"\_", _UNDERSCORE)
    text = re.sub(r"\\dot\s*\{?\s*(\w)", "\\1\N{COMBINING DOT ABOVE}", text)
    text = re.sub(r"\\([A-Za-z]+)", lambda match: SIGNS.get(match[1], match[1]), text)
    text = re.sub(r"_\{([^}]*)\}|_(\w)", lambda match: _lowered(match[1] or match[2]), text)
    return unicodedata.normalize("NFC", re.sub(r"[{}$\\,]", "", text)).replace(_UNDERSCORE, "_")


def _lowered(text: str) -> str:
    low = text.translate(_BELOW)
    return low if all(below != character for below, character in zip(low, text, strict=True)) else f"_{text}"
