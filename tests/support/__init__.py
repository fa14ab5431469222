"""What tests and benchmarks share: independent parts, simulators, and ways to run the program."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The repository."""

FIXTURES = ROOT / "fixtures"

WITHOUT_PRIORS = Path(__file__).parent / "calibration_without_priors.yaml"
"""A calibration file of the time when what no position determines counted as zero."""
