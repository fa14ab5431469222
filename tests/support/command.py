"""The tiltcal command as a user runs it: a process of its own, in a folder of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TILTCAL = [sys.executable, "-m", "tiltcal"]


def tiltcal(*args: str | Path, cwd: Path | None = None, said: str = "") -> subprocess.CompletedProcess[str]:
    """Run a command to its end; ``said`` is its standard input."""
    return subprocess.run(
        [*TILTCAL, *map(str, args)], cwd=cwd, input=said, text=True, capture_output=True, timeout=120, check=False
    )


def measure(*args: str | Path, cwd: Path, procedure: str = "plane", said: str = "") -> subprocess.CompletedProcess[str]:
    """Measure a virtual SCA100T-D02 with the virtual jig, into S-1.yaml; later options override earlier ones."""
    options = ["--sensor", "sca100t-d02", "--address", "sim:?seed=1", "--serial", "S-1", "-o", "S-1.yaml"]
    return tiltcal("measure", procedure, *options, "--operator", "sim", *args, cwd=cwd, said=said)
