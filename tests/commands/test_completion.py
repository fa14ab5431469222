"""What a shell offers behind a command, by the protocols that click has for bash, zsh and fish."""

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from support.command import loaded_by, tiltcal
from support.warm_start import WarmStart

BENCH = "tiltcal: 1\nkind: bench\nsensors: [{serial: S-7, model: adxl202, address: 'sim:'}]\n"
FILE = "file"


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("tiltcal me", ["measure"]),
        ("tiltcal measure zer", [FILE, "zero-45"]),
        ("tiltcal fit six", [FILE, "six-face"]),
        ("tiltcal plan plane --sensor sca103t-d0", [FILE, "sca103t-d04", "sca103t-d05"]),
        ("tiltcal probe --sensor bei-rs23", [FILE, "bei-rs232"]),
        ("tiltcal measure plane --operator ", ["terminal", "web", "json", "sim"]),
        ("tiltcal export S.yaml --to p", ["px4", "python"]),
        ("tiltcal measure plane --serial ", ["S-7"]),
        ("tiltcal measure --bench bench.yaml --base ", [FILE]),
        ("tiltcal apply S.yaml ", [FILE]),
        ("tiltcal measure --hands", ["--hands-free"]),
    ],
)
def test_each_shell_is_offered_the_same(
    line: str, offered: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bench.yaml").write_text(BENCH)
    (tmp_path / "S.yaml").write_text("a damaged: [file")
    before, _, last = line.rpartition(" ")
    for shell in ("bash", "zsh", "fish"):
        monkeypatch.setenv("_TILTCAL_COMPLETE", f"{shell}_complete")
        monkeypatch.setenv("COMP_WORDS", line if shell != "fish" else before)
        monkeypatch.setenv("COMP_CWORD", last if shell == "fish" else str(before.count(" ") + 1))
        lines = tiltcal(cwd=tmp_path).stdout.splitlines()
        if shell == "bash":
            found = [value if kind == "plain" else kind for kind, _, value in (one.partition(",") for one in lines)]
        elif shell == "zsh":
            found = [value if kind == "plain" else kind for kind, value in zip(lines[::3], lines[1::3], strict=True)]
        else:
            lines = [one for one in lines if "," in one]
            found = [
                value.split("\t")[0] if kind == "plain" else kind
                for kind, _, value in (one.partition(",") for one in lines)
            ]
        assert found == offered, shell


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_the_line_of_the_readme_completes_in_bash(warm: WarmStart, tmp_path: Path) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (line,) = [one for one in readme.splitlines() if one.startswith("eval ")]
    typed = "COMP_WORDS=(tiltcal measure zer); COMP_CWORD=2; compopt() { :; }; _tiltcal_completion tiltcal"
    (tmp_path / "tiltcal").write_text(f'#!/bin/sh\nexec {shlex.join(warm.program)} "$@"\n')
    (tmp_path / "tiltcal").chmod(0o755)
    script = f'PATH="$PWD:$PATH"; {line}; {typed}; echo "$COMPREPLY"'
    done = subprocess.run(["bash", "--norc", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == "zero-45\n", done.stderr


def test_the_names_of_commands_load_none_of_them() -> None:
    state = {"_TILTCAL_COMPLETE": "bash_complete", "COMP_WORDS": "tiltcal ", "COMP_CWORD": "1"}
    loaded = loaded_by(
        f"import os\nos.environ |= {state}\nfrom tiltcal.cli.main import run\n"
        "out = sys.stdout\nrun([])\nsys.stdout = out"
    )
    assert not loaded & {"numpy", "polars", "yaml", "rich"}
