"""What the buses of an operating system share: their Python packages, and the errors of their device nodes."""

from __future__ import annotations

import errno
import os
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from tiltcal.errors import HardwareError
from tiltcal.extras import how_to_add


def import_library(module: str, needed: str, install: str) -> Any:
    """Import a module that one bus needs; without it a HardwareError says what needs it, and how it is added."""
    try:
        return import_module(module)
    except ImportError as cause:
        raise HardwareError(f"{needed}: install it with  {how_to_add(install)}") from cause


GONE = "{place} is gone: plug it in again, then resume"

Texts = tuple[tuple[tuple[int, ...], str], ...]
"""What to say of errors of the operating system by their numbers, with the place, the reason and the cause."""


class Node(NamedTuple):
    """The device nodes of a bus.

    subsystem, patterns: in udev; their names in ``/dev``.
    absent, example: what to say if there is none; what a node of the bus is.
    """

    subsystem: str
    patterns: tuple[str, ...]
    absent: str
    example: str

    def missing(self, place: str) -> str:
        """Return the message for a node that does not exist, with those of its kind that do."""
        present = ", ".join(sorted(str(path) for pattern in self.patterns for path in Path("/dev").glob(pattern)))
        if present and self.subsystem == "tty":
            present += "; plugged in again while its port was open, a board has another name: plug it in once more"
        return f"{place} does not exist ({f'present: {present}' if present else self.absent})"

    def no_permission(self, place: str) -> str:
        """Return the message for a node that this user may not open; nobody is told to join the group root."""
        try:
            import grp
        except ImportError:  # Windows, which says the same of a port that another program has opened
            return f"{place} cannot be opened: another program has it, or this user may not use it; stop that program"

        try:
            group = grp.getgrgid(os.stat(place).st_gid).gr_name
        except (KeyError, OSError):
            return f"no permission to use {place}: ask the owner of this machine for it"
        if group == "root":
            # The usual group has the name of the subsystem without a trailing dev.
            usual = self.subsystem.removesuffix("dev").removesuffix("-")
            return (
                f"no permission to use {place}, which belongs to root alone: give it to a group with the udev rule  "
                f'SUBSYSTEM=="{self.subsystem}", GROUP="{usual}", MODE="0660"  and join that group'
            )
        return (
            f"no permission to use {place}, which belongs to group {group}: add yourself to group {group} with  "
            f"sudo usermod -aG {group} $USER  and log in again"
        )

    def why(self, place: str, cause: Exception, texts: Texts = ()) -> str:
        """Return the message for an error: what a bus says of its number, else what all of them do."""
        number = error_number(cause)
        if number == errno.ENOENT:
            return self.missing(place)
        if number in (errno.EACCES, errno.EPERM):
            return self.no_permission(place)
        common = (
            ((errno.EBUSY, errno.EAGAIN), "{place} is in use by another program: stop that one first"),
            ((errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN, errno.EBADF), GONE),
            ((errno.ENOTTY, errno.EINVAL), f"{{place}} refuses a request ({{reason}}): is it {self.example}?"),
        )
        otherwise = "{place} failed ({reason}): check the wiring and the adapter, then resume"
        text = next((text for numbers, text in (*texts, *common) if number in numbers), otherwise)
        reason = str(cause) if number is None else os.strerror(number)
        return text.format(place=place, reason=reason, cause=cause)


SERIAL_PORT = Node(
    "tty", ("ttyUSB*", "ttyACM*"), "no USB serial port is present; is the cable plugged in?", "a serial port"
)


def error_number(cause: BaseException | None) -> int | None:
    """Return the number of the operating system's error behind an error of a library."""
    under = cause
    while under is not None:
        if under.args and isinstance(under.args[0], int):
            return under.args[0]
        under = under.__cause__ or under.__context__
    return None
