"""The token of the operator's page, kept beside no file of the session: an open tab goes on after ``--resume``."""

from __future__ import annotations

import os
import re
import secrets
import stat
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

_TOKEN = re.compile(r"[A-Za-z0-9_-]{12}")  # of nine bytes


class PageToken:
    """The token of a session, which its user alone can read, until :meth:`forget`; the text is ``value``.

    It is in the runtime folder of the user, or the state folder where there is none. Where no file can be kept there,
    every start has a new one.
    """

    def __init__(self, journal: Path) -> None:
        name = sha256(os.fsencode(os.path.realpath(journal))).hexdigest()[:32]
        self._path = _folder() / f"{name}.token"
        self.value = self._kept() or secrets.token_urlsafe(9)
        with suppress(OSError):
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "w", encoding="ascii") as stream:
                stream.write(self.value)

    def forget(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            self._path.unlink()

    def _kept(self) -> str:
        """Return the token of the session before; nothing where there is none, or another user can read or write it."""
        try:
            found = os.lstat(self._path)
            foreign = os.name == "posix" and (found.st_uid != os.getuid() or found.st_mode & 0o077)
            text = self._path.read_text("ascii") if stat.S_ISREG(found.st_mode) and not foreign else ""
        except (OSError, ValueError):
            return ""
        if not _TOKEN.fullmatch(text):
            self.forget()
            return ""
        return text


def _folder() -> Path:
    places = (os.environ.get("XDG_RUNTIME_DIR"), os.environ.get("XDG_STATE_HOME"), os.environ.get("LOCALAPPDATA"))
    there = [place for place in places if place and os.path.isdir(place)]
    return Path(there[0] if there else Path.home() / ".local" / "state") / "tiltcal"
