"""A folder of calibrations: the histories of its sensors, and the calibration of a sensor at any time."""

from __future__ import annotations

from datetime import date
from difflib import get_close_matches
from functools import cached_property
from itertools import groupby
from operator import attrgetter
from pathlib import Path

from tiltcal.calibration.interpolation import Stability, extrapolate
from tiltcal.calibration.sensor_history import (
    DAY,
    DatedCalibration,
    SensorHistory,
    stated_stability,
)
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.calibration_folder import CalibrationFile, FolderIndex, date_of, index_folder
from tiltcal.files.moments import moment
from tiltcal.stated_arguments import require_from_zero, require_path, require_text


class CalibrationFolder:
    """The calibrations in a folder, by serial number and date; each file is read when it is needed."""

    def __init__(self, folder: str | Path) -> None:
        require_path("the folder", folder)
        self.folder = Path(folder)
        self._histories: dict[str, SensorHistory] = {}

    @cached_property
    def index(self) -> FolderIndex:
        """The files, without their content."""
        return index_folder(self.folder)

    @cached_property
    def _files(self) -> dict[str, list[CalibrationFile]]:
        return {serial: list(files) for serial, files in groupby(self.index.files, key=attrgetter("serial"))}

    @property
    def serials(self) -> tuple[str, ...]:
        """The serial numbers, in order."""
        return tuple(self._files)

    def history(self, serial: str) -> SensorHistory:
        """Return the calibrations of a sensor.

        UsageError: the folder has none of this serial number.
        InputError: a file is wrong, or two contradict each other.
        """
        require_text("--serial", serial)
        if serial not in self._histories:
            if serial not in self._files:
                raise UsageError(self._unknown(serial))
            self._histories[serial] = SensorHistory.of([self._dated(file) for file in self._files[serial]])
        return self._histories[serial]

    def stability(self, serial: str, stated: float | None = None) -> Stability:
        """Return how far a sensor wanders: as stated, the offset in one day, mg, else half of each change."""
        require_from_zero("--stability", stated)
        history = self.history(serial)
        return Stability() if stated is None else stated_stability(history, stated)

    def at(self, serial: str, time: str | date, stability: float | None = None) -> CalibrationRecord:
        """Return the calibration of a sensor at a time: between two of them, or the nearest one."""
        return calibration_at(self.history(serial), moment(time).timestamp(), self.stability(serial, stability))

    def _dated(self, file: CalibrationFile) -> DatedCalibration:
        record = read_calibration(file.path)
        started, date = date_of(record, file.path)
        return DatedCalibration(record, date, started, file.path, Path(file.path).relative_to(self.folder).as_posix())

    def _unknown(self, serial: str) -> str:
        near = get_close_matches(serial, self._files, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        listed = ", ".join(self.serials[:12]) + (" ..." if len(self._files) > 12 else "")
        unusable = f"; left out: {self.index.problems[0]}" if self.index.problems else ""
        return f"{self.folder} has no calibration of {serial!r}{hint}; it has {listed or 'none at all'}{unusable}"


def calibration_at(history: SensorHistory, time: float, stability: Stability | None) -> CalibrationRecord:
    """Return the calibration of a sensor at a time, seconds since 1970."""
    dated = history.calibrations
    times = [calibration.date.timestamp() for calibration in dated]
    asks_for_change = len(times) > 1 and stability is not None and not stability.rate
    if time <= times[0]:
        nearest = history.interval(0) if asks_for_change else None
        return extrapolate(dated[0].record, (times[0] - time) / DAY, stability, nearest)
    if time >= times[-1]:
        nearest = history.interval(len(times) - 2) if asks_for_change else None
        return extrapolate(dated[-1].record, (time - times[-1]) / DAY, stability, nearest)
    k = max(i for i, date in enumerate(times) if date <= time)
    return history.interval(k).at((time - times[k]) / (times[k + 1] - times[k]), stability)
