"""A log that only grows: its rows are whole and counted, whenever Ctrl-C comes."""

import os
from dataclasses import replace
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


class Scheduled:
    """A device whose readings take these seconds, the next of a list; one of none, or of fewer, fails afterwards."""

    def __init__(self, clock: VirtualClock, *seconds: float) -> None:
        self._clock, self._seconds, self.asked = clock, list(seconds), list[tuple[str, float]]()

    def discard(self) -> None:
        self.asked.append(("discard", self._clock.now_ns() / 1e9))

    def read(self) -> Reading:
        self.asked.append(("read", self._clock.now_ns() / 1e9))
        seconds = self._seconds.pop(0)
        self._clock.sleep(abs(seconds))
        if seconds <= 0.0:
            raise BusError("gone")
        return Reading((1.0,))


STARTED = datetime(2026, 1, 1, tzinfo=UTC)


def bench(*devices: Scheduled) -> SensorSet:
    """Sensors A, B, ... that print x."""
    named = [BenchSensor(name, "serial-columns", "serial:///dev/null?columns=x") for name in "AB"[: len(devices)]]
    return SensorSet(named, [cast(Sensor, device) for device in devices])


def test_a_dead_sensor_makes_no_reading_of_another_one_old(tmp_path: Path) -> None:
    """It is waited for in vain for five seconds; what the other one sent meanwhile is dropped."""
    clock = VirtualClock()
    sensors = bench(Scheduled(clock, *6 * [-5.0]), other := Scheduled(clock, *6 * [0.5]))
    columns = LogColumns(sensors.models, thermometer=False)
    log = Recording(tmp_path / "log.csv", columns.names)
    record(log, columns, sensors, clock, STARTED, 10.0, 6, None, lambda _: None)
    log.close()
    assert (log.rows, log.missing) == (6, 6)
    assert other.asked == [(word, 5.0 + 10.0 * row) for row in range(6) for word in ("discard", "read")]


@pytest.mark.parametrize(
    ("renewed", "interval", "limits", "seconds", "times", "discards", "secured"),
    [
        # A reading that takes 3.5 s is caught up with by one interval; what waited in the port before a row is dropped.
        (0.5, 1.0, (7, None), [0.2, 0.2, 3.5, 0.2, 0.2, 0.2, 0.2], [0.2, 1.2, 5.5, 5.7, 5.9, 6.7, 7.7], 7, 4),
        # Of a device that is no faster than the rows what it sent is kept, but at the first.
        (0.8, 1.0, (9, 2.5), [0.2, 0.2, 0.2, 0.2], [0.2, 1.2, 2.2], 1, 2),
        # A bus that is dead is left alone for a second where nothing else sets the pace.
        (0.0, 0.0, (None, 3.0), [0.0, 0.0, 0.5, 0.5, 0.0], [0.0, 1.0, 2.5, 3.0], 1, 2),
    ],
)
def test_when_rows_are_taken_and_when_they_are_secured(
    renewed: float, interval: float, limits: tuple[int | None, float | None], seconds: list[float], times: list[float],
    discards: int, secured: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Seconds since the recording began, ten after the session's clock."""
    clock, synced, told = VirtualClock(), list[int](), list[int]()
    clock.sleep(10.0)
    device = Scheduled(clock, *seconds)
    sensors = bench(device)
    sensors.models = {"A": replace(sensors.models["A"], interval=renewed)}
    columns = LogColumns(sensors.models, thermometer=False)
    log = Recording(tmp_path / "log.csv", columns.names)
    monkeypatch.setattr("tiltcal.bench.record.sync_data", synced.append)
    record(log, columns, sensors, clock, STARTED, interval, *limits, lambda one: told.append(one.rows))
    rows = [line.split(",") for line in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    taken = [(datetime.fromisoformat(time) - STARTED).total_seconds() - 10.0 for time, _ in rows]
    assert taken == pytest.approx(times)
    assert [cell for _, cell in rows] == ["1" if second else "" for second in seconds[: len(times)]]
    assert told == [*range(1, len(times) + 1)]
    assert ([word for word, _ in device.asked].count("discard"), len(synced)) == (discards, secured)
    assert (log.missing, log.why) == (seconds[: len(times)].count(0.0), "gone" if 0.0 in seconds else "")
    log.close()
