"""Every example runs as it stands and prints what it promises."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support import ROOT
from support.warm_start import WarmStart

EXAMPLES = ROOT / "examples"
PRINTED = {
    "night.py": r"A-1 x: -?0\.\d+ ± 0\.\d+ count/°C",
    "pair.py": r"p = 0\.00\d+ ± 0\.0000\d+(.|\n)*standard deviation \S+e-05 before, \S+e-06 after",
    "phone.py": r"offset z +0\.30\d+ ± 0\.00\d+ m/s2",
    "rig.py": r"Tilt the \+X side up to 30°(.|\n)*degrees of freedom 2",
    "sketch.sh": r"-?[0-2]\.\d -?[0-2]\.\d\n3\d\.\d -?[0-2]\.\d\n-?[0-2]\.\d -3\d\.\d\n",
}
"""Of each script a part of its output; what the virtual sensors have is bounded by their data sheets."""


@pytest.mark.parametrize("name", [path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".sh")])
def test_an_example_runs(name: str, warm: WarmStart, tmp_path: Path) -> None:
    if name.endswith(".sh") and shutil.which("cc") is None:
        pytest.skip("there is no compiler: cc is not installed")
    shim = tmp_path / "bin" / "tiltcal"
    shim.parent.mkdir()
    shim.write_text(f'#!/bin/sh\nexec {" ".join(warm.program)} "$@"\n', encoding="utf-8")
    shim.chmod(0o755)
    done = subprocess.run(
        ["sh" if name.endswith(".sh") else sys.executable, EXAMPLES / name],
        cwd=tmp_path,
        env=os.environ | {"PATH": f"{shim.parent}{os.pathsep}{os.environ['PATH']}", "MPLBACKEND": "agg"},
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(PRINTED[name], done.stdout), done.stdout
    assert 15 <= len((EXAMPLES / name).read_text(encoding="utf-8").splitlines()) <= 45
