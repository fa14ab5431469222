"""A program under test: reads a sensor through the real drivers, one command a line, one JSON line as the answer.

    read_sensor.py MODEL ADDRESS

Commands: ``probe``, ``read COUNT``, ``reopen``.
"""

import json
import sys
import time

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import SystemClock
from tiltcal.errors import TiltcalError


def main(name: str, written: str) -> None:
    address = parse_address(written)
    model = find_model(name).at(address)
    link = open_link(address, model)
    sensor = model.driver(link, SystemClock(time.time_ns()))
    for line in sys.stdin:
        command, *arguments = line.split()
        try:
            if command == "reopen":
                link.close()
                link = open_link(address, model)
                sensor = model.driver(link, SystemClock(time.time_ns()))
                answer: dict[str, object] = {}
            elif command == "probe":
                answer = dict(sensor.probe())
            else:
                readings = [sensor.read() for _ in range(int(arguments[0]))]
                answer = {
                    "values": [reading.values for reading in readings],
                    "temperatures": [reading.temperature for reading in readings],
                }
        except TiltcalError as error:
            answer = {"error": type(error).__name__, "message": str(error)}
        print(json.dumps(answer), flush=True)
    link.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
