"""Numbers in words, for a person who reads a terminal."""

from collections.abc import Mapping


def duration(seconds: float) -> str:
    """Seconds in words: 0.4 s, 12 s, 3 min 20 s, 5 h 10 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def plural(count: int, noun: str, many: str = "") -> str:
    """A count with its noun: 1 tile, 2 tiles; ``many`` is the plural where an s does not make it."""
    return f"{count} {noun if count == 1 else many or f'{noun}s'}"


def byte_size(count: int) -> str:
    """Bytes with a unit: 12 B, 3.4 kB, 1.2 GB."""
    size = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def shares(counts: Mapping[str, int]) -> str:
    """Counts as shares of their sum: ``periodic 62.1 %, chaotic 37.9 %``, the most frequent first."""
    total = sum(counts.values())
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {100 * count / total:.1f} %" for name, count in ordered)
