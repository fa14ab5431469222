"""Recordings of real sensors by others, as files; `tests/data/recordings` says where they come from."""

import atexit
import lzma
import shutil
import tempfile
from functools import cache
from pathlib import Path

from support import ROOT

PACKED = ROOT / "tests" / "data" / "recordings"


@cache
def _folder() -> Path:
    folder = tempfile.mkdtemp(prefix="recordings-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@cache
def recording(name: str) -> Path:
    """Return the path of a recording, unpacked for this run of the tests."""
    if (PACKED / name).exists():
        return PACKED / name
    path = _folder() / name
    path.write_bytes(lzma.decompress((PACKED / f"{name}.xz").read_bytes()))
    return path
