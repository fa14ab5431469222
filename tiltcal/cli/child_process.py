"""A child process for commands that read formats of C or Rust libraries.

A damaged Parquet or NetCDF file can end the process in its library (an abort, a crash) or keep it there for ever,
where Ctrl-C has no effect. Where such a file is named, the command runs in a child process: this one waits, hands
Ctrl-C on, and turns a child that was ended, or computes for long with a NetCDF file open and not a byte of progress,
into an error that names the file. What the child was writing appears whole or not at all, so nothing half done is left.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import PurePath
from select import select

from tiltcal.cli.talk import talk
from tiltcal.errors import INTERRUPTED, InputError

GUARDED = (".parquet", ".pq", ".nc", ".nc4")
"""Suffixes of guarded files."""

MAY_LOOP = (".nc", ".nc4")
"""Suffixes whose library reads every byte by a call, so that progress is visible."""

BUSY = 8.0
"""Largest processor time of a child with such a file open and without I/O, s."""

_PATIENCE = 3.0  # seconds in which an interrupted child must leave
_LOOK = 0.05  # seconds between two looks at a child that has not ended


def needs_guard(args: Sequence[str]) -> bool:
    """Return whether a command line names a file that is guarded, where processes can be forked."""
    return hasattr(os, "fork") and sys.platform == "linux" and any(_guarded(args))


def run_guarded(run: Callable[[], int], args: Sequence[str]) -> int:
    """Run a command in a child process, and return its exit code; ``args`` is its line, to name files in messages."""
    interruption = _Interruption()
    before = signal.signal(signal.SIGINT, interruption.note)
    ended, held = os.pipe()
    child = os.fork()
    if not child:
        signal.signal(signal.SIGINT, before)
        _silence_libraries()
        os._exit(run())
    interruption.child = child
    os.close(held)  # the child alone holds it now, and `ended` can be read when it has ended
    files = _guarded(args)
    try:
        code = _watched(child, ended, [name for name in files if _ends(name, MAY_LOOP)], interruption)
    finally:
        os.close(ended)
        signal.signal(signal.SIGINT, before)
    if code >= 0:
        return code
    if interruption.since is not None:
        talk("tiltcal: interrupted")
        return INTERRUPTED
    talk(f"tiltcal: {' or '.join(files)} cannot be read: {_ending(-code)}; the file is damaged")
    return InputError.exit_code


def _silence_libraries() -> None:
    """Drop what libraries print on standard error by themselves, such as a panic; what Python prints stays."""
    if sys.stderr is None:
        return
    sys.stderr = open(os.dup(2), "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors)  # noqa: SIM115
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _guarded(args: Sequence[str]) -> list[str]:
    return [arg for arg in args if _ends(arg, GUARDED) and os.path.isfile(arg)]


def _ends(name: str, suffixes: Sequence[str]) -> bool:
    return PurePath(name).suffix.lower() in suffixes


def _watched(child: int, ended: int, loopable: Sequence[str], interruption: _Interruption) -> int:
    """Wait for a child, and return its exit code, or the negative number of its signal.

    ``ended`` is a descriptor that can be read when the child has ended.
    """
    progress: dict[int, _Progress] = {}
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        waited = 0.0 if interruption.since is None else time.monotonic() - interruption.since
        if waited > _PATIENCE:
            os.kill(child, signal.SIGKILL)
        elif waited > 2 * _LOOK:
            interruption.hand_on()
        elif loopable:
            for process in (child, *_children(child)):
                if progress.setdefault(process, _Progress(process, loopable)).stalled():
                    os.kill(process, signal.SIGXCPU)
        select([ended], [], [], _LOOK)


def _children(process: int) -> list[int]:
    """Return the processes that work through several files for a child."""
    with suppress(OSError), open(f"/proc/{process}/task/{process}/children", "rb") as line:
        return [int(number) for number in line.read().split()]
    return []


class _Interruption:
    """Ctrl-C at this process, and its way to the child: once, and at once where no terminal sends it to both.

    Attributes
    ----------
    child : int
        Process number; 0 before there is one.
    since : float or None
        When it came, s of the monotonic clock.
    """

    def __init__(self) -> None:
        self.child = 0
        self.since: float | None = None
        self._handed_on = False

    def note(self, *_: object) -> None:
        """Handle the signal."""
        if self.since is None:
            self.since = time.monotonic()
        if self.child and not _in_front_of_a_terminal():
            self.hand_on()

    def hand_on(self) -> None:
        """Interrupt the child; on a terminal Ctrl-C has reached it already, and it leaves by itself before this."""
        if not self._handed_on:
            self._handed_on = True
            with suppress(ProcessLookupError):
                os.kill(self.child, signal.SIGINT)


def _in_front_of_a_terminal() -> bool:
    """Return whether this process group is the one that a terminal sends Ctrl-C to."""
    try:
        terminal = os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)
    except OSError:
        return False
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False
    finally:
        os.close(terminal)


class _Progress:
    """The I/O of a process, and its processor time since the I/O last changed.

    Parameters
    ----------
    files : sequence of str
        Only while one of them is open does the time count.
    """

    def __init__(self, process: int, files: Sequence[str]) -> None:
        self._folder = f"/proc/{process}"
        self._files = {os.path.realpath(name) for name in files}
        self._tick = os.sysconf("SC_CLK_TCK")
        self._moved: tuple[bytes, ...] = ()
        self._since = 0.0

    def stalled(self) -> bool:
        """Return whether the process computes without I/O."""
        try:
            with open(f"{self._folder}/io", "rb") as counts:
                moved = tuple(counts.read().split()[1:8:2])
            with open(f"{self._folder}/stat", "rb") as line:
                fields = line.read().rpartition(b")")[2].split()
        except OSError:  # it has just ended
            return False
        busy = (int(fields[11]) + int(fields[12])) / self._tick
        if moved != self._moved or not self._files & set(self._open_files()):
            self._moved, self._since = moved, busy
        return busy - self._since > BUSY

    def _open_files(self) -> Iterator[str]:
        with suppress(OSError):
            for handle in os.listdir(f"{self._folder}/fd"):
                yield os.path.realpath(f"{self._folder}/fd/{handle}")


def _ending(number: int) -> str:
    if number == signal.SIGXCPU:
        return f"its library computed for {BUSY:g} s without an end"
    return f"its library was ended by {signal.Signals(number).name}"
