"""Modbus through pymodbus: RTU on a serial line, or TCP."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, MutableMapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from tiltcal.drivers.bus import Device
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import SERIAL_PORT, import_library
from tiltcal.drivers.bus.serial import PARITIES, require_line
from tiltcal.errors import BusError

BAUDRATE = 9600
"""If the address names none, baud."""
PORT = 502
_PORT_NUMBER = re.compile("[0-9]{1,5}")
TIMEOUT = 1.0
"""Timeout after which a request is sent again, s."""
RETRIES = 2

SILENCE = 3.0
"""Seconds without a byte after which no late answer is expected, or two time-outs where these are longer: the answers
to a request and its repetitions, which are sent a time-out apart, arrive at the same distance."""
BABBLE = 20
"""Pieces of data that are discarded before a line counts as one that is never silent."""

HOLDING, INPUT, WRITE_ONE, WRITE, FAILED = 3, 4, 6, 16, 0x80
"""Function codes that read a table, or write one register or several, and the bit that an exception adds to them."""


def open_modbus(address: Address, model: Device, lines: MutableMapping[str, ModbusLine] | None = None) -> ModbusLink:
    """Open a serial port, or ``tcp://host:port``, for one unit (1 to 247).

    lines: the serial lines that were opened before, by their port, which the units of an RS-485 line share; a new one
        is added.
    """
    unit = address.integer("unit", 1, low=1, high=247)
    timeout = address.number("timeout", TIMEOUT, low=0.05, high=60.0)
    library = import_library("pymodbus.client", "Modbus needs the Python package pymodbus", "'tiltcal[modbus]'")
    if not (logger := logging.getLogger("pymodbus")).handlers:
        logger.addHandler(logging.NullHandler())  # our errors report lost frames
    if address.path.startswith("tcp://"):
        address.allow("unit", "timeout", *model.options)
        return ModbusLink(_server(address, library, timeout), unit)
    address.allow("unit", "timeout", "baudrate", "parity", "stopbits", *model.options)
    line = _serial_line(address, library, timeout)
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


def _serial_line(address: Address, library: Any, timeout: float) -> ModbusLine:
    """Return the serial line of an address."""
    require_line(address)
    parity = address.text("parity", "N").upper()
    if parity not in PARITIES[:3]:
        address.refuse(f"option parity={parity} is not one of {', '.join(PARITIES[:3])}")
    client = library.ModbusSerialClient(
        address.path,
        baudrate=address.integer("baudrate", BAUDRATE, low=50, high=20_000_000),
        parity=parity,
        stopbits=address.integer("stopbits", 1, low=1, high=2),
        timeout=timeout,
        retries=0,
    )
    return ModbusLine(address.path, client)


class ModbusLine:
    """A serial line or a server, with the units on it.

    An answer on a serial line names its unit, its function and its length, but not the registers. A late one could be
    taken for the answer of the next request. So after a request without an answer only the same request is repeated,
    and before the unit is asked for anything else the line has to be silent for as long as a late answer may take. An
    answer of TCP has the number of its request.

    The client is one of pymodbus, not connected yet, without retries; ``numbered`` is whether answers have the number
    of their request.
    """

    def __init__(self, place: str, client: Any, *, numbered: bool = False) -> None:
        self.place = place
        self.settings = client.comm_params
        self._client = client
        self._numbered = numbered
        self._late: set[int] = set()
        """The units whose late answers may still come."""

    def open(self) -> None:
        """Open the line, unless it is open."""
        opened = False
        with suppress(UnicodeError):  # a name that cannot be one of a host
            opened = self._client.connect()
        if not opened:
            raise BusError(_why_not_opened(self.place))

    def close(self) -> None:
        """Close the line; closing twice is allowed, and the next request opens it again."""
        self._client.close()

    def read(self, unit: int, function: int, first: int, number: int) -> Any:
        """Return the answer of a unit: pymodbus' response to this request, or an exception response."""
        read = self._client.read_holding_registers if function == HOLDING else self._client.read_input_registers
        request = partial(read, first, count=number, device_id=unit)
        return self._answer(unit, function, request, lambda answer: len(answer.registers) == number)

    def write(self, unit: int, function: int, first: int, words: list[int]) -> Any:
        """Write registers and return the answer likewise."""
        one = function == WRITE_ONE
        request = self._client.write_register if one else self._client.write_registers
        value = words[0] if one else words
        return self._answer(
            unit, function, partial(request, first, value, device_id=unit), lambda answer: answer.address == first
        )

    def _answer(self, unit: int, function: int, request: Callable[[], Any], fits: Callable[[Any], bool]) -> Any:
        from pymodbus.exceptions import ConnectionException, ModbusException

        cause: Exception | None = None
        why = f"{1 + RETRIES} requests"
        self.open()
        try:
            if unit in self._late:
                self._await_silence()
            for _ in range(1 + RETRIES):
                try:
                    answer = request()
                except ConnectionException:
                    raise
                except ModbusException as error:
                    cause = error
                else:
                    if answer.function_code & ~FAILED == function and (answer.isError() or fits(answer)):
                        return answer
                # Whatever answers the repetition may be the answer to this request.
                if not self._numbered:
                    self._late.add(unit)
        except (ModbusException, OSError) as error:
            cause, why = error, str(error)
        raise BusError(
            f"no answer of unit {unit} on {self.place} ({why}): check the supply, A and B, the unit's number, baud "
            "rate and parity, and that it answers within timeout="
        ) from cause

    def _await_silence(self) -> None:
        """Discard late answers until none can come."""
        timeout = self.settings.timeout_connect
        pieces, silent = 0, 0.0
        while silent < max(SILENCE, 2.0 * timeout):
            if self._client.recv(None):
                pieces, silent = pieces + 1, 0.0
                if pieces == BABBLE:
                    raise BusError(f"{self.place} is never silent: does another master use this line?")
            else:
                silent += timeout
        self._late.clear()


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
        function, first, number = out[0], int.from_bytes(out[1:3], "big"), int.from_bytes(out[3:5], "big")
        if function in (WRITE_ONE, WRITE):
            words = [int.from_bytes(out[at : at + 2], "big") for at in range(3, len(out), 2)]
            written = self._line.write(self._unit, function, first, words)
            return bytes([function | FAILED, written.exception_code] if written.isError() else [function])
        answer = self._line.read(self._unit, function, first, number)
        if answer.isError():
            return bytes([function | FAILED, answer.exception_code])
        data = b"".join(int(register).to_bytes(2, "big") for register in answer.registers)
        return bytes([function, len(data)]) + data

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
