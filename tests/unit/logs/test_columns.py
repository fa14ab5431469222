"""Columns of a log as arrays, in memory and beyond it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tiltcal.errors import UsageError
from tiltcal.logs import columns as columns_of_logs
from tiltcal.logs.formats import open_log


def test_columns_beyond_the_memory_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = {"time": np.arange(150_000.0), "x": np.random.default_rng(1).normal(size=150_000)}
    pl.DataFrame(columns).write_parquet(tmp_path / "log.parquet")
    for memory in (256 << 20, 1 << 20):
        monkeypatch.setattr(columns_of_logs, "_MEMORY", memory)
        with open_log(tmp_path / "log.parquet") as log:
            found = columns_of_logs.read_columns(log, {"x": 1, "time": 0})
        assert len(found) == 150_000
        for role, column in columns.items():
            np.testing.assert_array_equal(found.by_role[role], column)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_folder_without_room_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pl.DataFrame({"x": np.zeros(10)}).write_parquet(tmp_path / "log.parquet")
    monkeypatch.setattr(columns_of_logs, "_MEMORY", 1)
    monkeypatch.setattr(columns_of_logs, "TemporaryFile", lambda: open("/dev/full", "w+b", buffering=0))  # noqa: SIM115
    with (
        open_log(tmp_path / "log.parquet") as log,
        pytest.raises(UsageError, match="No space left on device; make room"),
    ):
        columns_of_logs.read_columns(log, {"x": 0})
