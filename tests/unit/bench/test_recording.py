"""A log that only grows: its rows are whole and counted, whenever Ctrl-C comes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tiltcal.bench import recording
from tiltcal.bench.recording import CsvRecorder


@pytest.mark.parametrize(("written", "rows"), [(None, 2), (2, 1), (0, 1)], ids=["after", "within", "before"])
def test_ctrl_c_at_a_row(written: int | None, rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    log = CsvRecorder(path, ["time", "x"])
    log.write(["0", "1024"])

    def interrupted(descriptor: int, row: bytes) -> None:
        os.write(descriptor, row[:written])
        raise KeyboardInterrupt

    monkeypatch.setattr(recording, "write_all", interrupted)
    with pytest.raises(KeyboardInterrupt):
        log.write(["1", "1025"])
    log.close()
    assert log.rows == rows
    assert path.read_text() == "".join(["time,x\n", "0,1024\n", "1,1025\n"][: rows + 1])
