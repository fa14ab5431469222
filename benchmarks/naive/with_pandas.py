"""What is written in place of `tiltcal apply` with pandas: with_pandas.py IN OUT, for sensor.yaml."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

log, out = sys.argv[1:3]
rows = pd.read_csv(log) if Path(log).suffix == ".csv" else pd.read_parquet(log)
t = rows["temperature"] - 22.0
v = (rows["x"] - 2.48 - (0.0017 - 2.0e-5 * t) * t) / (1.0 + 1.5e-4 * t)
w = (rows["y"] - 2.53 - (-0.0012 + 1.1e-5 * t) * t) / (1.0 - 2.5e-4 * t)
determinant = 1.96 * 2.04 + 0.03 * 0.05
rows["g_x"], rows["g_y"] = (2.04 * v - 0.03 * w) / determinant, (0.05 * v + 1.96 * w) / determinant
rows["tilt_x"] = np.degrees(np.arcsin(rows["g_x"].clip(-1.0, 1.0)))
rows["tilt_y"] = np.degrees(np.arcsin(rows["g_y"].clip(-1.0, 1.0)))
clipped = (rows["g_x"].abs() > 1.0) | (rows["g_y"].abs() > 1.0)
outside = ~rows["temperature"].between(4.0, 28.0)
rows["flag"] = np.where(clipped | outside, 3, 1).astype(np.uint8)
rows["reason"] = (clipped + 2 * outside).astype(np.uint16)
rows.to_csv(out, index=False) if Path(out).suffix == ".csv" else rows.to_parquet(out, index=False)
