"""What tests and benchmarks share: independent parts, simulators, and ways to run the program."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The repository."""

FIXTURES = ROOT / "fixtures"
DATA = ROOT.parent / "shared" / "data"
"""Recordings that are not the project's; tests that need them are skipped where they are missing."""
