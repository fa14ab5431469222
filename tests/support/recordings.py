"""Recordings of real sensors that are not the project's own; a test that needs one is skipped where it is missing."""

from __future__ import annotations

import pytest

from support import ROOT

RECORDINGS = ROOT.parent / "shared" / "data"


def needs(*names: str) -> pytest.MarkDecorator:
    """Return the mark of a test that reads these files."""
    missing = [name for name in names if not (RECORDINGS / name).exists()]
    return pytest.mark.skipif(bool(missing), reason=f"no recording {', '.join(missing)} in the folder of recordings")
