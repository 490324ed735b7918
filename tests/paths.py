"""Where the tests find the project's files and their own data."""

from tests.support import ROOT

DATA = ROOT / "tests" / "data"

__all__ = ["DATA", "ROOT"]
