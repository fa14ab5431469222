"""The checksum of a log, which is kept while it is read."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import xarray

from tiltcal.logs.formats import open_log

ROWS = 200_001
"""Some blocks of every format."""


@pytest.mark.parametrize("end", ["csv", "parquet", "nc"])
def test_the_checksum_of_a_log_that_was_read_is_that_of_its_bytes(tmp_path: Path, end: str) -> None:
    columns = {"time": np.arange(float(ROWS)), "x": np.random.default_rng(3).normal(size=ROWS)}
    log = tmp_path / f"log.{end}"
    if end == "csv":
        pl.DataFrame(columns).write_csv(log)
    elif end == "parquet":
        pl.DataFrame(columns).write_parquet(log)
    else:
        xarray.Dataset({name: ("row", values) for name, values in columns.items()}).to_netcdf(log, engine="h5netcdf")
    with open_log(log, digest=True) as reader:
        rows = sum(len(block) for block in reader.rows([0, 1]))
        assert rows == ROWS
        assert reader.sha256 == sha256(log.read_bytes()).hexdigest()
