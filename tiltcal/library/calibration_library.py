"""A folder of calibrations as a program holds it: the calibration of a sensor at any time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any, Unpack, overload

from tiltcal.calibration.season import CalibrationFolder, SensorHistory
from tiltcal.files.calibration_folder import FolderIndex
from tiltcal.library.calibration import Calibration, Frame
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete, names_arguments, takes


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
        self.records = CalibrationFolder(folder)
        self.folder = self.records.folder

    def __repr__(self) -> str:
        return f"<CalibrationLibrary of {self.folder}>"

    @property
    def index(self) -> FolderIndex:
        """The files, without their content."""
        return self.records.index

    @property
    def serials(self) -> tuple[str, ...]:
        """The serial numbers, in order."""
        return self.records.serials

    def history(self, serial: str) -> SensorHistory:
        """Return the calibrations of a sensor.

        Raises
        ------
        UsageError
            The folder has none of this serial number.
        InputError
            A file is wrong, or two contradict each other.
        """
        return self.records.history(serial)

    @names_arguments
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
        return Calibration(self.records.at(serial, time, stability))

    @overload
    def apply(self, frame: Mapping[str, Any], **options: Unpack[ApplyOptions]) -> dict[str, Any]: ...

    @overload
    def apply(self, frame: Frame, **options: Unpack[ApplyOptions]) -> Frame: ...

    @names_arguments
    @takes(ApplyOptions)
    def apply(self, frame: Any, **options: Any) -> Any:
        """Turn the raw readings of a frame into tilt, as ``tiltcal apply --calibrations`` does with a log.

        Parameters
        ----------
        frame : polars.DataFrame, pandas.DataFrame, pyarrow.Table, xarray.Dataset or mapping of str to array_like
            Columns for the readings, the time, and the temperature in °C where there is one.
        **options

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

        return apply_frame(self.records, frame, complete(ApplyOptions, options))


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
