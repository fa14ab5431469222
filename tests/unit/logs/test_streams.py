"""A thread that reads ahead keeps the order, the errors and nothing else; a result goes to the disk piece by piece."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from itertools import count, pairwise
from pathlib import Path

import pytest

from tiltcal.logs import streams
from tiltcal.logs.streams import log_source, read_ahead, refusing, with_writeback


def test_items_come_in_order_from_another_thread_and_an_error_in_its_place() -> None:
    def items() -> Iterator[tuple[int, int]]:
        for number in range(50):
            yield number, threading.get_ident()
        raise ValueError("the disk is gone")

    ahead, found = read_ahead(items()), []
    with pytest.raises(ValueError, match="the disk is gone"):
        found.extend(ahead)
    assert [number for number, _ in found] == list(range(50))
    assert threading.get_ident() not in {thread for _, thread in found}


def test_the_thread_ends_when_the_reader_stops() -> None:
    before = threading.active_count()
    ahead = read_ahead(count(1))
    assert next(ahead) == 1
    ahead.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before


@pytest.mark.skipif(not hasattr(os, "posix_fadvise"), reason="the system takes no such advice")
def test_what_is_written_goes_to_the_disk_piece_by_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    advised: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "posix_fadvise", lambda _, start, length, advice: advised.append((start, start + length)))
    monkeypatch.setattr(streams, "_WRITEBACK", 100)
    with open(tmp_path / "result", "w+b") as sink:
        for number in with_writeback(sink, range(10)):
            sink.write(b"." * (7 * number))
            sink.flush()
    assert advised[0][0] == 0
    assert all(before[1] == after[0] for before, after in pairwise(advised))
    assert all(end - start >= 100 for start, end in advised)
    assert 315 - advised[-1][1] < 100
    monkeypatch.delattr(os, "posix_fadvise")  # as on macOS
    with open(tmp_path / "result", "rb") as sink:
        assert list(with_writeback(sink, range(3))) == [0, 1, 2]


def test_a_live_log_is_read_in_another_thread_too(tmp_path: Path) -> None:
    """Where Ctrl-C cannot be caught."""
    os.mkfifo(tmp_path / "device")
    found = []

    def read() -> None:
        with log_source(str(tmp_path / "device"), live=True) as (stream, _):
            found.append(stream.read(3))

    thread = threading.Thread(target=read)
    thread.start()
    (tmp_path / "device").write_bytes(b"1,2")
    thread.join()
    assert found == [b"1,2"]


def test_what_the_system_refuses_keeps_its_number() -> None:
    for said in ("no room: it is full (os error 28)", "H5Fclose: errno = 28, error message = '...'"):
        with pytest.raises(OSError, match="Errno 28"), refusing("this is no log", "log.nc"):
            raise RuntimeError(said)


def test_ctrl_c_that_does_not_reach_the_wait_ends_it(tmp_path: Path) -> None:
    """Another thread gets the signal while the first one waits for a pipe, and nothing wakes the wait."""
    os.mkfifo(tmp_path / "device")
    first, ended, given_up = threading.main_thread().ident, threading.Event(), []

    def interrupt() -> None:
        with open(tmp_path / "device", "wb"):
            while not (frame := sys._current_frames().get(first)) or frame.f_code.co_name != "read":
                pass
            signal.pthread_kill(threading.get_ident(), signal.SIGINT)
            given_up.append(not ended.wait(10))

    thread = threading.Thread(target=interrupt)
    thread.start()
    with log_source(str(tmp_path / "device"), live=True) as (stream, _):
        assert stream.read(1000) == b""
        ended.set()
        thread.join()
    assert given_up == [False]
