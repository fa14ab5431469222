"""The kernel's side of a ``/dev/i2c-N`` node: the ioctls of linux/i2c-dev.h.

It runs under the system's Python with umockdev's bindings. Of the ioctls smbus2 sends what plain I2C needs: which
functions there are, and messages under one stop condition.
"""

import errno
import struct
import time
from typing import NamedTuple

from gi.repository import UMockdev

FUNCS, RDWR = 0x0705, 0x0707

RDWR_ARGUMENT = struct.Struct("=QIxxxx")
"""struct i2c_rdwr_ioctl_data: the address of the messages, their number."""
MESSAGE = struct.Struct("=HHHxxQ")
"""struct i2c_msg: address, flags, length, the address of the buffer."""
READING = 0x0001
PLAIN_I2C = 0x00000001


class Step(NamedTuple):
    """One message of a transaction: bytes to write, or a number of bytes to read."""

    address: int
    out: bytes
    count: int


class I2cNode(UMockdev.IoctlBase):
    """One bus, with a part at one address.

    ``fault`` is the errno with which every transaction fails, 0 for none; ``messages`` has of every transaction its
    start and end on the monotonic clock in ns, the bytes out and the bytes in.
    """

    name = "i2c-1"
    subsystem = "i2c-dev"

    def __init__(self, part, address: int) -> None:
        super().__init__()
        self.part = part
        self.address = address
        self.fault = 0
        self.messages: list[tuple[int, int, str, str]] = []
        self.settings: dict[str, int] = {}

    def do_handle_ioctl(self, client: UMockdev.IoctlClient) -> bool:
        """Answer one ioctl of the program under test."""
        request = client.get_request()
        if request == FUNCS:
            client.get_arg().resolve(0, 8).update(0, PLAIN_I2C.to_bytes(8, "little"))
            client.complete(0, 0)
        elif request == RDWR:
            self.combined(client)
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
        start = time.monotonic_ns()
        if self.fault or any(step.address != self.address for step in steps):
            client.complete(-1, self.fault or errno.EREMOTEIO)
            return
        answers = [self.part.exchange(step.out, step.count) for step in steps]
        out, back = (b"".join(parts) for parts in ([step.out for step in steps], answers))
        self.messages.append((start, time.monotonic_ns(), out.hex(), back.hex()))
        for step, buffer, answer in zip(steps, buffers, answers, strict=True):
            if step.count:
                buffer.update(0, answer)
        client.complete(number, 0)
