"""Harm done to a file, for tests of who notices."""

from pathlib import Path


def flip(path: Path, byte: int = 5) -> None:
    """Change a bit of a byte."""
    data = bytearray(path.read_bytes())
    data[byte] ^= 0x10
    path.write_bytes(data)
