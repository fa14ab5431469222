"""A folder of calibrations: the library's ``open_calibrations``, and the calibration of a sensor at any time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from difflib import get_close_matches
from functools import cached_property
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, Unpack, overload

from tiltcal.calibration.apply_arguments import ApplyArguments, Frame
from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.interpolation import Stability, extrapolate
from tiltcal.calibration.sensor_history import (
    DAY,
    DatedCalibration,
    SensorHistory,
    stated_stability,
)
from tiltcal.errors import UsageError
from tiltcal.files.calibration import read_calibration
from tiltcal.files.calibration_folder import CalibrationFile, FolderIndex, date_of, index_folder
from tiltcal.files.moments import moment
from tiltcal.stated_arguments import require_from_zero, require_path, require_text


class CalibrationLibrary:
    """The calibrations in a folder, by serial number and date.

    Parameters
    ----------
    folder : str or Path
        Its files and those of the folders below it are indexed at once, and each is read when it is needed.

    Raises
    ------
    UsageError
        It is no folder.

    Examples
    --------
    >>> library = tiltcal.open_calibrations(".")
    >>> cal = library.at("SIM-42", "2000-01-01T12:00:00Z")
    """

    def __init__(self, folder: str | Path) -> None:
        require_path("the folder", folder)
        self.folder = Path(folder)
        self._histories: dict[str, SensorHistory] = {}

    def __repr__(self) -> str:
        return f"<CalibrationLibrary of {self.folder}>"

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

        Raises
        ------
        UsageError
            The folder has none of this serial number.
        InputError
            A file is wrong, or two contradict each other.
        """
        require_text("--serial", serial)
        if serial not in self._histories:
            if serial not in self._files:
                raise UsageError(self._unknown(serial))
            self._histories[serial] = SensorHistory.of([self._dated(file) for file in self._files[serial]])
        return self._histories[serial]

    def stability(self, serial: str, stated: float | None = None) -> Stability:
        """Return how far a sensor wanders.

        Parameters
        ----------
        serial : str
        stated : float, optional
            The standard deviation of the offset's change in one day, mg; without it half of each change counts.
        """
        require_from_zero("--stability", stated)
        history = self.history(serial)
        return Stability() if stated is None else stated_stability(history, stated)

    def at(self, serial: str, time: str | date, *, stability: float | None = None) -> Calibration:
        """Return the calibration of a sensor at a time: between two of them, or the nearest one.

        Parameters
        ----------
        serial : str
        time : str, datetime or date
            As text in ISO 8601; UTC where it names no zone.
        stability : float, optional
            The standard deviation of the offset's change in one day, mg, in place of half of each change.

        Raises
        ------
        UsageError
            The folder has no calibration of this sensor.
        InputError
            The time is not one, a file is wrong, or two contradict each other.
        """
        return calibration_at(self.history(serial), moment(time).timestamp(), self.stability(serial, stability))

    @overload
    def apply(
        self,
        frame: Mapping[str, Any],
        *,
        serial: str | None = None,
        stability: float | None = None,
        start: str | date | None = None,
        **options: Unpack[ApplyArguments],
    ) -> dict[str, Any]: ...

    @overload
    def apply(
        self,
        frame: Frame,
        *,
        serial: str | None = None,
        stability: float | None = None,
        start: str | date | None = None,
        **options: Unpack[ApplyArguments],
    ) -> Frame: ...

    def apply(
        self,
        frame: Any,
        *,
        serial: str | None = None,
        stability: float | None = None,
        start: str | date | None = None,
        **options: Any,
    ) -> Any:
        """Turn the raw readings of a frame into tilt, as ``tiltcal apply --calibrations`` does with a log.

        Parameters
        ----------
        frame : polars.DataFrame, pandas.DataFrame, pyarrow.Table, xarray.Dataset or mapping of str to array_like
            Columns for the readings, the time, and the temperature in °C where there is one.
        serial : str, optional
            Of the sensor; else that of the frame's attributes, or of its column names (``SERIAL_x``).
        stability : float, optional
            The standard deviation of the offset's change in one day, mg, in place of half of each change.
        start : str or datetime, optional
            When the time of the frame is 0, as text in ISO 8601, where its time is relative.
        **options
            Those of :meth:`Calibration.apply`.

        Returns
        -------
        frame
            The same kind, with the columns of :meth:`Calibration.apply`.

        Raises
        ------
        UsageError, InputError
            As :meth:`Calibration.apply`, and where no calibration fits the frame.
        """
        from tiltcal.logs.apply import apply_frame

        return apply_frame(self, frame, serial=serial, stability=stability, start=start, **options)

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


def open_calibrations(folder: str | Path) -> CalibrationLibrary:
    """Open a folder of calibration files.

    Raises
    ------
    UsageError
        It is no folder.

    Examples
    --------
    >>> tilted = tiltcal.open_calibrations(".").serials
    """
    library = CalibrationLibrary(folder)
    library.index  # noqa: B018  (what is no folder is refused here)
    return library


def calibration_at(history: SensorHistory, time: float, stability: Stability | None) -> Calibration:
    """Return the calibration of a sensor at a time, seconds since 1970."""
    dated = history.calibrations
    times = [calibration.date.timestamp() for calibration in dated]
    ends = len(times) > 1
    if time <= times[0]:
        interval = history.interval(0) if ends else None
        return Calibration(extrapolate(dated[0].record, (times[0] - time) / DAY, stability, interval))
    if time >= times[-1]:
        interval = history.interval(len(times) - 2) if ends else None
        return Calibration(extrapolate(dated[-1].record, (time - times[-1]) / DAY, stability, interval))
    k = max(i for i, date in enumerate(times) if date <= time)
    return Calibration(history.interval(k).at((time - times[k]) / (times[k + 1] - times[k]), stability))
