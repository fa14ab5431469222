"""Change one place of the drivers at a time, and count the changes that their tests find.

::

    .venv/bin/python benchmarks/mutants.py                 # the nine of the contract, against the contract and vectors
    .venv/bin/python benchmarks/mutants.py --all           # and the others, against every test of the drivers

A mutant that no test finds is printed; the exit code is their number.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

CONTRACT = ("tests/contract",)
TESTS = (*CONTRACT, "tests/unit/drivers", "tests/unit/test_drivers.py")

NINE = (
    ("sca100t.py", "frame[1] << 3 | frame[2] >> 5", "frame[1] << 2 | frame[2] >> 5"),
    ("registers.py", "if self.signed and word >> self.bits - 1", "if False"),
    ("parts.py", "Range(1, 256e3)", "Range(1, 256410.0)"),
    ("registers.py", "ready, self._ready = self._ready, False", "ready = self._ready"),
    ("bus/__init__.py", "if set(answers) == {byte}:", "if False:"),
    ("sca100t.py", "if word < LOWEST_SANE_WORD:", "if word < 0:"),
    ("converters.py", "before + slope * place", "before"),
    ("bus/__init__.py", "if len(answer) != length:", "if len(answer) > length:"),
    ("scl3300.py", "self.intact and self.operation == request[0] >> 2 and not unlike", "self.intact"),
)
"""A shift, a sign, a constant, set-up after an error, a stuck line, a fault word, a supply, a short line, and an answer
to another request of the SCL3300."""

OTHERS = (
    ("scl3300.py", "and not unlike", ""),
    ("scl3300.py", "if self.data & 0x8000", "if self.data & 0x4000"),
    ("scl3300.py", "crc = 0xFF\n", "crc = 0x00\n"),
    ("scl3300.py", "-273.0 + temperature", "-273.15 + temperature"),
    ("scl3300.py", "if raw[:-1] == list(requests[1:]):", "if False:"),
    ("scl3300.py", "GAP = 10e-6", "GAP = 1e-6"),
    ("scl3300.py", "if not statuses <= {NORMAL, ERROR} or", "if"),
    ("scl3300.py", "(flags or 0) & RESTARTED", "False"),
    ("scl3300.py", "whoami.status == NORMAL and not right", "False"),
    ("scl3300.py", "high.data << 16 | low.data", "low.data << 16 | high.data"),
    ("scl3300.py", "self._clock.sleep(self._range.settling)", "pass"),
    ("scl3300.py", "known.count(flags) > 1", "known.count(flags) > 2"),
    ("scl3300.py", "elif flags & ~SATURATED:", "elif False:"),
    ("sca100t.py", "REFRESH, RECOVERY = 150e-6", "REFRESH, RECOVERY = 15e-6"),
    ("model.py", "self.deflected >= 0.95 *", "self.deflected >= 0.9 *"),
    ("sca100t.py", "(frame[1] - 197) / -1.083", "(frame[1] - 197) / 1.083"),
    ("sca100t.py", "        finally:\n            self._command(MEAS)", "        finally:\n            pass"),
    ("sca100t.py", "(float(self._words[0] - self._words[1]),)", "(float(self._words[1] - self._words[0]),)"),
    ("sca100t.py", "<= HIGHEST_SANE_WORD:", "<= 2047:"),
    ("registers.py", ">> self.shift & (1 << self.bits) - 1", ">> self.shift"),
    ("registers.py", "first + self.part.count * count, self.part.count)", "first + count)"),
    ("registers.py", "if identity not in known:", "if False:"),
    ("registers.py", "if wrong := self._unlike(group):", "if False:"),
    ("registers.py", "for _ in range(self.part.dropped):", "for _ in ():"),
    ("parts.py", "if setting != before:", "if False:"),
    ("parts.py", 'if status & FRAME_ERROR and sensor.link.letter == "s":', "if False:"),
    ("parts.py", "if status & CHECKSUM_ERROR:", "if False:"),
    ("parts.py", "else again", "else pair"),
    ("parts.py", "if sensor.registers(SHADOW, SHADOWS) == sensor.remembered:", "if True:"),
    ("parts.py", "Write(0x2C, 0x80, ", "Write(0x2C, 0x00, "),
    ("parts.py", 'Field(0x28, 16, order="little")', "Field(0x28, 16)"),
    ("parts.py", "dropped=3", "dropped=0"),
    ("parts.py", "slope=-9.05", "slope=-9.0"),
    ("registers.py", "if ready and (wrong :=", "if False and (wrong :="),
    ("registers.py", "if count > 1 else 0", "if False else 0"),
    ("converters.py", "/ 32768\n", "/ 32767\n"),
    ("converters.py", "if held & DONE:", "if True:"),
    ("converters.py", "if held & ~DONE != config & ~DONE:", "if False:"),
    ("converters.py", "code in (-0x8000, 0x7FFF)", "code in (-0x8000,)"),
    ("converters.py", "answer[1] & 0x0F", "answer[1]"),
    ("converters.py", "CODES = 4096", "CODES = 4095"),
    ("converters.py", "if not 0.99 * self.low <= volts", "if not 0.0 <= volts"),
    ("converters.py", "/ self.volts for number", "/ NOMINAL for number"),
    ("analog.py", "max(values) < LOWEST_SANE", "min(values) < LOWEST_SANE"),
    ("analog.py", "(sca100t.D02, 0.4)", "(sca100t.D02, 0.5)"),
    ("analog.py", "ratio if self.grounded else 1.0 / ratio", "1.0 / ratio if self.grounded else ratio"),
    ("analog.py", "ZERO_CELSIUS = 273.15", "ZERO_CELSIUS = 273.0"),
    ("columns.py", "            if not whole:\n                continue\n", ""),
    ("columns.py", "if len(cells) != len(self.names):", "if len(cells) < len(self.names):"),
    ("columns.py", "now_ns - began_ns > PATIENCE * 1e9", "False"),
    ("columns.py", "> SILENCE * 1e9", "> 0"),
    ("columns.py", "            self._restart()\n            raise\n", "            raise\n"),
    ("adxl202.py", " or int(digits, 16) != reduce(xor, inside[1:], 0)", ""),
    ("adxl202.py", "return now - before - 1\n", "return now - before\n"),
    ("adxl202.py", "0.0 < t2x >= t1x", "0.0 < t2x"),
    ("adxl202.py", "return number != before", "return True"),
    ("adxl202.py", "if centres < rises", "if centres > rises"),
    (
        "adxl202.py",
        "            self.lost += gap\n            self._clear()",
        "            self.lost += gap",
    ),
    ("adxl202.py", "if abs(next_y.rise - y.rise - about) > MOST_APART * about:", "if False:"),
    ("modbus.py", "word[::-1] if swapped", "word if swapped"),
    ("modbus.py", "if not isfinite(number):", "if False:"),
    ("bus/modbus.py", "while not self._numbered and silent < SILENCE:", "while False:"),
    ("bus/modbus.py", "answer.function_code == function and len(", "len("),
    ("bus/modbus.py", "and len(answer.registers) == words[0]", ""),
    ("bus/address.py", "high is not None and value > high", "False"),
    ("bus/gpio.py", 'Struct("<', 'Struct(">'),
    ("bus/spi.py", "mode not in", "False and mode not in"),
    ("modbus.py", "if answer[:2] != head or len(answer)", "if len(answer)"),
    ("modbus.py", "BUSY_REQUESTS, BUSY_SECONDS = 20", "BUSY_REQUESTS, BUSY_SECONDS = 1"),
    ("modbus.py", "self._clock.sleep(BUSY_SECONDS)", "pass"),
)


def copy_code(root: Path, folder: str) -> None:
    """Copy what the tests of the drivers need."""
    for part in ("tiltcal", "drivers", "procedures", "tests", "pyproject.toml", "fixtures"):
        source, goal = root / part, Path(folder) / part
        if source.is_dir():
            shutil.copytree(source, goal, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, goal)


def a_test_fails(folder: str, tests: tuple[str, ...]) -> bool:
    """Return whether a test fails, or cannot even be collected, on the code in a folder."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": folder, "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True).returncode != 0


def survivors(root: Path, mutants: tuple[tuple[str, str, str], ...], tests: tuple[str, ...]) -> int:
    """Return the number of mutants that no test finds, and print them."""
    with tempfile.TemporaryDirectory() as folder:
        copy_code(root, folder)
        if a_test_fails(folder, tests):
            raise SystemExit("a test fails on the code as it is")
        missed = 0
        for name, old, new in mutants:
            path = Path(folder, "drivers", name)
            text = path.read_text(encoding="utf-8")
            if old not in text:
                raise SystemExit(f"{name} has no {old!r}")
            path.write_text(text.replace(old, new, 1), encoding="utf-8")
            if not a_test_fails(folder, tests):
                print(f"not found: {name}: {old!r} -> {new!r}", flush=True)
                missed += 1
            path.write_text(text, encoding="utf-8")
    return missed


def main() -> int:
    """Run the mutants and print those that survive."""
    everything = "--all" in sys.argv
    mutants, tests = (NINE + OTHERS, TESTS) if everything else (NINE, CONTRACT)
    missed = survivors(ROOT, mutants, tests)
    print(f"{len(mutants) - missed} of {len(mutants)} mutants found")
    return missed


if __name__ == "__main__":
    raise SystemExit(main())
