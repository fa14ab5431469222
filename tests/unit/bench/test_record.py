"""A log that only grows: its rows are whole and counted, whenever Ctrl-C comes."""

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

import pytest

from tiltcal.bench.devices import SensorSet
from tiltcal.bench.record import Recording, record
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Reading, Sensor
from tiltcal.errors import BusError
from tiltcal.files import atomic
from tiltcal.files.bench import BenchSensor
from tiltcal.journal.samples import LogColumns


@pytest.mark.parametrize(("written", "rows"), [(None, 2), (2, 1), (0, 1)], ids=["after", "within", "before"])
def test_ctrl_c_at_a_row(written: int | None, rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    log = Recording(path, ["time", "x"])
    log.append(b"0,1024\n")

    def interrupted(descriptor: int, row: bytes) -> None:
        os.write(descriptor, row[:written])
        raise KeyboardInterrupt

    monkeypatch.setattr(atomic, "write_all", interrupted)
    with pytest.raises(KeyboardInterrupt):
        log.append(b"1,1025\n")
    log.close()
    assert log.rows == rows
    assert path.read_text() == "".join(["time,x\n", "0,1024\n", "1,1025\n"][: rows + 1])


class Printer:
    """A device that prints its age in seconds once a second; what is not read waits in the port."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._taken = -1

    def read(self) -> Reading:
        self._taken += 1
        if self._taken * 10**9 > self._clock.now_ns():
            self._clock.seek(self._taken * 10**9)
        return Reading((float(self._taken),))

    def discard(self) -> None:
        self._taken = self._clock.now_ns() // 10**9


class Silent:
    """A device that is dead: each reading waits for five seconds in vain."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock

    def read(self) -> Reading:
        self._clock.sleep(5.0)
        raise BusError("silent")

    def discard(self) -> None:
        raise BusError("gone")


class Unplugged(Silent):
    """A device that is not there: each reading fails at once."""

    def read(self) -> Reading:
        raise BusError("gone")


def test_a_dead_sensor_makes_no_reading_of_another_one_old(tmp_path: Path) -> None:
    """Every row holds a number that was printed within a second of the row's time."""
    clock = VirtualClock()
    address = "serial:///dev/null?columns=x"
    devices = [BenchSensor(serial, "serial-columns", address) for serial in ("A", "B")]
    sensors = SensorSet(devices, [cast(Sensor, Silent(clock)), cast(Sensor, Printer(clock))])
    columns, started = LogColumns(sensors.models, thermometer=False), datetime(2026, 1, 1, tzinfo=UTC)
    log = Recording(tmp_path / "log.csv", columns.names)
    record(log, columns, sensors, clock, started, 10.0, 6, None, lambda _: None)
    log.close()
    assert (log.rows, log.missing) == (6, 6)
    rows = [line.split(",") for line in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    ages = [(datetime.fromisoformat(time) - started).total_seconds() - float(b) for time, _, b in rows]
    assert all(0.0 <= age <= 1.0 for age in ages), ages


@pytest.mark.parametrize(
    ("device", "interval", "most"),
    [(Printer, 0.05, 11), (Unplugged, 0.0, 10)],
    ids=["slower than its rate", "unplugged"],
)
def test_a_recording_ends_with_its_time(
    device: type[Printer] | type[Unplugged], interval: float, most: int, tmp_path: Path
) -> None:
    """Twenty rows a second for ten seconds are 200 rows, or as many as there is time for; a dead bus is left alone."""
    clock = VirtualClock()
    sensors = SensorSet(
        [BenchSensor("A", "serial-columns", "serial:///dev/null?columns=x")], [cast(Sensor, device(clock))]
    )
    columns, started = LogColumns(sensors.models, thermometer=False), datetime(2026, 1, 1, tzinfo=UTC)
    log = Recording(tmp_path / "log.csv", columns.names)
    record(log, columns, sensors, clock, started, interval, 200, 10.0, lambda _: None)
    log.close()
    assert 1 <= log.rows <= most
    assert 10.0 <= clock.now_ns() / 1e9 <= 20.0
