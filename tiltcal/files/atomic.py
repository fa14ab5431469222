"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tiltcal.errors import UsageError
from tiltcal.stated_arguments import require_path

BINARY = int(getattr(os, "O_BINARY", 0))  # the flag of :func:`os.open` that keeps Windows from changing line ends
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)  # failures of the output; others are the caller's


@contextmanager
def whole_file(path: str | Path) -> Iterator[BinaryIO]:
    """Open a binary stream whose content becomes the file when the block ends without an error.

    The stream writes to a file without a name in the same folder, so that a program that is killed leaves nothing
    behind; where the system has no such files, to a temporary one. At the end it is flushed to the disk and named;
    where the block raises, it is gone and a file that stood at ``path`` is as it was. A device or pipe has no such end:
    it is written as it comes. What was written can be read again, but for a device or pipe.

    UsageError: the file cannot be written there, or the disk is full.
    """
    check_writable(path)
    try:
        if _is_special(path):
            with open(path, "wb") as stream:
                yield stream
        else:
            # A link is followed, so that its target is replaced and the link stays.
            yield from _renamed_at_the_end(Path(os.path.realpath(path)))
    except OSError as failure:
        if failure.errno not in _NO_ROOM:
            raise
        raise _cannot_write(path, failure) from failure


def write_whole(path: str | Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all; errors are those of :func:`whole_file`."""
    with whole_file(path) as stream:
        stream.write(text.encode(errors="replace"))  # names of files may be other than UTF-8


def append_whole(descriptor: int, data: bytes, size: int) -> None:
    """Append data to a file of ``size`` bytes, whole or, where an OSError is raised, not at all."""
    try:
        write_all(descriptor, data)
    except OSError:
        with suppress(OSError):
            os.ftruncate(descriptor, size)
        raise


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of the data; the operating system may take a part at a time."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def check_writable(path: str | Path, *read: str | Path) -> None:
    """Check, before anything is measured, that a file can be written, and replaces none that the command reads."""
    require_path("the output", path)
    require_apart(path, *read)
    target = Path(os.path.realpath(path))
    folder = target.parent
    for wrong, why in (
        (os.path.isdir(target), "it is a folder; name a file in it"),
        (not os.path.exists(folder), f"there is no folder {folder}; make it first"),
        (not os.path.isdir(folder), f"{folder} is a file, not a folder"),
        (os.path.exists(path) and not os.access(path, os.W_OK), "the file is write-protected; choose another name"),
    ):
        if wrong:
            raise UsageError(f"cannot write {path}: {why}")
    if _is_special(path):
        return
    try:
        target.stat()  # a name that is too long
    except FileNotFoundError:
        pass
    except OSError as failure:
        raise _cannot_write(path, failure, "choose another name") from failure
    part = part_of(target)
    stream, named = _begun(part, path)  # permission bits alone do not show a read-only disk
    stream.close()
    if named:
        part.unlink()


def require_apart(path: str | Path, *read: str | Path) -> None:
    """Refuse to write a file in place of one that the command reads, with a UsageError."""
    for source in read:
        if os.path.realpath(source) == os.path.realpath(path) and not _is_special(path):
            raise UsageError(f"cannot write {path}: it would replace {source}, which is read; name another file")


def _renamed_at_the_end(target: Path) -> Iterator[BinaryIO]:
    part = part_of(target)
    stream, named = _begun(part, target)
    try:
        with stream:
            yield stream
            stream.flush()
            with suppress(OSError):  # the permissions of the file that is replaced; some file systems have none
                at = stream.fileno() if os.chmod in os.supports_fd else stream.name
                os.chmod(at, stat.S_IMODE(target.stat().st_mode))
            os.fsync(stream.fileno())
            if not named:
                try:
                    _give_name(stream.fileno(), target)
                except FileExistsError:  # no call replaces it by a file without a name
                    _give_name(stream.fileno(), part)
                    named = True
        if named:
            os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    with suppress(OSError):  # the rename; where a file system cannot, the content is safe nevertheless
        handle = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def sync_data(descriptor: int) -> None:
    """Wait until the data of a file are on the disk."""
    getattr(os, "fdatasync", os.fsync)(descriptor)


def part_of(target: Path) -> Path:
    """Return a name that nobody can predict, for what becomes this file when it is whole."""
    return target.with_name(f".tiltcal-{os.urandom(6).hex()}.part")


def _begun(part: Path, path: str | Path) -> tuple[BinaryIO, bool]:
    """Open a file without a name in the folder, or this one where the system has none; whether it has its name."""
    try:
        nameless = _nameless(part.parent)
        return (open(part, "x+b"), True) if nameless is None else (open(nameless, "w+b"), False)
    except OSError as failure:
        raise _cannot_write(path, failure) from failure


def _nameless(folder: Path) -> int | None:
    """Open a file without a name, which vanishes unless it gets one; None where the system has no such files."""
    if not hasattr(os, "O_TMPFILE") or not os.path.exists("/proc/self/fd"):
        return None
    try:
        return os.open(folder, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o666)
    except OSError as failure:
        if failure.errno in _NO_ROOM:
            raise
        return None


def _give_name(nameless: int, path: Path) -> None:
    # A folder's descriptor has to be given for the link behind /proc to be followed; its value is ignored.
    os.link(f"/proc/self/fd/{nameless}", path, src_dir_fd=nameless)


def _is_special(path: str | Path) -> bool:
    return os.path.exists(path) and not os.path.isfile(path)


def _cannot_write(path: str | Path, failure: OSError, do: str = "choose another folder") -> UsageError:
    return UsageError(f"cannot write {path}: {failure.strerror}; {do}")
