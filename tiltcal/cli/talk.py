"""Messages, progress and unforeseen errors on standard error: where its reader has ended, a command goes on."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import TYPE_CHECKING

import click

from tiltcal import __version__
from tiltcal.errors import Argument, InputError, TiltcalError
from tiltcal.printable import printable

if TYPE_CHECKING:
    from tiltcal.logs.log import Progress

TRACEBACK = "TILTCAL_TRACEBACK"
"""Environment variable: where it is set, such an error leaves the command as Python prints it."""

_LONGEST = 300  # characters of such an error that are printed


def talk(text: str) -> None:
    """Print a text as it is."""
    if sys.stderr is not None:
        with suppress(OSError):
            print(text, file=sys.stderr, flush=True)


def remark(text: str) -> None:
    """Print a remark on what a command does, broken at the width of a terminal."""
    shown = printable(text)
    talk(wrapped(shown) if sys.stderr is not None and sys.stderr.isatty() else shown)


def wrapped(text: str) -> str:
    """Return text whose lines break between words at the width of the terminal; a broken line goes on indented."""
    from shutil import get_terminal_size
    from textwrap import fill

    width = get_terminal_size().columns
    return "\n".join(
        fill(line, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
        if len(line) > width
        else line
        for line in text.split("\n")
    )


def in_options(error: TiltcalError, command: click.Command | None = None) -> str:
    """Return the message of an error with the options of a command, else the present one, in place of arguments."""
    command = click.get_current_context().command if command is None else command
    names = {
        one.name: one.opts[0] if isinstance(one, click.Option) else one.human_readable_name for one in command.params
    }

    def option(argument: Argument) -> str:
        name = names.get(argument.name, f"--{argument.name.replace('_', '-')}")
        return f"{name} {argument.value}".rstrip()

    return error.written(option)


@contextmanager
def progress_bar(what: str) -> Iterator[Progress | None]:
    """Show a progress bar on a terminal, for a log with a known size."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    console.show_cursor = lambda show=True: False  # type: ignore[method-assign]  # Ctrl-C may leave no time to show it
    with Bar(console=console, transient=True) as bar:
        task = bar.add_task(what, total=None, visible=False)
        yield lambda done, size: bar.update(task, completed=done, total=size, visible=size is not None)


class ForeignLibrary:
    """What the command puts around a library that reads a log: the log is named, and Ctrl-C has its default meanwhile.

    A library of C that a damaged file keeps busy notices no handler of Python, and one may end the process.
    """

    def __init__(self) -> None:
        self._named = ""

    @contextmanager
    def __call__(self, log: str) -> Iterator[None]:
        from signal import SIG_DFL, SIG_IGN, SIGINT, getsignal, signal

        if log != self._named:
            self._named = log
            talk(f"reading {printable(log)}")
        if (before := getsignal(SIGINT)) is SIG_IGN:
            yield
            return
        signal(SIGINT, SIG_DFL)
        try:
            yield
        finally:
            signal(SIGINT, before)


def unforeseen(failure: BaseException, *inputs: str) -> InputError:
    """Return the error that says where an exception that is none of tiltcal's arose, of which inputs and versions.

    An exception that ends programs, such as that of Ctrl-C, is raised again, and every one where :data:`TRACEBACK` is
    set.
    """
    if isinstance(failure, KeyboardInterrupt | SystemExit | GeneratorExit) or os.environ.get(TRACEBACK):
        raise failure
    from traceback import walk_tb

    why = " ".join(f"{type(failure).__name__}: {failure}".split())[:_LONGEST]
    place = [
        f" at {module}, line {line}"
        for frame, line in walk_tb(failure.__traceback__)
        if (module := str(frame.f_globals.get("__name__"))).partition(".")[0] == "tiltcal"
    ]
    with_inputs = f", with {', '.join(inputs)}" if inputs else ""
    return InputError(
        f"this is an error of tiltcal: {why}{''.join(place[-1:])}{with_inputs}. Report it with this message, what the "
        f"same command prints with {TRACEBACK}=1 before it, and the input, damaged or not: {', '.join(versions())}"
    )


def versions() -> Iterator[str]:
    """Return the version of tiltcal, of Python and its system, and of each package that tiltcal uses and finds."""
    import platform
    import re
    from importlib.metadata import PackageNotFoundError, requires, version

    yield f"tiltcal {__version__}"
    yield f"Python {platform.python_version()} on {platform.platform()}"
    names = {re.split(r"[^\w-]", line)[0] for line in requires("tiltcal") or () if "dev" not in line}
    for name in sorted(names - {"tiltcal"}, key=str.lower):
        with suppress(PackageNotFoundError):
            yield f"{name} {version(name)}"


def end_unforeseen(failure: BaseException, args: list[str]) -> int:
    """Print an error that nothing foresees, with the files that the command line names; return the exit code."""
    given = ((before, arg.rpartition("=")[2]) for before, arg in pairwise(["", *args]))
    named = [name for before, name in given if before not in ("-o", "--output") and os.path.exists(name)]
    refusal = unforeseen(failure, *named)
    talk(f"tiltcal: {printable(str(refusal))}")
    return refusal.exit_code
