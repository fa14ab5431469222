"""The journal survives any truncation, and shows any change."""

import errno
import hashlib
import json
import os
import zlib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tiltcal.errors import JournalError, UsageError
from tiltcal.journal.lines import Journal, JournalWriter

EVENTS = [
    (48000, "s", "100000", "008f20"),
    (198000, "s", "110000", "008020"),
    (0, "!", "0800", "the sensor is unplugged"),
    (5_000_000_000, "a", {"to": "position", "answer": "ready"}),
    (7, "p", {"position": "x-tilt1", "mean": {"x": 1433.25}}),
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "S-1.journal.jsonl"


def captured(path: Path, *, finished: bool = True) -> bytes:
    writer = JournalWriter.create(path, {"software": "tiltcal", "serial": "Ä-1"})
    for event in EVENTS:
        writer.append(*event)
    if finished:
        writer.finish(3)
    writer.close()
    return path.read_bytes()


def whole(path: Path) -> Journal:
    """A journal that was read to its last line."""
    journal = Journal(path)
    for _ in journal:
        pass
    return journal


def test_what_was_written_is_read_and_its_check_is_a_running_crc32(path: Path) -> None:
    """Of the lines without it; computed here with the standard library from the documented format."""
    data = captured(path)
    journal = Journal(path)
    assert [(event.line, event.dt_ns, event.kind, *event.payload) for event in journal] == [
        (number, *event) for number, event in enumerate(EVENTS, start=2)
    ]
    assert (journal.header["serial"], journal.ended, journal.torn, journal.coming) == ("Ä-1", True, False, None)
    running, before, last = 0, b"", data.splitlines(keepends=True)[-1]
    for line in data.splitlines(keepends=True):
        value = json.loads(line)
        check = value.pop("check") if isinstance(value, dict) else value.pop()
        running = zlib.crc32(json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode(), running)
        assert check == f"{running:08x}"
        if line != last:
            before += line
    end = {"events": len(EVENTS), "sha256": hashlib.sha256(before).hexdigest()}
    assert value == [3, "end", end]
    assert journal.sha256 == end["sha256"]


def test_every_truncation_gives_the_whole_lines_before_it(path: Path) -> None:
    data = captured(path)
    ends = [index + 1 for index, byte in enumerate(data) if byte == ord("\n")]
    for size in range(ends[0], len(data)):
        path.write_bytes(data[:size])
        journal = whole(path)
        assert journal.written.events == sum(1 for end in ends if end <= size) - 1
        assert journal.torn == (size not in ends)
        assert not journal.ended


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_a_changed_byte_is_an_error_that_names_its_line(data, tmp_path_factory) -> None:
    path = tmp_path_factory.mktemp("journal") / "j.jsonl"
    content = captured(path)
    place = data.draw(st.integers(0, len(content) - 2))
    byte = data.draw(st.integers(0, 255).filter(lambda byte: byte != content[place]))
    path.write_bytes(content[:place] + bytes([byte]) + content[place + 1 :])
    with pytest.raises(JournalError) as failure:
        whole(path)
    assert failure.value.line == content[:place].count(b"\n") + 1


def test_a_lost_line_and_one_behind_the_end_are_errors(path: Path) -> None:
    lines = captured(path).splitlines(keepends=True)
    for content, number in ((lines[:2] + lines[3:], 3), ([*lines, lines[1]], 8)):
        path.write_bytes(b"".join(content))
        with pytest.raises(JournalError, match=rf"jsonl:{number}: "):
            whole(path)


def test_resumed_it_is_the_journal_of_a_session_that_was_never_stopped(path: Path, tmp_path: Path) -> None:
    never_stopped = captured(tmp_path / "other" / path.name if (tmp_path / "other").mkdir() is None else path)
    data = captured(path, finished=False)
    lines = data.splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:3]) + lines[3][:10])
    writer = JournalWriter.resume(whole(path))
    for event in EVENTS[2:]:
        writer.append(*event)
    writer.finish(3)
    writer.close()
    assert path.read_bytes() == never_stopped


def test_two_programs_cannot_write_one_journal(path: Path) -> None:
    writer = JournalWriter.create(path, {})
    with pytest.raises(JournalError, match="another tiltcal"):
        JournalWriter.resume(whole(path))
    writer.close()
    JournalWriter.resume(whole(path)).close()


def test_an_existing_journal_is_never_overwritten_nor_a_link_in_its_place_followed(path: Path) -> None:
    content = captured(path)
    with pytest.raises(UsageError, match="resume it with resume"):
        JournalWriter.create(path, {})
    assert path.read_bytes() == content
    path.unlink()
    path.symlink_to(path.with_name("elsewhere"))
    with pytest.raises(UsageError, match="exists"):
        captured(path)
    assert os.listdir(path.parent) == [path.name]


def test_what_another_process_wrote_since_it_was_read_is_not_cut_off(path: Path) -> None:
    content = captured(path, finished=False)
    path.write_bytes(b"".join(content.splitlines(keepends=True)[:3]))
    early = whole(path)
    path.write_bytes(content)
    with pytest.raises(JournalError, match="since it was read"):
        JournalWriter.resume(early)
    assert path.read_bytes() == content


def test_what_cannot_be_opened_made_or_continued_is_said_so(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    captured(path, finished=False)
    journal = whole(path)
    path.unlink()
    with pytest.raises(JournalError, match="cannot be continued: No such file"):
        JournalWriter.resume(journal)
    with pytest.raises(JournalError, match="cannot be read: No such file"):
        Journal(path)
    with pytest.raises(UsageError, match="the journal cannot be made: No such file"):
        captured(path / "in" / "none")
    monkeypatch.setattr(os, "write", lambda *_: os.lseek(-1, 0, 0))
    with pytest.raises(UsageError, match="the journal cannot be made: Bad file"):
        captured(path)
    assert not path.exists()


def test_what_is_no_journal_is_said_so(path: Path) -> None:
    for content in (b"", b'{"tiltcal-journal"', b"time,x\n1,2\n", b"\x00" * 100 + b"\n", b"{}\n"):
        path.write_bytes(content)
        with pytest.raises(JournalError, match=str(path)):
            whole(path)


def test_a_disk_that_is_full_leaves_the_journal_whole(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The operating system takes a part of a line, and then no more, as write(2) allows; later there is room again."""
    writer = JournalWriter.create(path, {})
    writer.append(*EVENTS[0])
    before, write = path.read_bytes(), os.write
    room = [7]

    def full(descriptor: int, data: memoryview) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = write(descriptor, bytes(data[: room[0]]))
        room[0] -= taken
        return taken

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(JournalError, match="No space left on device; make room on the disk, then resume"):
            writer.append(*EVENTS[1])
    assert path.read_bytes() == before
    writer.append(*EVENTS[2])
    writer.finish(0)
    writer.close()
    assert [event.kind for event in Journal(path)] == ["s", "!"]
