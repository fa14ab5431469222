"""Errors that nothing in tiltcal foresees, such as those of a library that an absurd number reaches."""

from __future__ import annotations

import os
from itertools import pairwise

from tiltcal.cli.talk import talk
from tiltcal.errors import InputError
from tiltcal.printable import printable

TRACEBACK = "TILTCAL_TRACEBACK"
"""Environment variable: where it is set, such an error leaves the command as Python prints it."""

_LONGEST = 300  # characters of such an error that are printed


def unforeseen(failure: BaseException, *inputs: str) -> InputError:
    """Return the error that names the inputs of which something raised an exception that is none of tiltcal's.

    An exception that ends programs, such as that of Ctrl-C, is raised again, and every one where :data:`TRACEBACK` is
    set.
    """
    if isinstance(failure, KeyboardInterrupt | SystemExit | GeneratorExit) or os.environ.get(TRACEBACK):
        raise failure
    why = " ".join(f"{type(failure).__name__}: {failure}".split())[:_LONGEST]
    where = ", ".join(inputs) or "the options, or a variable of the environment"
    return InputError(
        f"{where} cannot be processed: {why}; correct a number or date that is out of range, or a damaged file. "
        f"If none is, report it with what {TRACEBACK}=1 prints"
    )


def report(failure: BaseException, args: list[str]) -> int:
    """Report an error that ends a command, with the files that its line names; return the exit code."""
    given = ((before, arg.rpartition("=")[2]) for before, arg in pairwise(["", *args]))
    named = [name for before, name in given if before not in ("-o", "--output") and os.path.exists(name)]
    refusal = unforeseen(failure, *named)
    talk(f"tiltcal: {printable(str(refusal))}")
    return refusal.exit_code
