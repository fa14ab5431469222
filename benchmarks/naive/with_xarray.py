"""What is written in place of `tiltcal apply` with xarray: with_xarray.py IN.nc OUT.nc, for sensor.yaml."""

import sys

import numpy as np
import xarray as xr

log, out = sys.argv[1:3]
rows = xr.load_dataset(log, engine="h5netcdf")
t = rows["temperature"] - 22.0
v = (rows["x"] - 2.48 - (0.0017 - 2.0e-5 * t) * t) / (1.0 + 1.5e-4 * t)
w = (rows["y"] - 2.53 - (-0.0012 + 1.1e-5 * t) * t) / (1.0 - 2.5e-4 * t)
determinant = 1.96 * 2.04 + 0.03 * 0.05
rows["g_x"], rows["g_y"] = (2.04 * v - 0.03 * w) / determinant, (0.05 * v + 1.96 * w) / determinant
for axis in "xy":
    rows[f"tilt_{axis}"] = np.degrees(np.arcsin(rows[f"g_{axis}"].clip(-1.0, 1.0)))
clipped = (np.abs(rows["g_x"]) > 1.0) | (np.abs(rows["g_y"]) > 1.0)
outside = (rows["temperature"] < 4.0) | (rows["temperature"] > 28.0)
rows["flag"] = xr.where(clipped | outside, 3, 1).astype(np.uint8)
rows["reason"] = (clipped + 2 * outside).astype(np.uint16)
rows.to_netcdf(out, engine="h5netcdf")
