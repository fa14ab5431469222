"""A simulated Modbus device: pymodbus' own server, on TCP or on a pseudo-terminal."""

from __future__ import annotations

import asyncio
import os
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import SimData, SimDevice


@contextmanager
def slave(unit: int, blocks: list[SimData], *, rtu: bool) -> Iterator[str]:
    """Run a device while the block lasts.

    Parameters
    ----------
    unit : int
        Its number on the line.
    blocks : list of SimData
        Its registers.
    rtu : bool
        On a serial line, else on TCP.

    Yields
    ------
    str
        The place of a ``modbus:`` address.
    """
    device = SimDevice(unit, simdata=blocks)
    loop = asyncio.new_event_loop()
    wires = Wires() if rtu else None
    ready = threading.Event()
    place = []

    async def serve() -> None:
        if wires is not None:
            server = ModbusSerialServer(device, port=wires.ends[0], baudrate=9600)
            place.append(wires.ends[1])
        else:
            server = ModbusTcpServer(device, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        if wires is None:
            port = server.transport.sockets[0].getsockname()[1]
            place.append(f"tcp://127.0.0.1:{port}")
        ready.set()
        await stopping.wait()
        await server.shutdown()

    stopping = asyncio.Event()
    thread = threading.Thread(target=loop.run_until_complete, args=(serve(),))
    thread.start()
    try:
        assert ready.wait(10.0), "the server does not start"
        yield place[0]
    finally:
        loop.call_soon_threadsafe(stopping.set)
        thread.join(10.0)
        loop.close()
        if wires is not None:
            wires.close()


class Wires:
    """Two pseudo-terminals joined by a thread; what passes from the first to the second may be damaged.

    Attributes
    ----------
    ends : tuple of str
        The two terminals.
    damage : int
        How many more answers have a bit flipped.
    """

    damage = 0

    def __init__(self) -> None:
        pairs = [os.openpty() for _ in range(2)]
        for _, end in pairs:
            tty.setraw(end)
        self._masters = tuple(master for master, _ in pairs)
        self._slaves = tuple(end for _, end in pairs)
        self.ends = tuple(os.ttyname(end) for end in self._slaves)
        self._threads = [threading.Thread(target=self._pass, args=way) for way in ((0, 1), (1, 0))]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Cut the wires."""
        for end in self._slaves:
            os.close(end)
        for thread in self._threads:
            thread.join(10.0)
        for master in self._masters:
            os.close(master)

    def _pass(self, source: int, goal: int) -> None:
        while True:
            try:
                data = os.read(self._masters[source], 4096)
                os.write(self._masters[goal], data)
            except OSError:
                return
