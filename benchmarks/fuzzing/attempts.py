"""Damaged input for every reader, driver and command: each ends in a result or in an error of ours.

An input is given by the name of its target, a seed and a number. A library in C or Rust may end the process in which it
parses the input: these are tried in another one, as which this module runs as a script.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1]))

import fuzzing.commands
import fuzzing.readers  # noqa: F401
from fuzzing.inputs import TARGETS
from tiltcal.errors import TiltcalError

SECONDS = 10
"""Of processor time for one input."""

MEGABYTES = 1000
"""Of memory for the inputs of one process."""

ENDED = "ended by its library"
FAILED = "failed"
RESULT = "result"
OURS = "our error"


class TooSlow(BaseException):
    """An input took longer than it may."""


def attempt(name: str, seed: int, number: int) -> tuple[str, str]:
    """Try an input, and return how it ended and what there is to say of it."""
    draw = Random(f"{seed}/{name}/{number}")
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, chdir(folder):
        alarm = signal.signal(signal.SIGPROF, _too_slow)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            TARGETS[name].body(draw)
        except TiltcalError:
            return OURS, ""
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            return FAILED, "".join(traceback.format_exception(error)[-8:])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, alarm)
    return RESULT, ""


def _too_slow(*_: object) -> None:
    raise TooSlow(f"longer than {SECONDS} s")


def attempts(name: str, seed: int, numbers: range) -> Iterator[tuple[int, str, str]]:
    """Try inputs in another process, the next one where a library ends it; yield the number and how each ended."""
    while numbers:
        command = [sys.executable, __file__, name, str(seed), str(numbers.start), str(numbers.stop)]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        answers = [json.loads(line) for line in done.stdout.splitlines()]
        if len(answers) < len(numbers):
            answers.append((ENDED if TARGETS[name].compiled else FAILED, f"its process ended with {done.returncode}"))
        for number, (end, detail) in zip(numbers, answers, strict=False):
            yield number, end, detail
        numbers = numbers[len(answers) :]


def work(name: str, seed: int, numbers: range) -> None:
    """Print how each input ended."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (60 + SECONDS * len(numbers),) * 2)
    before = 0
    for number in numbers:
        end, detail = attempt(name, seed, number)
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        if used > max(before, MEGABYTES):
            end, detail = FAILED, f"{used} MB of memory"
        before = used
        print(json.dumps((end, detail)), file=answers, flush=True)


if __name__ == "__main__":
    work(sys.argv[1], int(sys.argv[2]), range(int(sys.argv[3]), int(sys.argv[4])))
