"""A small frame for the calibration mavs of the fixtures, and the columns of a frame of any kind as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray

READINGS: dict[str, list[float]] = {"x": [1024.0, 1100.0], "y": [1024.0, 1000.0]}


def array(frame: Any, name: str) -> np.ndarray[Any, Any]:
    """Return a column of a frame of any kind."""
    column = frame[name]
    return np.asarray(column.values if isinstance(column, xarray.DataArray) else column)
