"""The kernel's side of a ``/dev/i2c-N`` node: the ioctls of linux/i2c-dev.h.

It runs under the system's Python with umockdev's bindings. What is behind it is any part with
``transaction(out, count, start_ns) -> bytes``, which raises :class:`NoAcknowledge` where it would not acknowledge a
byte. The ioctl numbers of i2c-dev tell no size, so each argument's is known here.
"""

from __future__ import annotations

import errno
import struct
import time
from typing import NamedTuple

from gi.repository import UMockdev

SLAVE, FUNCS, SLAVE_FORCE, RDWR, PEC, SMBUS = 0x0703, 0x0705, 0x0706, 0x0707, 0x0708, 0x0720

RDWR_ARGUMENT = struct.Struct("=QIxxxx")
"""struct i2c_rdwr_ioctl_data: the address of the messages, their number."""
MESSAGE = struct.Struct("=HHHxxQ")
"""struct i2c_msg: address, flags, length, the address of the buffer."""
SMBUS_ARGUMENT = struct.Struct("=BBxxIQ")
"""struct i2c_smbus_ioctl_data: read or write, command, size, the address of the data."""
DATA_SIZE = 34
"""union i2c_smbus_data: a length and 32 bytes, or a byte, or a word; one byte more for the checksum."""

READING = 0x0001
PLAIN_I2C, SMBUS_EMULATED = 0x00000001, 0x0EFF0008
QUICK, BYTE, BYTE_DATA, WORD_DATA, PROC_CALL, BLOCK_DATA, I2C_BLOCK_DATA = 0, 1, 2, 3, 4, 5, 8


class NoAcknowledge(Exception):
    """A byte that nobody acknowledges."""


class Step(NamedTuple):
    """One message of a transaction: bytes to write, or a number of bytes to read."""

    address: int
    out: bytes
    count: int


class I2cNode(UMockdev.IoctlBase):
    """One bus, with a part at one address.

    Attributes
    ----------
    fault : int
        errno with which every transaction fails; 0 for none.
    messages : list
        Of every transaction its start and end on the monotonic clock in ns, the bytes out and the bytes in.
    settings : dict
        The address that was spoken to last.
    """

    name = "i2c-1"
    subsystem = "i2c-dev"

    def __init__(self, part, address: int) -> None:
        super().__init__()
        self.part = part
        self.address = address
        self.fault = 0
        self.messages: list[tuple[int, int, str, str]] = []
        self.settings = {"address": 0}

    def do_handle_ioctl(self, client: UMockdev.IoctlClient) -> bool:
        """Answer one ioctl of the program under test."""
        request = client.get_request()
        if request == FUNCS:
            functions = (PLAIN_I2C | SMBUS_EMULATED).to_bytes(8, "little")
            client.get_arg().resolve(0, 8).update(0, functions)
            client.complete(0, 0)
        elif request in (SLAVE, SLAVE_FORCE):
            self.settings["address"] = argument_value(client)
            client.complete(0, 0)
        elif request == PEC:
            client.complete(0, 0)
        elif request == RDWR:
            self.combined(client)
        elif request == SMBUS:
            self.smbus(client)
        else:
            client.complete(-1, errno.ENOTTY)
        return True

    def combined(self, client: UMockdev.IoctlClient) -> None:
        """Carry out the messages of one I2C_RDWR under one stop condition."""
        argument = client.get_arg().resolve(0, RDWR_ARGUMENT.size)
        _, number = RDWR_ARGUMENT.unpack(bytes(argument.retrieve()))
        if not 1 <= number <= 42:
            client.complete(-1, errno.EINVAL)
            return
        array = argument.resolve(0, number * MESSAGE.size)
        raw = bytes(array.retrieve())
        steps, buffers = [], []
        for at in range(0, len(raw), MESSAGE.size):
            address, flags, length, _ = MESSAGE.unpack_from(raw, at)
            buffer = array.resolve(at + 8, length) if length else None
            if flags & READING:
                steps.append(Step(address, b"", length))
            else:
                steps.append(Step(address, bytes(buffer.retrieve()) if buffer else b"", 0))
            buffers.append(buffer)
        answers = self.transaction(client, steps)
        if answers is None:
            return
        for step, buffer, answer in zip(steps, buffers, answers):  # noqa: B905
            if step.count:
                buffer.update(0, answer)
        client.complete(number, 0)

    def smbus(self, client: UMockdev.IoctlClient) -> None:
        """Carry out one I2C_SMBUS as an adapter does that has plain I2C only."""
        argument = client.get_arg().resolve(0, SMBUS_ARGUMENT.size)
        reading, command, size, place = SMBUS_ARGUMENT.unpack(bytes(argument.retrieve()))
        data = argument.resolve(8, DATA_SIZE) if place else None
        given = bytes(data.retrieve()) if data is not None else b""
        length = {BYTE_DATA: 1, WORD_DATA: 2, I2C_BLOCK_DATA: given[0] if given else 0}.get(size)
        address = self.settings["address"]
        if size == QUICK or (size == BYTE and not reading):
            steps = [Step(address, bytes([command])[: size == BYTE], 0)]
        elif size == BYTE:
            steps, length = [Step(address, b"", 1)], 1
        elif length is None:
            client.complete(-1, errno.EOPNOTSUPP)
            return
        elif reading:
            steps = [Step(address, bytes([command]), 0), Step(address, b"", length)]
        else:
            first = 1 if size == I2C_BLOCK_DATA else 0
            steps = [Step(address, bytes([command]) + given[first : first + length], 0)]
        answers = self.transaction(client, steps)
        if answers is None:
            return
        if reading and data is not None:
            data.update(1 if size == I2C_BLOCK_DATA else 0, answers[-1])
        client.complete(0, 0)

    def transaction(self, client: UMockdev.IoctlClient, steps: list[Step]) -> list[bytes] | None:
        """Let the part answer; None where the program has been told of an error."""
        start = time.monotonic_ns()
        if self.fault:
            client.complete(-1, self.fault)
            return None
        self.settings["address"] = steps[0].address
        try:
            if any(step.address != self.address for step in steps):
                raise NoAcknowledge
            answers = [self.part.message(step.out, step.count, start) for step in steps]
        except NoAcknowledge:
            client.complete(-1, errno.EREMOTEIO)
            return None
        out, back = (b"".join(parts) for parts in ([step.out for step in steps], answers))
        self.messages.append((start, time.monotonic_ns(), out.hex(), back.hex()))
        return answers


def argument_value(client: UMockdev.IoctlClient) -> int:
    """An argument that is a number and not an address."""
    return int.from_bytes(bytes(client.get_arg().retrieve())[:8], "little")
