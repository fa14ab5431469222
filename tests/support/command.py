"""The tiltcal command: called in this process, or started as a user starts it."""

import io
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from threading import Thread
from typing import TextIO
from unittest.mock import patch

from tiltcal.cli.main import run

TILTCAL = [sys.executable, "-m", "tiltcal"]

Completed = subprocess.CompletedProcess


def tiltcal(
    *args: str | Path, cwd: Path | None = None, said: str = "", merged: bool = False, code: int | None = None
) -> Completed:
    """Call the command line in this process, and return its exit code and what it printed.

    A process of its own takes a second to start, and tells no more unless the test is about the process: a signal, a
    pipe, what is imported. An exception that is not ours leaves this function as it is.

    ``said`` is standard input, which is a pipe; ``merged``: standard error goes where standard output goes; ``code`` is
    the exit code that the command must have.
    """
    with _printed() as stdout, _printed() as stderr, _pipe(said) as stdin:
        found = called(args, cwd, stdin, stdout, stdout if merged else stderr)
        done = Completed(["tiltcal", *map(str, args)], found, _text(stdout), _text(stderr))
    assert code in (None, found), f"{' '.join(done.args)}: exit code {found}\n{done.stdout}{done.stderr}"
    return done


def called(
    args: Sequence[str | Path], cwd: Path | None, stdin: TextIO | None, stdout: TextIO | None, stderr: TextIO | None
) -> int:
    """Call the command line with these standard streams in a folder, and return its exit code; None is a closed one."""
    with chdir(cwd or "."), patch.object(sys, "stdin", stdin), redirect_stdout(stdout), redirect_stderr(stderr):
        return run([str(arg) for arg in args])


def tiltcal_process(*args: str | Path, cwd: Path | None = None, said: str = "") -> Completed:
    """Run the command in a process of its own, to its end."""
    command = [*TILTCAL, *map(str, args)]
    return subprocess.run(command, cwd=cwd, input=said, text=True, capture_output=True, timeout=120, check=False)


def loaded_by(statement: str) -> set[str]:
    """Return the top-level modules that a fresh Python has loaded after a statement."""
    script = f"import sys\n{statement}\nprint('\\nloaded', *{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


def measure(
    *args: str | Path, cwd: Path, procedure: str = "plane", said: str = "", code: int | None = None
) -> Completed:
    """Measure a virtual SCA100T-D02 with the virtual jig, into S-1.yaml; later options override earlier ones."""
    options = ["--sensor", "sca100t-d02", "--address", "sim:?seed=1", "--serial", "S-1", "-o", "S-1.yaml"]
    return tiltcal("measure", procedure, *options, "--operator", "sim", *args, cwd=cwd, said=said, code=code)


@contextmanager
def _printed() -> Iterator[io.TextIOWrapper]:
    """Yield a stream like the standard ones, with a buffer of bytes behind it."""
    with io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) as stream:
        yield stream


def _text(stream: io.TextIOWrapper) -> str:
    stream.flush()
    buffer = stream.buffer
    assert isinstance(buffer, io.BytesIO)
    return buffer.getvalue().decode("utf-8")


@contextmanager
def _pipe(said: str) -> Iterator[TextIO]:
    """Yield the end of a pipe that a text comes out of."""
    reading, writing = os.pipe()

    def feed() -> None:
        with open(writing, "wb") as into:
            try:
                into.write(said.encode())
                into.flush()
            except BrokenPipeError:  # the command has read what it needs
                into.detach()

    feeder = Thread(target=feed)
    feeder.start()
    try:
        with open(reading, encoding="utf-8") as out_of:
            yield out_of
    finally:
        feeder.join()
