"""What is written in place of `tiltcal apply` with polars expressions: with_polars.py IN OUT, for sensor.yaml."""

import sys
from pathlib import Path

import polars as pl

log, out = sys.argv[1:3]
rows = pl.scan_csv(log) if Path(log).suffix == ".csv" else pl.scan_parquet(log)
x, y, t = pl.col("x"), pl.col("y"), pl.col("temperature") - 22.0
v = (x - 2.48 - (0.0017 - 2.0e-5 * t) * t) / (1.0 + 1.5e-4 * t)
w = (y - 2.53 - (-0.0012 + 1.1e-5 * t) * t) / (1.0 - 2.5e-4 * t)
determinant = 1.96 * 2.04 + 0.03 * 0.05
rows = rows.with_columns(g_x=(2.04 * v - 0.03 * w) / determinant, g_y=(0.05 * v + 1.96 * w) / determinant)
outside = ~pl.col("temperature").is_between(4.0, 28.0)
clipped = (pl.col("g_x").abs() > 1.0) | (pl.col("g_y").abs() > 1.0)
rows = rows.with_columns(
    tilt_x=pl.col("g_x").clip(-1.0, 1.0).arcsin().degrees(),
    tilt_y=pl.col("g_y").clip(-1.0, 1.0).arcsin().degrees(),
    flag=pl.when(outside | clipped).then(3).otherwise(1).cast(pl.UInt8),
    reason=clipped.cast(pl.UInt16) + 2 * outside.cast(pl.UInt16),
)
rows.sink_csv(out) if Path(out).suffix == ".csv" else rows.sink_parquet(out)
