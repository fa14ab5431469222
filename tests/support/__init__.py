"""What tests and benchmarks share: independent parts, simulators, and ways to run the program."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The repository."""

FIXTURES = ROOT / "fixtures"
