"""Shared by tests and scripts: simulators, published results, random machines, a browser, fault injection."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the checkout."""
