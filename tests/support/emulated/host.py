"""Runs a program on a machine that has an emulated device node.

    umockdev-wrapper /usr/bin/python3 host.py CONTROL ADDRESS MODULE CLASS FACTS PROGRAM ARGUMENT...

CONTROL is the number of an inherited socket, ADDRESS that of the part on I2C, null on SPI. The part is made of a class
and a JSON object of its facts.

The program inherits the standard streams; its exit code becomes the host's. One JSON line on the control socket is one
order, answered by one line once it is in force::

    {"pose": [gx, gy, gz], "temperature": 24.0 or null}
    {"fault": errno or 0}      {"broken": true or false}
    {"messages": true}         -> {"messages": [[start_ns, end_ns, "out", "in"], ...], "settings": {...}}
    {"kill": signal}           to the program under test
"""

import json
import os
import socket
import subprocess
import sys
from importlib import import_module

import gi

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))))  # tests/

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402
from i2c_node import I2cNode  # noqa: E402
from spidev_node import SpidevNode  # noqa: E402

Node = SpidevNode | I2cNode


def main(control: str, address: str, module: str, kind: str, facts: str, *program: str) -> int:
    part = getattr(import_module(module), kind)(**json.loads(facts))
    node = SpidevNode(part) if address == "null" else I2cNode(part, int(address))
    testbed = UMockdev.Testbed.new()
    testbed.add_from_string(
        f"P: /devices/platform/{node.name}\nN: {node.name}\n"
        f"E: DEVNAME=/dev/{node.name}\nE: SUBSYSTEM={node.subsystem}\n"
    )
    testbed.attach_ioctl(f"/dev/{node.name}", node)
    channel = socket.socket(fileno=int(control))
    child = subprocess.Popen(program)
    loop = GLib.MainLoop()
    codes: list[int] = []
    lines = channel.makefile("rw", encoding="utf-8")

    def order(*_: object) -> bool:
        line = lines.readline()
        if not line:
            child.kill()
            return False
        answer = obey(json.loads(line), node, child.pid)
        lines.write(json.dumps(answer) + "\n")
        lines.flush()
        return True

    def ended(_: int, status: int) -> None:
        codes.append(os.waitstatus_to_exitcode(status))
        loop.quit()

    GLib.io_add_watch(channel.fileno(), GLib.PRIORITY_DEFAULT, GLib.IO_IN | GLib.IO_HUP, order)
    GLib.child_watch_add(GLib.PRIORITY_DEFAULT, child.pid, ended)
    loop.run()
    testbed.detach_ioctl(f"/dev/{node.name}")
    return codes[0] if codes[0] >= 0 else 128 - codes[0]


def obey(order: dict, node: Node, child: int) -> dict:
    """Carry out one order from the test."""
    if "pose" in order:
        node.part.pose(order["pose"], order["temperature"])
    if "fault" in order:
        node.fault = order["fault"]
    if "broken" in order:
        node.part.broken = order["broken"]
    if "kill" in order:
        os.kill(child, order["kill"])
    if "messages" in order:
        return {"messages": node.messages, "settings": node.settings}
    return {}


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
