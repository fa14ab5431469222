"""The interface of a kernel: it takes the values of some rows of a log by role, and gives a table of columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.flags import MISSING, NO_DIRECTION, NO_TEMPERATURE, SUSPECT, Mask, mark
from tiltcal.core.model import Array
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.core.uncertainty_columns import uncertainty_columns, with_shares
from tiltcal.logs.apply_summary import ColumnWidths
from tiltcal.logs.log import Table
from tiltcal.printable import counted

if TYPE_CHECKING:
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
    from tiltcal.core.compensation import KernelChunk
    from tiltcal.core.earth_compensation import EarthFrameCompensation
    from tiltcal.core.pair.compensation import PairCompensation
    from tiltcal.core.uncertainty_propagation import Propagation

_USUAL = 0.005  # g, by which the median length of gravity of a log may differ from 1 g without a remark


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
    count : ndarray of int, shape (n,), of several sensors (n, sensors), or None
        Of how many rows of the log each row is the mean; None where it is none.
    """

    readings: Array
    temperature: Array | None = None
    time: Array | None = None
    magnetometer: Array | None = None
    velocity: Array | None = None
    heading: Array | None = None
    count: NDArray[np.int64] | None = None

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


class RowRemarks:
    """The remarks on all rows of a log: on the length of gravity, and on a sign that nothing shows."""

    def __init__(self) -> None:
        self._squares = ColumnWidths(11, (-8, 24))
        self._unknown = 0

    def add(self, chunk: KernelChunk, *, on_edge: bool) -> None:
        """Count some rows, before a heading marks them."""
        if len(chunk.own) == 3:
            self._squares.add(np.einsum("an,an->n", chunk.own, chunk.own))
        if on_edge:
            self._unknown += int(np.count_nonzero(chunk.out.reason & NO_DIRECTION))

    def __iter__(self) -> Iterator[str]:
        """Yield the remarks."""
        length = (self._squares.median or 1.0) ** 0.5
        if abs(length - 1.0) > _USUAL:
            yield f"|g| is {round(length, 3):g}: supply, unit, place or zero differ from the calibration's"
        if self._unknown:
            rows = counted(self._unknown, "row")
            yield f"in {rows} the sensor is more than 45° from level, mounted on edge: nothing shows the sign of its z"


class LagCorrection:
    """The temperature of the sensing element in place of the thermometer's; it remembers the rows before.

    Parameters
    ----------
    lag : float
        Of the element behind the thermometer, seconds.
    """

    def __init__(self, lag: float) -> None:
        self._lag = ThermalLag(lag) if lag else None

    def __call__(self, values: RoleValues) -> tuple[RoleValues, Mask | None]:
        """Return the rows with the element's temperature, and which have the thermometer's; None where none is late."""
        temperature = values.temperature
        if self._lag is None or temperature is None:
            return values, None
        if values.time is None:
            return values, np.isfinite(temperature)
        element = self._lag(values.time, temperature)
        lost = np.isfinite(temperature) & ~np.isfinite(element)
        return replace(values, temperature=np.where(lost, temperature, element)), lost


class TiltKernel:
    """The compensation of a tilt sensor, and what is added to it, in this order.

    Parameters
    ----------
    uncertain : CompensationWithUncertainty, optional
        Adds the uncertainty of every angle.
    earth : EarthFrameCompensation, optional
        Adds heading and earth velocities.
    averaged : bool
        Rows are means of :attr:`RoleValues.count` rows: uncertainties have a random and a common share.
    lag : float
        By how much its element is later than the thermometer, s. Rows without a time are compensated with the
        temperature of the thermometer, and have flag 3 and reason 16.
    remarks : RowRemarks, optional
        Counts the rows.
    """

    def __init__(
        self,
        compensation: Compensation,
        uncertain: CompensationWithUncertainty | None = None,
        earth: EarthFrameCompensation | None = None,
        lag: float = 0.0,
        averaged: bool = False,
        remarks: RowRemarks | None = None,
    ) -> None:
        self._compensation, self._uncertain, self._earth = compensation, uncertain, earth
        self._correct_lag = LagCorrection(lag)
        self._averaged = averaged
        self._remarks = remarks or RowRemarks()
        names = [*compensation.columns]
        if uncertain is not None:
            names += uncertainty_columns(compensation.angles, averaged=averaged)
        self._own = len(names)
        self.columns = (*names, *(() if earth is None else earth.columns))

    def __call__(self, values: RoleValues) -> Table:
        values, lost = self._correct_lag(values)
        out = Compensated.empty(len(values), len(self._compensation.axes))
        table = self._compensation.table(out)
        own = self._own - len(table)
        added = np.empty((len(self.columns) - len(table), len(values)))
        with np.errstate(all="ignore"):
            for chunk in self._compensation.chunks(values.readings, values.temperature, out):
                rows = chunk.rows
                self._remarks.add(chunk, on_edge=self._compensation.on_edge)
                if values.count is not None:
                    chunk = replace(chunk, share=1.0 / np.maximum(values.count[rows], 1))
                if self._uncertain is not None:
                    self._add_uncertainties(self._uncertain.propagation, chunk, added[:own, rows])
                if self._earth is not None:
                    given = (values.magnetometer, values.heading, values.velocity)
                    added[own:, rows] = self._earth(
                        chunk, *(None if values is None else values[rows] for values in given)
                    )
        if lost is not None:
            mark(out, lost & (out.flag != MISSING), SUSPECT, NO_TEMPERATURE)
        return table | dict(zip(self.columns[len(table) :], added, strict=True))

    def _add_uncertainties(self, propagation: Propagation, chunk: KernelChunk, out: Array) -> None:
        if self._averaged:
            out[...] = with_shares(
                propagation(chunk, rounded=False), propagation(replace(chunk, share=0.0), rounded=False)
            )
        else:
            propagation(chunk, out.reshape(2, -1, out.shape[1]))


class PairKernel:
    """The matched sums of pairs of accelerometers."""

    def __init__(self, compensation: PairCompensation) -> None:
        self._compensation = compensation
        self.columns = compensation.columns

    def __call__(self, values: RoleValues) -> Table:
        return self._compensation(values.readings)
