"""Modbus through pymodbus: RTU on a serial line, or TCP."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import MutableMapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from tiltcal.drivers.bus import LINE
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import SERIAL_PORT, import_library
from tiltcal.drivers.bus.serial import line_settings
from tiltcal.errors import BusError

BAUDRATE = 9600  # if the address names none, baud
PORT = 502
_PORT_NUMBER = re.compile("[0-9]{1,5}")
TIMEOUT = 1.0  # timeout after which an answer counts as lost, s
TRIES = 2  # how often a request is sent: a frame is lost now and then, and a chamber is asked for hours
SILENCE = 3.0  # seconds without a byte after which no late answer is expected
BABBLE = 20  # pieces of data that are discarded before a line counts as one that is never silent
HOLDING, INPUT, WRITE_ONE, WRITE, FAILED = 3, 4, 6, 16, 0x80
"""Function codes that read a table, or write one register or several, and the bit that an exception adds to them."""


def open_modbus(address: Address, lines: MutableMapping[str, ModbusLine] | None = None) -> ModbusLink:
    """Open a serial port, or ``tcp://host:port``, for one unit (1 to 247).

    lines: the serial lines that were opened before, by their port, which the units of an RS-485 line share; a new one
        is added.
    """
    unit = address.integer("unit", 1, low=1, high=247)
    timeout = address.number("timeout", TIMEOUT, low=0.05, high=60.0)
    library = import_library("pymodbus.client", "Modbus needs the Python package pymodbus", "tiltcal[modbus]")
    if not (logger := logging.getLogger("pymodbus")).handlers:
        logger.addHandler(logging.NullHandler())  # our errors report lost frames
    if address.path.startswith("tcp://"):
        return ModbusLink(_server(address, library, timeout), unit)
    settings = line_settings(address, BAUDRATE)
    line = ModbusLine(address.path, library.ModbusSerialClient(address.path, **settings, timeout=timeout, retries=0))
    if lines is not None:
        own, line = line, lines.setdefault(address.path, line)
        if line.settings != own.settings:
            address.refuse(
                f"another unit on {address.path} has another baudrate, parity, stopbits or timeout: those of one line "
                "are the same"
            )
    return ModbusLink(line, unit)


def _server(address: Address, library: Any, timeout: float) -> ModbusLine:
    """Return the server of a ``tcp://`` address."""
    if stray := [name for name in LINE if name in address.options]:
        address.refuse(f"option {stray[0]!r} is of a serial line, not of TCP")
    host, colon, port = address.path.removeprefix("tcp://").rstrip("/").rpartition(":")
    if not colon:
        host, port = port, str(PORT)
    if not _PORT_NUMBER.fullmatch(port) or not 0 < int(port) < 65536:
        address.refuse(f"{port[:20]!r} is no port number (tcp://host:{PORT})")
    if not host:
        address.refuse(f"it names no host (tcp://host:{PORT})")
    host = host.removeprefix("[").removesuffix("]")
    client = library.ModbusTcpClient(host, port=int(port), timeout=timeout, retries=0)
    return ModbusLine(address.path, client, numbered=True)


class ModbusLine:
    """A serial line or a server, with the units on it.

    An answer on a serial line names its unit, its function and its length, but not the registers, so a late one could
    be taken for that of the next request. After a request without its answer the line therefore has to be silent for as
    long as a late answer may take.

    client: one of pymodbus, not connected yet, without retries; ``numbered`` is whether answers have the number of
        their request, as those of TCP.
    """

    def __init__(self, place: str, client: Any, *, numbered: bool = False) -> None:
        self.place = place
        self.settings = client.comm_params
        self.client = client
        self._numbered = numbered

    def open(self) -> None:
        """Open the line, unless it is open."""
        opened = False
        with suppress(UnicodeError):  # a name that cannot be one of a host
            opened = self.client.connect()
        if not opened:
            raise BusError(_why_not_opened(self.place))

    def close(self) -> None:
        """Close the line; closing twice is allowed, and the next request opens it again."""
        self.client.close()

    def await_silence(self) -> None:
        """Discard late answers until none can come, where an answer does not say to which request it belongs."""
        pieces, silent = 0, 0.0
        while not self._numbered and silent < SILENCE:
            if not self.client.recv(None):
                silent += self.settings.timeout_connect
                continue
            pieces, silent = pieces + 1, 0.0
            if pieces == BABBLE:
                raise BusError(f"{self.place} is never silent: does another master use this line?")


class ModbusLink:
    """One unit on a Modbus line or server, which is opened."""

    letter = "m"

    def __init__(self, line: ModbusLine, unit: int) -> None:
        self._line = line
        self._unit = unit
        line.open()

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Send a request without frame and checksum, and return the answer likewise.

        A request is the function code 3 or 4, the first register and the number of registers, two bytes each; an answer
        the function code, the number of bytes and the registers, or function code + 0x80 and an exception code. Codes
        6 and 16 write what follows the first register, and are answered with the code alone.
        """
        from pymodbus.exceptions import ModbusException

        client, function, first = self._line.client, out[0], int.from_bytes(out[1:3], "big")
        words = [int.from_bytes(out[at : at + 2], "big") for at in range(3, len(out), 2)]
        request = {
            HOLDING: partial(client.read_holding_registers, count=words[0]),
            INPUT: partial(client.read_input_registers, count=words[0]),
            WRITE_ONE: partial(client.write_register, value=words[0]),
            WRITE: partial(client.write_registers, values=words),
        }[function]
        cause: Exception | None = None
        self._line.open()
        for _ in range(TRIES):
            try:
                answer = request(first, device_id=self._unit)
                if answer.isError() and answer.function_code == function | FAILED:
                    return bytes([function | FAILED, answer.exception_code])
                if answer.function_code == function and function in (WRITE_ONE, WRITE):
                    return bytes([function])
                if answer.function_code == function and len(answer.registers) == words[0]:
                    data = b"".join(int(register).to_bytes(2, "big") for register in answer.registers)
                    return bytes([function, len(data)]) + data
            except (ModbusException, OSError) as error:
                cause = error
            with suppress(ModbusException, OSError):  # the port is gone
                self._line.await_silence()
        raise BusError(
            f"no answer of unit {self._unit} on {self._line.place}: check the supply, A and B, the unit's number, baud "
            "rate and parity, and that it answers within timeout="
        ) from cause

    def close(self) -> None:
        """Close the line; closing twice is allowed, and the next request of another unit opens it again."""
        self._line.close()


def _why_not_opened(place: str) -> str:
    if place.startswith("tcp://"):
        return f"no Modbus server answers at {place}: is it running, and are host and port right?"
    if not Path(place).exists():
        return SERIAL_PORT.missing(place)
    if not os.access(place, os.R_OK | os.W_OK):
        return SERIAL_PORT.no_permission(place)
    return f"{place} cannot be opened: is it a serial port, and does another program use it?"
