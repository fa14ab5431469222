"""Everything that tiltcal reports as an error, in one tree.

::

    TiltcalError
    ├── UsageError          exit 2   the command line asks for what cannot be done
    ├── InputError          exit 2   a file, a line of it, a key of that line is wrong
    │   └── JournalError             a session journal is damaged or does not match
    ├── EstimateError       exit 2   the positions cannot determine the coefficients
    │   └── WrongPositions           positions contradict the others, and are named
    ├── HardwareError       exit 3   the bus, the sensor or its wiring
    │   ├── BusError                 no device, no permission, no answer, unplugged
    │   ├── DeviceFault              the device answers, and says or shows that it is faulty
    │   └── SensorError              one device of a bench failed; it is named
    └── Stopped             exit 130 the operator stopped; the session is kept and can be resumed

A message says what was found, where, and what to do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from os import PathLike

NEGATIVE_VERDICT = 1
"""Exit code of a command that is done and whose verdict is negative."""

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C or its operator stopped."""


@dataclass(frozen=True)
class Argument:
    """An argument in a message: a program reads its name, the command line writes its option.

    Parameters
    ----------
    name : str
        Of the argument of a function, such as ``table_lean``.
    value : str
        What is written behind it, if anything.
    """

    name: str
    value: str = ""

    def __str__(self) -> str:
        return f"{self.name} {self.value}".rstrip()


Parts = tuple[str | Argument, ...]
Words = str | Argument | Parts
"""A text, or its parts where it names arguments."""


def parts_of(words: Words) -> Parts:
    """Return the parts of a text."""
    return words if isinstance(words, tuple) else (words,)


def listed(names: Iterable[str]) -> Parts:
    """Return the parts of a list of arguments: the first, the second and the third."""
    arguments = [Argument(name) for name in names]
    joints = [", "] * (len(arguments) - 2) + [" and "] * (len(arguments) > 1)
    return tuple(part for pair in zip(arguments, [*joints, ""], strict=True) for part in pair)


class TiltcalError(Exception):
    """Base of every error that tiltcal raises on purpose.

    Parameters
    ----------
    why : str, Argument or tuple of them
        What was found; of an ``option`` what follows its name.
    option : str, optional
        Name of the argument that is refused.
    advice : str, Argument or tuple of them, optional
        What to do.
    """

    exit_code = 2

    def __init__(self, why: Words = "", *, option: str | None = None, advice: Words = "") -> None:
        self.option, self.why, self.advice = option, why, advice
        super().__init__(self.written())

    @property
    def words(self) -> Parts:
        """The parts of the message, for an error that quotes it."""
        subject: Parts = () if self.option is None else (Argument(self.option), " ")
        return (*subject, *parts_of(self.why), *((": ", *parts_of(self.advice)) if self.advice else ()))

    def written(self, argument: Callable[[Argument], str] = str) -> str:
        """Return the message with its arguments as ``argument`` writes them."""
        return "".join(part if isinstance(part, str) else argument(part) for part in self.words)


class UsageError(TiltcalError):
    """The command line asks for something that cannot be done."""


class InputError(TiltcalError):
    """A file's content is wrong.

    Parameters
    ----------
    message : str, Argument or tuple of them
        What was found and what to do.
    file : str or Path, optional
        The file as the user named it.
    line : int, optional
        Line number, counted from 1.
    key : str, optional
        Dotted path of the key, such as ``calibration.offset.x``.
    """

    def __init__(
        self,
        message: Words,
        *,
        file: str | PathLike[str] | None = None,
        line: int | None = None,
        key: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.key = key
        where = ":".join(str(part) for part in (self.file, line) if part is not None)
        super().__init__((*(f"{part}: " for part in (where, key) if part), *parts_of(message)))


class JournalError(InputError):
    """A session journal is damaged, unfinished, or does not match what is replayed against it."""


class EstimateError(TiltcalError):
    """The positions at hand cannot determine the coefficients that were asked for."""


class WrongPositions(EstimateError):
    """Positions contradict the others by more than any error of what was set; taken again, they may agree.

    Parameters
    ----------
    positions : sequence of str
        Those among which the wrong one is.
    """

    def __init__(self, positions: Sequence[str], message: str) -> None:
        self.positions = tuple(positions)
        super().__init__(message)


class HardwareError(TiltcalError):
    """The bus, the sensor or its wiring failed."""

    exit_code = 3


class BusError(HardwareError):
    """No such device, no permission, no answer, or unplugged in the middle."""


class DeviceFault(HardwareError):
    """The device answers, and says or shows that it is faulty."""


class SensorError(HardwareError):
    """One device of a bench failed.

    Parameters
    ----------
    serial : str
        Which one.
    """

    def __init__(self, serial: str, message: Words) -> None:
        self.serial = serial
        super().__init__(message)


class Stopped(TiltcalError):
    """The operator stopped the session; what was measured is kept."""

    exit_code = INTERRUPTED
