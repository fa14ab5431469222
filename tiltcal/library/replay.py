"""Recorded sessions repeated without hardware, and compared with golden calibration files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path

from tiltcal.errors import UsageError
from tiltcal.files.calibration_folder import SUFFIXES
from tiltcal.files.document import read_document
from tiltcal.journal.calibrations import calibrations_of, texts_of
from tiltcal.journal.lines import Journal
from tiltcal.journal.outputs import SessionFiles
from tiltcal.journal.session import RecordedSession

JOURNALS = ".journal.jsonl"


@dataclass(frozen=True)
class Replay:
    """What a journal gives without hardware.

    Attributes
    ----------
    journal : Path
        The journal.
    texts : mapping of str to str
        The text of each calibration file by its name; none of a verification.
    """

    journal: Path
    texts: Mapping[str, str]

    def differences(self, golden: str | Path) -> list[str]:
        """Return what differs from golden files: none where all are equal to the byte.

        Parameters
        ----------
        golden : str or Path
            The file, or the folder that has a file of each name.

        Returns
        -------
        list of str
            Of each file that differs the line numbers, with the golden line behind ``-`` and the new one behind ``+``.

        Raises
        ------
        UsageError
            The session was of several sensors, and ``golden`` is one file.
        """
        folder = os.path.isdir(golden)
        if len(self.texts) > 1 and not folder:
            raise UsageError(f"the session was of {len(self.texts)} sensors: name a folder instead of {golden}")
        return [
            f"{self.journal} does not give {path}: {why}"
            for name, text in self.texts.items()
            if (why := _difference(path := Path(golden, name) if folder else Path(golden), text))
        ]


def replay(journal: str | Path) -> Replay:
    """Repeat a recorded session without hardware.

    Parameters
    ----------
    journal : str or Path
        The journal of a session that came to its end.

    Returns
    -------
    Replay
        The calibration files as the session wrote them, unless the driver or tiltcal has changed.

    Raises
    ------
    JournalError
        The journal is damaged or unfinished, or the driver sends other bytes; the message names the line.
    EstimateError
        The positions contradict one another.

    Examples
    --------
    >>> tiltcal.replay("S-0042.journal.jsonl").differences("S-0042.yaml")
    """
    recorded = RecordedSession(Journal(journal))
    files, texts = SessionFiles(recorded.setup, Path(journal)), texts_of(calibrations_of(recorded))
    return Replay(Path(journal), {files.outputs[serial].name: text for serial, text in texts.items()})


def journals_in(paths: Iterable[Path]) -> list[Path]:
    """Return journals, of a folder all in it and below; a UsageError where there is none."""
    found = [one for path in paths for one in (sorted(path.rglob(f"*{JOURNALS}")) if path.is_dir() else [path])]
    if not found:
        raise UsageError(f"there is no journal (*{JOURNALS}) in {', '.join(map(str, paths))}")
    return found


def surplus(golden: Path, replays: Iterable[Replay]) -> Iterator[str]:
    """Yield the calibration files of a folder that no journal gives, as differences."""
    given = {name for one in replays for name in one.texts}
    for path in sorted(golden.iterdir()):
        if path.suffix in SUFFIXES and path.name not in given and read_document(path).kind in ("tilt", "pair"):
            yield f"no journal gives {path}"


def _difference(path: Path, text: str) -> str:
    if not os.path.isfile(path):
        return "there is no such file"
    kept = path.read_bytes().decode(errors="replace")
    lines = list(unified_diff(kept.split("\n"), text.split("\n"), n=0, lineterm=""))
    return "\n".join(["lines differ", *lines[2:]] if lines else [])
