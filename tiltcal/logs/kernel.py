"""What makes columns of the rows of a log: a kernel takes the values of some rows by role, and gives a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tiltcal.core.compensation import NO_TEMPERATURE, SUSPECT, mark
from tiltcal.core.model import Array
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.logs.log import Table

if TYPE_CHECKING:
    from tiltcal.core.pair.compensation import PairCompensation


@dataclass(frozen=True)
class RoleValues:
    """The values of some rows of a log, by role; NaN where one is missing.

    Attributes
    ----------
    readings : ndarray, shape (n, channels)
        Raw readings, in the order of the calibration's channels.
    temperature : ndarray, shape (n,), or None
        °C; None where the log has none.
    time : ndarray, shape (n,), or None
        Seconds; None where the kernel does not ask for it.
    magnetometer, velocity : ndarray, shape (n, 3), or None
        In the unit of their columns; None where they are not asked for.
    heading : ndarray, shape (n,), or None
        Degrees; None where it is not asked for.
    """

    readings: Array
    temperature: Array | None = None
    time: Array | None = None
    magnetometer: Array | None = None
    velocity: Array | None = None
    heading: Array | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.readings)


class Kernel(Protocol):
    """Columns from the rows of one log, block after block in order; a kernel may remember the rows before."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that a call gives; ``flag`` and ``reason`` are among them."""
        ...

    def __call__(self, values: RoleValues) -> Table:
        """Return the columns of some rows, under the names and in the order of :attr:`columns`."""
        ...


class _TiltCompensation(Protocol):
    """A compensation of a tilt sensor, with the uncertainty of its angles or without."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    def __call__(self, readings: Array, temperature: Array | None) -> Any: ...

    def table(self, result: Any, /) -> Table: ...


class TiltKernel:
    """The compensation of a tilt sensor.

    Parameters
    ----------
    compensation : Compensation or CompensationWithUncertainty
    lag : float
        By how much its element is later than the thermometer, s. Rows without a time are compensated with the
        temperature of the thermometer, and have flag 3 and reason 16.
    """

    def __init__(self, compensation: _TiltCompensation, lag: float = 0.0) -> None:
        self._compensation = compensation
        self._lag = ThermalLag(lag) if lag else None
        self.columns = compensation.columns

    def __call__(self, values: RoleValues) -> Table:
        temperature = values.temperature
        if self._lag is None or temperature is None:
            return self._compensation.table(self._compensation(values.readings, temperature))
        if values.time is None:
            lost = np.isfinite(temperature)
        else:
            element = self._lag(values.time, temperature)
            lost = np.isfinite(temperature) & ~np.isfinite(element)
            temperature = np.where(lost, temperature, element)
        result = self._compensation(values.readings, temperature)
        mark(result, lost, SUSPECT, NO_TEMPERATURE)
        return self._compensation.table(result)


class PairKernel:
    """The matched sums of pairs of accelerometers."""

    def __init__(self, compensation: PairCompensation) -> None:
        self._compensation = compensation
        self.columns = compensation.columns

    def __call__(self, values: RoleValues) -> Table:
        return self._compensation.table(self._compensation(values.readings))
