"""Shared by tests and scripts: independent simulators, random machines, a browser, an object store, fault injection."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""Folder of the checkout."""
