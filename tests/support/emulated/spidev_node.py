"""The kernel's side of a ``/dev/spidevB.C`` node: the ioctls of linux/spi/spidev.h.

It runs under the system's Python with umockdev's bindings.
"""

import errno
import struct
import time

from gi.repository import UMockdev

# An ioctl's number has its direction in bits 30 and 31, the size of its argument in 16 to 29, its place in the low 8.
WRITE, READ = 1, 2
MESSAGE = 0
TRANSFER = struct.Struct("=QQIIHBBBBBx")


class SpidevNode(UMockdev.IoctlBase):
    """One chip select, with a part behind it.

    ``fault`` is the errno with which every message fails, 0 for none; ``messages`` has of every message its start and
    end on the monotonic clock in ns, the bytes out and the bytes in; ``settings`` are mode, bits and speed as written.
    """

    name = "spidev0.0"
    subsystem = "spidev"
    registers = {1: "mode", 3: "bits", 4: "speed", 5: "mode"}  # noqa: RUF012

    def __init__(self, part) -> None:
        super().__init__()
        self.part = part
        self.fault = 0
        self.messages: list[tuple[int, int, str, str]] = []
        self.settings = {"mode": 0, "bits": 8, "speed": 0}

    def do_handle_ioctl(self, client: UMockdev.IoctlClient) -> bool:
        """Answer one ioctl of the program under test."""
        request = client.get_request()
        direction, size, place = request >> 30, request >> 16 & 0x3FFF, request & 0xFF
        if place == MESSAGE and direction == WRITE and size % TRANSFER.size == 0:
            self.message(client, size)
        elif place in self.registers:
            self.register(client, self.registers[place], direction, size)
        else:
            client.complete(-1, errno.ENOTTY)
        return True

    def register(self, client: UMockdev.IoctlClient, name: str, direction: int, size: int) -> None:
        """Set or tell mode, word length or clock."""
        data = client.get_arg().resolve(0, size)
        if direction == WRITE:
            self.settings[name] = int.from_bytes(bytes(data.retrieve()), "little")
        else:
            data.update(0, self.settings[name].to_bytes(size, "little"))
        client.complete(0, 0)

    def message(self, client: UMockdev.IoctlClient, size: int) -> None:
        """Carry out the transfers of a message under one chip select."""
        start = time.monotonic_ns()
        if self.fault:
            client.complete(-1, self.fault)
            return
        array = client.get_arg().resolve(0, size)
        raw = bytes(array.retrieve())
        out, places = b"", []
        for at in range(0, size, TRANSFER.size):
            tx, rx, length, *_ = TRANSFER.unpack_from(raw, at)
            sent = bytes(array.resolve(at, length).retrieve()) if tx else bytes(length)
            places.append((array.resolve(at + 8, length) if rx else None, len(out), length))
            out += sent
        end = time.monotonic_ns()
        answer = self.part.exchange(out)
        for buffer, first, length in places:
            if buffer is not None:
                buffer.update(0, answer[first : first + length])
        self.messages.append((start, end, out.hex(), answer.hex()))
        client.complete(len(out), 0)
