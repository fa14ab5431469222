"""No mathematics: a log is read and written with as many columns as `tiltcal apply` adds: only_copy.py IN OUT."""

import sys
from pathlib import Path

import polars as pl

log, out = sys.argv[1:3]
rows = pl.scan_csv(log) if Path(log).suffix == ".csv" else pl.scan_parquet(log)
rows = rows.with_columns(
    g_x=pl.col("x") * 1.5,
    g_y=pl.col("y") * 1.5,
    tilt_x=pl.col("x") / 1.5,
    tilt_y=pl.col("y") / 1.5,
    flag=pl.lit(1, pl.UInt8),
    reason=pl.lit(0, pl.UInt16),
)
rows.sink_csv(out) if Path(out).suffix == ".csv" else rows.sink_parquet(out)
