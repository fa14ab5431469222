"""A record of what each result in a folder was made of, so that a rerun skips those that would come out the same.

The fingerprint of a result covers the bytes of its log and of the calibration, every option, and the version. It is an
extended attribute of the result, where no reader of the file meets it and a copy that is edited loses it; on a file
system without such attributes it is a hidden file beside the result. It counts while size and time of the result are
those that it was written with.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import tiltcal
from tiltcal.logs.streams import sha256_of

_ATTRIBUTE = "user.tiltcal.applied"


def fingerprint(log: str, calibration: Path, options: Mapping[str, Any]) -> str | None:
    """Return the checksum of everything that decides a result; None for what cannot be read twice, such as a pipe.

    The calibration is a file or a folder of files, and the options are plain data.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    if not os.path.isfile(log):
        return None
    parts = sorted(path for path in calibration.rglob("*") if path.is_file()) if calibration.is_dir() else [calibration]
    content = {
        "software": tiltcal.__version__,
        "log": sha256_of(log),
        "calibration": [sha256_of(part) for part in parts],
        "options": options,
    }
    return sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def note_applied(output: str, made_of: str, summary: Mapping[str, object]) -> None:
    """Keep with a result what it was made of, and its summary; without effect where no place takes it."""
    note = json.dumps({"made_of": made_of, **_state(output), "summary": summary}).encode()
    try:
        os.setxattr(output, _ATTRIBUTE, note)
    except (AttributeError, OSError):
        with suppress(OSError):
            _beside(output).write_bytes(note)


def summary_if_current(output: str, made_of: str) -> dict[str, Any] | None:
    """Return the summary of a result that was made of the same; None where there is no such result."""
    try:
        note = json.loads(_note(output))
        current = note["made_of"] == made_of and note.items() >= _state(output).items()
        summary: dict[str, Any] | None = note["summary"] if current else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return summary


def _note(output: str) -> bytes:
    try:
        return os.getxattr(output, _ATTRIBUTE)
    except (AttributeError, OSError):
        return _beside(output).read_bytes()


def _state(output: str) -> dict[str, int]:
    found = os.stat(output)
    return {"size": found.st_size, "mtime_ns": found.st_mtime_ns}


def _beside(output: str) -> Path:
    return Path(output).with_name(f".{Path(output).name}.tiltcal")
