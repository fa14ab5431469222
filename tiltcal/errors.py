"""Everything that tiltcal reports as an error, in one tree.

::

    TiltcalError
    ├── UsageError          exit 2   the command line asks for what cannot be done
    ├── InputError          exit 2   a file, a line of it, a key of that line is wrong
    │   └── JournalError             a session journal is damaged or does not match
    ├── EstimateError       exit 2   the positions cannot determine the coefficients
    ├── HardwareError       exit 3   the bus, the sensor or its wiring
    │   ├── BusError                 no device, no permission, no answer, unplugged
    │   ├── DeviceFault              the device answers, and says or shows that it is faulty
    │   └── SensorError              one device of a bench failed; it is named
    └── Stopped             exit 130 the operator stopped; the session is kept and can be resumed

A message says what was found, where, and what to do.
"""

from __future__ import annotations

from os import PathLike

NEGATIVE_VERDICT = 1
"""Exit code of a command that is done and whose verdict is negative."""

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C or its operator stopped."""


class TiltcalError(Exception):
    """Base of every error that tiltcal raises on purpose."""

    exit_code = 2


class UsageError(TiltcalError):
    """The command line asks for something that cannot be done."""


class InputError(TiltcalError):
    """A file's content is wrong.

    Parameters
    ----------
    message : str
        What was found and what to do.
    file : str or Path, optional
        The file as the user named it.
    line : int, optional
        Line number, counted from 1.
    key : str, optional
        Dotted path of the key, such as ``calibration.offset.x``.
    """

    def __init__(
        self, message: str, *, file: str | PathLike[str] | None = None, line: int | None = None, key: str | None = None
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.key = key
        where = ":".join(str(part) for part in (self.file, line) if part is not None)
        super().__init__(": ".join(part for part in (where, key, message) if part))


class JournalError(InputError):
    """A session journal is damaged, unfinished, or does not match what is replayed against it."""


class EstimateError(TiltcalError):
    """The positions at hand cannot determine the coefficients that were asked for."""


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

    def __init__(self, serial: str, message: str) -> None:
        self.serial = serial
        super().__init__(message)


class Stopped(TiltcalError):
    """The operator stopped the session; what was measured is kept."""

    exit_code = INTERRUPTED
