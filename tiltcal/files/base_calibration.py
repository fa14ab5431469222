"""The sensor's own calibration that a session builds on: ``--base``, one file, or a folder with one for each sensor."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, tilt_record
from tiltcal.files.document import parse_document
from tiltcal.files.procedure import Procedure
from tiltcal.files.record import Record, Text, about
from tiltcal.files.results import FileRecord
from tiltcal.files.yaml_text import read_text
from tiltcal.stated_arguments import require_path


class BaseFile(Record):
    """A calibration file that a session builds on, whole: the session's journal keeps it."""

    text: Annotated[Text, about("the whole text of the file")]
    name: Annotated[Text | None, about("its name")] = None

    @property
    def calibration(self) -> CalibrationRecord:
        """The calibration in it; an InputError names file, line and key of what is wrong."""
        return _record_of(self.text, self.name or "the base calibration")

    @property
    def origin(self) -> FileRecord | None:
        """Its name and SHA-256."""
        return None if self.name is None else FileRecord.of_text(self.name, self.text)


@lru_cache(maxsize=64)
def _record_of(text: str, name: str) -> CalibrationRecord:
    return tilt_record(parse_document(text, name))


def bases_of(procedure: Procedure, path: str | Path | None, serials: Sequence[str]) -> dict[str, BaseFile]:
    """Read the calibrations that sensors bring with them, by serial number; empty where none is named.

    ``path`` is a file, or a folder with a file ``SERIAL.yaml`` for every sensor. A UsageError where it is missing, the
    procedure takes none, or it is of another sensor; an InputError where anything in it is wrong.
    """
    if path is not None:
        require_path("--base", path)
    determines = procedure.determines
    if path is None:
        if determines.completes:
            raise UsageError(f"{procedure.name} needs --base, the calibration file of the sensor")
        return {}
    if procedure.rotation is not None or determines.axes:
        raise UsageError(f"{procedure.name} needs no --base: it makes a calibration of its own")
    path = Path(path)
    if os.path.isdir(path):
        files = {serial: path / f"{serial}.yaml" for serial in serials}
    elif len(serials) == 1:
        files = {serials[0]: path}
    else:
        raise UsageError(f"{path} is one file for {len(serials)} sensors: name the folder that has SERIAL.yaml of each")
    bases = {serial: BaseFile(read_text(file), file.name) for serial, file in files.items()}
    for serial, file in files.items():
        base = _record_of(bases[serial].text, str(file))  # an error names the file as it was given
        if base.sensor.serial != serial:
            raise UsageError(f"{file} is of {base.sensor.serial}, and the sensor to measure is {serial}")
        if base.coefficients.mounting is not None and not determines.completes:
            raise UsageError(f"{file} has a mounting, which {procedure.name} would drop: name the file from before it")
    return bases
