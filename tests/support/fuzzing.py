"""Damaged input for every reader, driver and command: each ends in a result or in an error of ours.

An input is known by the name of its target, a seed and a number. Inputs are tried in worker processes, one of which
tries thousands; where a library in C or Rust ends the worker, the next one goes on. Run as a script this module is such
a worker.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import chdir, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parents[1]))

import support.fuzz_commands
import support.fuzz_readers  # noqa: F401
from support.fuzz_inputs import TARGETS
from tiltcal.errors import TiltcalError

SECONDS = 10
"""Of processor time for one input."""

PATIENCE = 60
"""Seconds without an answer after which a worker is ended."""

BATCH = 20_000
"""Inputs that one worker tries before the next one starts."""

MEGABYTES = 1000
ENDED = "ended by its library"
FAILED = "failed"
RESULT = "result"
OURS = "our error"


class TooSlow(BaseException):
    """An input took longer than it may."""


def attempt(name: str, seed: int, number: int) -> tuple[str, str]:
    """Try an input, and return how it ended and what there is to say of it."""
    draw = Random(f"{seed}/{name}/{number}")
    with _folder_for(name) as folder, chdir(folder):
        alarm = signal.signal(signal.SIGPROF, _too_slow)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            TARGETS[name].body(draw)
        except TiltcalError:
            return OURS, ""
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            return FAILED, "".join(traceback.format_exception(error)[-8:])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, alarm)
        return RESULT, ""


@contextmanager
def _folder_for(name: str) -> Iterator[str]:
    """Yield an empty folder for a command; readers write over the file of the input before, in one folder."""
    if TARGETS[name].share > 1:
        yield _readers_folder().name
        return
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        yield folder


@cache
def _readers_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="fuzz-")


def _too_slow(*_: object) -> None:
    raise TooSlow(f"longer than {SECONDS} s")


@dataclass
class Figures:
    """How inputs of one target ended, and the ones that should not have ended so."""

    ends: Counter[str] = field(default_factory=Counter)
    failures: list[tuple[int, str]] = field(default_factory=list)

    def add(self, number: int, end: str, detail: str = "") -> None:
        """Count an input."""
        self.ends[end] += 1
        if end == FAILED:
            self.failures.append((number, detail))


class Campaign:
    """Tries inputs in a worker process that is started again when it ends."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._worker: subprocess.Popen[bytes] | None = None
        self._tried = 0

    def run(self, name: str, numbers: range) -> Figures:
        """Try inputs of one target."""
        figures, place = Figures(), 0
        while place < len(numbers):
            for end, detail in self._answers(name, numbers[place:]):
                figures.add(numbers[place], end, detail)
                place += 1
        return figures

    def close(self) -> None:
        """End the worker."""
        if self._worker is not None:
            self._worker.kill()
            self._worker.communicate()
        self._worker, self._tried = None, 0

    def _answers(self, name: str, numbers: range) -> Iterator[tuple[str, str]]:
        """Yield how inputs ended, up to one that ended the worker."""
        if self._tried > BATCH:
            self.close()
        if self._worker is None:
            self._worker = subprocess.Popen(
                [sys.executable, __file__, str(self._seed)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        self._tried += len(numbers)
        asked, answered = self._worker.stdin, self._worker.stdout
        assert asked is not None
        assert answered is not None
        with suppress(BrokenPipeError):
            asked.write(json.dumps((name, numbers.start, numbers.stop)).encode() + b"\n")
            asked.flush()
        waiting = b""
        for _ in numbers:
            while b"\n" not in waiting:
                ready, _, _ = select.select([answered], [], [], PATIENCE)
                more = os.read(answered.fileno(), 1 << 16) if ready else b""
                if more:
                    waiting += more
                    continue
                how = f"ended by signal {-self._worker.wait()}" if ready else f"no answer for {PATIENCE} s"
                self.close()
                # A library may end its process, or compute without an end: the command ends it then after 8 s.
                yield ENDED if TARGETS[name].compiled else FAILED, how
                return
            line, _, waiting = waiting.partition(b"\n")
            end, detail = json.loads(line)
            yield end, detail


def work(seed: int) -> None:
    """Be a worker: for each line with a target and two numbers answer how each input of theirs ended."""
    for module in ("polars", "xarray", "h5netcdf", "jinja2"):
        import_module(module)  # else the first input pays for it
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    most = 8 << 30
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    for line in sys.stdin:
        name, first, last = json.loads(line)
        for module in () if TARGETS[name].compiled else ("scipy.optimize", "scipy.signal", "matplotlib.figure"):
            import_module(module)  # compiled targets use none of these
        for number in range(first, last):
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            end, detail = attempt(name, seed, number)
            used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            if used > before and used > 1024 * MEGABYTES:
                end, detail = FAILED, f"{used / 1024:.0f} MB of memory"
            print(json.dumps((end, detail)), file=answers, flush=True)


if __name__ == "__main__":
    work(int(sys.argv[1]))
