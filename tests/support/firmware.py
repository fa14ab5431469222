"""The firmware of an ADXL202's microcontroller, built by its own Makefile and run under simavr, cycle by cycle."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

from support import ROOT

HARNESS = Path(__file__).parent / "simavr" / "run_firmware.c"
CLOCK = 16_000_000


@dataclass(frozen=True)
class Pulses:
    """Both outputs of a part, in cycles of 62.5 ns: T2, and T1 of each axis; 0 is an output without pulses.

    ``skew`` is how much later y is than x; ``centred`` whether that is said of the centres, and not of the rises.
    """

    period: int = 160_000
    x: int = 80_000
    y: int = 80_000
    skew: int = 0
    centred: bool = False

    def __str__(self) -> str:
        return f"period {self.period} x {self.x} y {self.y} skew {self.skew} centred {int(self.centred)}\n"


@cache
def missing() -> str | None:
    """Why the firmware cannot be run here, if so."""
    for program, package in (("avr-gcc", "gcc-avr"), ("gcc", "gcc"), ("make", "make")):
        if shutil.which(program) is None:
            return f"{program} is not installed (Debian: apt install {package})"
    if not Path("/usr/lib/avr/include/avr/io.h").exists():
        return "avr-libc is not installed (Debian: apt install avr-libc)"
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        return "simavr is not installed (Debian: apt install simavr libsimavr-dev libelf-dev)"
    return None


@dataclass(frozen=True)
class Board:
    """A board with the firmware."""

    harness: Path
    elf: Path

    def run(self, pulses: Pulses, seconds: float) -> bytes:
        """What it sends in so many simulated seconds."""
        command = [str(self.harness), str(self.elf), str(seconds)]
        return subprocess.run(command, input=str(pulses).encode(), capture_output=True, check=True, timeout=300).stdout

    @contextmanager
    def on_a_pty(self, pulses: Pulses) -> Iterator[RunningBoard]:
        """Run it on a pseudo-terminal while the block lasts."""
        command = [str(self.harness), str(self.elf), "1e9", "pty"]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1
        ) as process:
            try:
                process.stdin.write(str(pulses))
                # The first lines are simavr's own.
                path = next(line for line in process.stdout if line.startswith("/dev/"))
                yield RunningBoard(path.strip(), process, pulses)
            finally:
                process.kill()


class RunningBoard:
    """A board whose part can be moved; ``path`` is its serial port."""

    def __init__(self, path: str, process: subprocess.Popen[str], pulses: Pulses) -> None:
        self.path = path
        self._process = process
        self._pulses = pulses

    def set(self, **changes: int) -> None:
        """Change the pulses; in force on return."""
        self._pulses = replace(self._pulses, **changes)
        self._process.stdin.write(str(self._pulses))
        assert self._process.stdout.readline() == "ok\n"


def built(folder: Path) -> Board:
    """A board with the firmware of this tree."""
    if why := missing():
        pytest.skip(why)
    subprocess.run(["make", "-s", "-C", str(ROOT / "firmware"), f"BUILD={folder}"], check=True, capture_output=True)
    harness = folder / "run_firmware"
    subprocess.run(
        ["gcc", "-O2", "-Wall", "-Werror", "-I/usr/include/simavr", "-o", harness, HARNESS, "-lsimavr", "-lelf"],
        check=True,
    )
    return Board(harness, folder / "adxl202.elf")
