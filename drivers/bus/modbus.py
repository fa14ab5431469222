"""Modbus through pymodbus: RTU on a serial line, or TCP."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

from tiltcal.drivers.bus.device_node_errors import no_permission
from tiltcal.drivers.bus.serial import PARITIES
from tiltcal.errors import BusError, HardwareError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.device import Model

BAUDRATE = 9600
"""If the address names none, baud."""
PORT = 502
TIMEOUT = 1.0
"""Timeout after which a request is sent again, s."""
RETRIES = 2

HOLDING, INPUT, FAILED = 3, 4, 0x80
"""Function codes that read a table, and the bit that an exception answer adds to them."""

_PORTS: WeakValueDictionary[str, Any] = WeakValueDictionary()
"""The clients in use by serial port: a port is opened once, and the units of an RS-485 line share it."""


def open_modbus(address: Address, model: Model) -> ModbusLink:
    """Open a ``modbus:`` address.

    Parameters
    ----------
    address : Address
        The path is a serial port, or ``tcp://host:port``. Options ``unit`` (1 to 247) and ``timeout`` (seconds); of a
        serial port ``baudrate``, ``parity`` (N, E, O) and ``stopbits`` (1, 2).
    model : Model
        Its options are accepted as well.

    Raises
    ------
    UsageError
        An unknown or wrong option, or one that another unit on the line contradicts.
    HardwareError
        The pymodbus package is not installed.
    BusError
        No such port, no permission, or no server.
    """
    unit = address.integer("unit", 1, low=1, high=247)
    timeout = address.number("timeout", TIMEOUT, low=0.05, high=60.0)
    place = address.path
    library = _pymodbus()
    if place.startswith("tcp://"):
        address.allow("unit", "timeout", *model.options)
        host, _, port = place.removeprefix("tcp://").rstrip("/").rpartition(":")
        if not host:
            host, port = port, str(PORT)
        if not port.isdigit() or not 0 < int(port) < 65536:
            address.refuse(f"{port!r} is no port number (tcp://host:{PORT})")
        client = library.ModbusTcpClient(
            host.removeprefix("[").removesuffix("]"), port=int(port), timeout=timeout, retries=RETRIES
        )
    else:
        address.allow("unit", "timeout", "baudrate", "parity", "stopbits", *model.options)
        parity = address.text("parity", "N").upper()
        if parity not in PARITIES[:3]:
            address.refuse(f"option parity={parity} is not one of {', '.join(PARITIES[:3])}")
        client = library.ModbusSerialClient(
            place,
            baudrate=address.integer("baudrate", BAUDRATE, low=50, high=20_000_000),
            parity=parity,
            stopbits=address.integer("stopbits", 1, low=1, high=2),
            timeout=timeout,
            retries=RETRIES,
        )
        client = _shared(address, client)
    return ModbusLink(place, client, unit)


def _shared(address: Address, client: Any) -> Any:
    """Return the client that has the port of an address already, or else this one.

    Raises
    ------
    UsageError
        The port is open with other settings.
    """
    other = _PORTS.get(address.path)
    if other is not None and other.comm_params == client.comm_params:
        return other
    if other is not None and other.connected:
        address.refuse(
            f"another unit on {address.path} has another baudrate, parity, stopbits or timeout: those of one line are "
            "the same"
        )
    _PORTS[address.path] = client
    return client


class ModbusLink:
    """One device on a Modbus line or server.

    Parameters
    ----------
    place : str
        What was opened, for messages.
    client : pymodbus client
        Not connected yet.
    unit : int
        The device's address on the line.

    Raises
    ------
    BusError
        The line cannot be opened.
    """

    letter = "m"

    def __init__(self, place: str, client: Any, unit: int) -> None:
        self._place = place
        self._client = client
        self._unit = unit
        try:
            opened = client.connect()
        except UnicodeError as cause:  # a name that cannot be one of a host
            raise BusError(_why_not_opened(place)) from cause
        if not opened:
            raise BusError(_why_not_opened(place))

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Read registers.

        Parameters
        ----------
        out : bytes
            The request without frame and checksum: function code 3 or 4, first register and number of registers, two
            bytes each.
        count : int
            Unused.

        Returns
        -------
        bytes
            The answer likewise: function code, number of bytes, registers; or function code + 0x80 and an exception
            code.

        Raises
        ------
        BusError
            No answer with the right checksum, or the connection is gone.
        """
        function, first, number = out[0], int.from_bytes(out[1:3], "big"), int.from_bytes(out[3:5], "big")
        read = self._client.read_holding_registers if function == HOLDING else self._client.read_input_registers
        try:
            answer = read(first, count=number, device_id=self._unit)
        except (_pymodbus_errors(), OSError) as cause:
            raise BusError(
                f"no answer of unit {self._unit} on {self._place} ({cause}): check the supply, A and B, the unit's "
                "number, baud rate and parity"
            ) from cause
        if answer.isError():
            return bytes([function | FAILED, answer.exception_code])
        data = b"".join(int(register).to_bytes(2, "big") for register in answer.registers)
        return bytes([function, len(data)]) + data

    def close(self) -> None:
        """Close the connection; closing twice is allowed, and the next request of another unit opens it again."""
        self._client.close()


def _pymodbus() -> Any:
    """Import the clients of pymodbus, and silence its log, because our errors report lost frames."""
    try:
        import pymodbus.client
    except ImportError as cause:
        raise HardwareError(
            "Modbus needs the Python package pymodbus: install it with  pip install 'tiltcal[modbus]'"
        ) from cause
    logger = logging.getLogger("pymodbus")
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return pymodbus.client


def _pymodbus_errors() -> type[Exception]:
    from pymodbus.exceptions import ModbusException

    return ModbusException


def _why_not_opened(place: str) -> str:
    if place.startswith("tcp://"):
        return f"no Modbus server answers at {place}: is it running, and are host and port right?"
    if not Path(place).exists():
        present = ", ".join(sorted(str(path) for kind in ("ttyUSB*", "ttyACM*") for path in Path("/dev").glob(kind)))
        return f"{place} does not exist ({f'present: {present}' if present else 'no USB serial port is present'})"
    if not os.access(place, os.R_OK | os.W_OK):
        return no_permission(place, "tty")
    return f"{place} cannot be opened: is it a serial port, and does another program use it?"
