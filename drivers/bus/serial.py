"""Serial lines through pyserial: ports, sockets, RFC 2217 servers, loops."""

from __future__ import annotations

import errno
import re
import time
from contextlib import suppress
from typing import Any

from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import GONE, SERIAL_PORT, error_number, import_library
from tiltcal.errors import BusError

BAUDRATE = 115_200  # default, baud
TIMEOUT = 5.0
"""Seconds of silence that are an error. Opening the port resets many boards, whose boot loader then takes two."""

GATHER = 0.010  # seconds for which data are collected into one answer, so that a fast sensor needs few transactions
_PORT_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError, TypeError)
"""Errors that pyserial does not wrap. A TypeError means that another error has closed the port."""
with suppress(ImportError):  # not on Windows
    import termios

    _PORT_ERRORS += (termios.error,)

HANDLERS = ("socket", "rfc2217", "hwgrep", "loop")
"""pyserial's URL handlers that can be used. Others do more than open a line: ``spy://`` writes to any file."""

ERRORS = (
    (
        (errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT),
        "no server answers at {place} ({reason}): is the server running, and the port number right?",
    ),
    ((errno.EIO,), GONE),
    ((errno.ENOTTY, errno.EINVAL), "{place} is no serial port, or does not take these settings ({reason})"),
)


def open_serial(address: Address) -> SerialLink:
    """Open a port, or a URL of pyserial's with one of :data:`HANDLERS`; ``timeout`` is the longest silence, s."""
    settings = line_settings(address, BAUDRATE)
    timeout = address.number("timeout", TIMEOUT, low=0.05, high=3600.0)
    serial = import_library("serial", "a serial line needs the Python package pyserial", "pyserial")
    try:
        port = serial.serial_for_url(address.path, do_not_open=True, exclusive=True, **settings)
    except (ValueError, re.error) as cause:
        address.refuse(f"pyserial cannot use it ({cause})")
    except OSError as cause:  # hwgrep:// looks for its port here
        raise BusError(_why(address.path, cause)) from cause
    return SerialLink(address.path, port, timeout)


def line_settings(address: Address, baudrate: int) -> dict[str, Any]:
    """Return the settings of a serial line; a URL of pyserial's whose handler does more than open one is refused."""
    handler, url, _ = address.path.partition("://")
    if url and handler.lower() not in HANDLERS:
        address.refuse(f"{handler}:// cannot be used: name a port, or {', '.join(f'{known}://' for known in HANDLERS)}")
    return {
        "baudrate": address.integer("baudrate", baudrate, low=50, high=20_000_000),
        "bytesize": address.integer("bits", 8, low=7, high=8),
        "parity": address.choice("parity", {letter: letter for letter in "NEOMS"}, "N"),
        "stopbits": address.choice("stopbits", {"1": 1, "1.5": 1.5, "2": 2}, 1),
    }


class SerialLink:
    """One serial line: what was opened, pyserial's port, not opened yet, and the silence that is an error, s."""

    letter = "r"

    def __init__(self, place: str, port: Any, timeout: float) -> None:
        self._place = place
        self._port = port
        self._timeout = timeout
        try:
            port.timeout = GATHER
            port.write_timeout = timeout
            if place.lower().startswith("socket://"):
                # pyserial drops what a server says on being called, which may be a greeting that is waited for.
                port.reset_input_buffer = lambda: None
            port.open()
            vars(port).pop("reset_input_buffer", None)
        except _PORT_ERRORS as cause:
            port.close()
            raise BusError(_why(place, cause)) from cause

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Send ``out``, then take what has arrived; see :class:`~tiltcal.drivers.bus.Link`."""
        try:
            if bool(out) == bool(count):
                self._port.reset_input_buffer()
            if out:
                self._port.write(out)
            return self._received(count) if count else b""
        except _PORT_ERRORS as cause:
            raise BusError(_why(self._place, cause)) from cause

    def close(self) -> None:
        """Release the port; closing twice is allowed."""
        self._port.close()

    def _received(self, count: int) -> bytes:
        deadline = time.monotonic() + self._timeout
        while not (arrived := bytes(self._port.read(count))):
            if time.monotonic() > deadline:
                raise BusError(
                    f"{self._place} was silent for {self._timeout:g} s: is the device powered, is its transmit wire on "
                    "this port's receive pin, and is this its baud rate?"
                )
        return arrived


def _why(place: str, cause: Exception) -> str:
    """Return the message for an error of pyserial or the operating system: the cause and what to try."""
    gone = "disconnected" in str(cause) or (isinstance(cause, TypeError) and error_number(cause) is None)
    under = OSError(errno.ENODEV, str(cause)) if gone else cause
    return SERIAL_PORT.why(place, under, ERRORS)
