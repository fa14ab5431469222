"""The samples of a session as the rows of a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import BinaryIO

from tiltcal.drivers.model import Model
from tiltcal.files.moments import moment_after, stamp
from tiltcal.journal.header import Setup, column_name
from tiltcal.journal.playback import Sample


class LogColumns:
    """The columns of the log of a bench: ``x``, ``y``, ``temperature`` of one sensor, ``S-7_x`` and so on of several.

    Where the bench has a ``thermometer``, its temperature stands for that of every sensor.
    """

    def __init__(self, models: Mapping[str, Model], *, thermometer: bool) -> None:
        self._models, self._thermometer = models, thermometer
        self.names = ["time"]
        for serial, model in models.items():
            beside = ["temperature"] if model.thermometer and not thermometer else []
            self.names += [column_name(serial, one, alone=len(models) == 1) for one in (*model.channels, *beside)]
        self.names += ["temperature"] if thermometer else []

    def row(self, moment: datetime, sample: Sample) -> bytes:
        """Return a sample as a row; a sensor that is not in it leaves its cells empty."""
        cells = [stamp(moment)]
        for serial, model in self._models.items():
            reading = sample.get(serial)
            cells += [""] * len(model.channels) if reading is None else [f"{value:.10g}" for value in reading.values]
            if model.thermometer and not self._thermometer:
                cells.append(_celsius(None if reading is None else reading.temperature))
        if self._thermometer:
            cells.append(_celsius(next((reading.temperature for reading in sample.values()), None)))
        return csv_row(cells)


def _celsius(temperature: float | None) -> str:
    return "" if temperature is None else f"{temperature:.3f}"


def csv_row(cells: Sequence[str]) -> bytes:
    return (",".join(cells) + "\n").encode()


def samples_into(stream: BinaryIO, setup: Setup) -> Callable[[Sample], object]:
    """Return what writes a sample of a session as a row of a log; a sensor that was given up leaves its cells empty."""
    models = {device.serial: device.wired for device in setup.sensors}
    columns = LogColumns(models, thermometer=setup.thermometer is not None)
    stream.write(csv_row(columns.names))
    return lambda sample: stream.write(columns.row(moment_after(setup.began, sample.now_ns), sample))
