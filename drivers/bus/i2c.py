"""I2C through the Linux i2c-dev driver."""

from __future__ import annotations

import errno
from typing import Any

from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import Node, import_library
from tiltcal.errors import BusError

LOWEST, HIGHEST = 0x08, 0x77  # the 7-bit addresses that a device may have; the I2C specification reserves the others
NODE = Node(
    "i2c-dev",
    ("i2c-*",),
    "no I2C bus is present; switch I2C on in the board's settings",
    "an I2C bus, as /dev/i2c-1 is",
)


def open_i2c(address: Address) -> I2cLink:
    """Open an ``i2c:`` address for one device, whose 7-bit ``address`` is required."""
    return I2cLink(address.path, address.integer("address", low=LOWEST, high=HIGHEST))


class I2cLink:
    """One device on one I2C bus.

    Each exchange is one transaction with one stop condition at its end, so no other master can interrupt it.
    """

    letter = "i"

    def __init__(self, device: str, address: int) -> None:
        self._device = device
        self._address = address
        self._library = import_library("smbus2", "I2C needs the Python package smbus2, for Linux only", "smbus2")
        self._bus: Any = self._library.SMBus()
        try:
            self._bus.open(device)
        except OSError as cause:
            self._bus.close()
            raise BusError(NODE.why(device, cause)) from cause

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Write ``out``, then read ``count`` bytes after a repeated start; either part may be empty.

        With both empty, the exchange only tests whether the device acknowledges its address. See
        :class:`~tiltcal.drivers.bus.Link`.
        """
        message = self._library.i2c_msg
        messages = [message.write(self._address, out)] if out or not count else []
        if count:
            messages.append(message.read(self._address, count))
        try:
            self._bus.i2c_rdwr(*messages)
        except OSError as cause:
            raise BusError(self._why(cause)) from cause
        return bytes(messages[-1]) if count else b""

    def close(self) -> None:
        """Release the device node, so that a new link can open it."""
        self._bus.close()

    def _why(self, cause: OSError) -> str:
        """Return the message for a failed transaction; adapters report a missing acknowledge in three ways."""
        part = f"0x{self._address:02x}"
        tail = self._device.rpartition("-")[2]
        bus = tail if tail.isdigit() else "{place}"
        texts = (
            (
                (errno.ENXIO, errno.EREMOTEIO, errno.EIO),
                f"no device acknowledges at address {part} on {{place}} ({{reason}}): check the sensor's supply, SDA, "
                f"SCL and the address ('i2cdetect -y {bus}' lists the devices)",
            ),
            (
                (errno.ETIMEDOUT,),
                f"time-out at address {part} on {{place}}: SDA or SCL is held low, or the clock is stretched too long: "
                "check the pull-up resistors, switch the sensor's supply off and on, then resume",
            ),
            (
                (errno.EAGAIN, errno.EBUSY),
                "{place} is busy ({reason}): another master has it, or SDA or SCL is held low: check the wiring, then "
                "resume",
            ),
            (
                (errno.EOPNOTSUPP,),
                "the adapter of {place} supports SMBus only and cannot write and read in one transaction: use an "
                "adapter with plain I2C",
            ),
        )
        return NODE.why(self._device, cause, texts)
