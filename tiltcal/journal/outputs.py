"""Where the files of a session go, and what they may replace."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote

from tiltcal.errors import Argument, UsageError
from tiltcal.files.atomic import check_writable
from tiltcal.files.calibration_output import require_replaceable, write_calibration
from tiltcal.files.results import Sensors
from tiltcal.journal.header import Setup
from tiltcal.journal.session import RecordedSession


class SessionFiles:
    """The files of a session: its journal, and where its calibrations go.

    ``output`` takes the place of what the setup says: a file, or of several sensors the folder.

    UsageError: the session has several sensors, and the output is no folder.
    """

    def __init__(self, setup: Setup, journal: Path, output: Path | None = None) -> None:
        self.journal = journal
        self._identities = [(device.model, device.serial) for device in setup.sensors]
        self._together = setup.steps.one_file
        self._named = output
        planned = {
            device.serial: Path(os.path.normpath(journal.parent / device.output))
            for device in setup.sensors
            if device.output
        }
        in_folder = output is not None and os.path.isdir(output)
        if output is not None and len(planned) > 1 and not in_folder:
            raise UsageError(f"the session has {len(planned)} sensors: name a folder instead of {output}")
        self.outputs = {
            serial: path if output is None else output / path.name if in_folder else output
            for serial, path in planned.items()
        }
        folder = os.path.realpath(journal.parent)
        self._outside = [
            path for path in self.outputs.values() if os.path.commonpath((folder, os.path.realpath(path))) != folder
        ]

    def go_on(self, command: str) -> str:
        """Return how to go on after an interruption; ``command`` is the one that resumes, before ``--resume``."""
        named, paths = self._named, list(self.outputs.values())
        if named is None and self._outside:
            named = paths[0] if len(paths) == 1 else paths[0].parent
        where = "" if named is None else f" -o {quote(str(named))}"
        return (
            f"everything measured is kept; continue with: tiltcal {command} --resume {quote(str(self.journal))}{where}"
        )

    def require_writable(self, recorded: RecordedSession | None) -> None:
        """Check before the operator starts that the files can be written; a journal that has its end is not.

        UsageError: a path that cannot be written, where a file is that is no calibration of the same sensor, or that a
            recorded session, which may be somebody else's, names outside the folder of its journal.
        """
        if recorded is not None and self._named is None and self._outside:
            raise UsageError(
                f"the journal names {self._outside[0]}, outside its own folder",
                advice=("say with ", Argument("output"), " where the calibration goes"),
            )
        for serial, path in self.outputs.items():
            require_replaceable(path, self.sensors_of(serial), self.journal)
        if recorded is None or not recorded.journal.ended:
            check_writable(self.journal)

    def sensors_of(self, serial: str) -> Sensors:
        """Return what the calibration in the output of a serial number is of."""
        if self._together:
            return ("pair", *self._identities)
        return ("tilt", next(one for one in self._identities if one[1] == serial))

    def write(self, texts: Mapping[str, str], remark: Callable[[str], None] | None = None) -> list[Path]:
        """Write the calibration files, by serial number, and return their paths."""
        for serial, text in texts.items():
            write_calibration(self.outputs[serial], text, self.sensors_of(serial), remark)
        return [self.outputs[serial] for serial in texts]
