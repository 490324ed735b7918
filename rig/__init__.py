"""What tests and scripts share: simulators, published results, random machines, a browser, faults on cue."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""The checkout."""
