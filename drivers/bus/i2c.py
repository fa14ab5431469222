"""I2C through the Linux i2c-dev driver."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Any

from tiltcal.drivers.bus.nodes import import_library, node_error
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus import Device
    from tiltcal.drivers.bus.address import Address

LOWEST, HIGHEST = 0x08, 0x77
"""The 7-bit addresses that a device may have; the I2C specification reserves the others."""


def open_i2c(address: Address, model: Device) -> I2cLink:
    """Open an ``i2c:`` address for one device.

    address: option ``address``, the device's 7-bit address, is required.

    UsageError: an unknown option, or an I2C address that is missing or reserved.
    HardwareError: the smbus2 package is not installed.
    BusError: no such device node, or no permission.
    """
    address.allow("address", *model.options)
    return I2cLink(address.path, address.integer("address", low=LOWEST, high=HIGHEST))


class I2cLink:
    """One device on one I2C bus; the parameters and errors are those of :func:`open_i2c`.

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
            raise BusError(_why_not_opened(device, cause)) from cause

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Write ``out``, then read ``count`` bytes after a repeated start; either part may be empty.

        With both empty, the exchange only tests whether the device acknowledges its address. See
        :class:`~tiltcal.drivers.bus.link.Link`.
        """
        message = self._library.i2c_msg
        messages = []
        if out or not count:
            messages.append(message.write(self._address, out))
        if count:
            messages.append(message.read(self._address, count))
        try:
            self._bus.i2c_rdwr(*messages)
        except OSError as cause:
            raise BusError(_why_not_exchanged(self._device, self._address, cause)) from cause
        return bytes(messages[-1]) if count else b""

    def close(self) -> None:
        """Release the device node, so that a new link can open it."""
        self._bus.close()


def _why_not_opened(device: str, cause: OSError) -> str:
    """Return the message for a bus that cannot be opened."""
    known = node_error(device, cause, "an I2C bus", subsystem="i2c-dev", pattern="i2c-*", example="/dev/i2c-1")
    reason = cause.strerror or str(cause)
    return known or f"{device} cannot be opened ({reason}): check the adapter, then resume"


def _why_not_exchanged(device: str, address: int, cause: OSError) -> str:
    """Return the message for a failed transaction.

    Adapters report a missing acknowledge as ENXIO, EREMOTEIO or EIO.
    """
    number = _bus_number(device)
    if cause.errno in (errno.ENXIO, errno.EREMOTEIO, errno.EIO):
        return (
            f"no device acknowledges at address 0x{address:02x} on {device} ({os.strerror(cause.errno)}): check the "
            f"sensor's supply, SDA, SCL and the address ('i2cdetect -y {number}' lists the devices)"
        )
    if cause.errno == errno.ETIMEDOUT:
        return (
            f"time-out at address 0x{address:02x} on {device}: SDA or SCL is held low, or the clock is stretched too "
            "long: check the pull-up resistors, switch the sensor's supply off and on, then resume"
        )
    if cause.errno in (errno.EAGAIN, errno.EBUSY):
        return (
            f"{device} is busy ({os.strerror(cause.errno)}): another master has it, or SDA or SCL is held low: check "
            "the wiring, then resume"
        )
    if cause.errno in (errno.ENODEV, errno.ESHUTDOWN):
        return f"{device} is gone: plug the I2C adapter in again, then resume"
    if cause.errno == errno.EOPNOTSUPP:
        return (
            f"the adapter of {device} supports SMBus only and cannot write and read in one transaction: use an adapter "
            "with plain I2C"
        )
    reason = cause.strerror or str(cause)
    return f"transaction with 0x{address:02x} on {device} failed ({reason}): check the wiring and the adapter"


def _bus_number(device: str) -> str:
    """Return the bus number for the i2c-tools, or the device node if its name has no number."""
    tail = device.rpartition("-")[2]
    return tail if tail.isdigit() else device
