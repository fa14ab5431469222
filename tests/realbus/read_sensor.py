"""A program under test: reads an SCA100T through the real drivers, one command a line, one JSON line as the answer."""

from __future__ import annotations

import json
import sys
import time

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import SystemClock
from tiltcal.errors import TiltcalError


def main(address: str) -> None:
    model = find_model("sca100t-d02")
    link = open_link(parse_address(address), model)
    sensor = model.driver(link, SystemClock(time.time_ns()))
    for line in sys.stdin:
        command, _, count = line.strip().partition(" ")
        try:
            if command == "reopen":
                link.close()
                link = open_link(parse_address(address), model)
                sensor = model.driver(link, SystemClock(time.time_ns()))
                answer: dict[str, object] = {}
            elif command == "exchange":
                for _ in range(int(count)):
                    link.exchange(b"\x10\x00\x00")
                answer = {}
            elif command == "probe":
                answer = dict(sensor.probe())
            else:
                readings = [sensor.read() for _ in range(int(count))]
                answer = {
                    "values": [reading.values for reading in readings],
                    "temperatures": [reading.temperature for reading in readings],
                }
        except TiltcalError as error:
            answer = {"error": type(error).__name__, "message": str(error)}
        print(json.dumps(answer), flush=True)
    link.close()


if __name__ == "__main__":
    main(sys.argv[1])
