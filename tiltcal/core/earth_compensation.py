"""A compensation that adds heading and velocities in the earth frame to its rows, and their flags."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np

from tiltcal.core.compensation import CLIP_LIMIT, VANISHES, Compensation, KernelChunk
from tiltcal.core.earth_uncertainty import EarthUncertainty
from tiltcal.core.flags import CLIPPED, FAIL, MISSING, NO_DIRECTION, NOT_A_NUMBER, SUSPECT, mark
from tiltcal.core.heading import HEADING, VELOCITY, EarthFrame, full_circle, length_of
from tiltcal.core.model import Array
from tiltcal.core.uncertainty_columns import round_up, uncertainty_columns, with_shares
from tiltcal.errors import EstimateError


class EarthFrameCompensation:
    """Adds heading and earth velocities to the rows of a compensation, and their flags.

    Parameters
    ----------
    compensation : Compensation
        Of a sensor with two or three channels.
    magnetometer : bool
        The heading comes from a magnetometer, and is added; else rows have a heading.
    velocity : bool
        Velocities are added.
    declination : float
        Added to the heading, degrees, positive where magnetic north is east of true north.
    uncertainty : EarthUncertainty, optional
        Adds the uncertainty of each column.
    averaged : bool
        Rows are means: adds the random and the common share of each uncertainty.

    Raises
    ------
    EstimateError
        The sensor measures no x and y.

    Notes
    -----
    Sensor and magnetometer have the same axes, and a mounting turns both; velocities are in the application's frame,
    and a mounting does not turn them.
    """

    def __init__(
        self,
        compensation: Compensation,
        *,
        magnetometer: bool,
        velocity: bool,
        declination: float = 0.0,
        uncertainty: EarthUncertainty | None = None,
        averaged: bool = False,
    ) -> None:
        if not {"x", "y"} <= set(compensation.axes):
            raise EstimateError("heading and velocities take a sensor that measures at least x and y")
        self._compensation = compensation
        self._declination = radians(declination)
        self._uncertainty = uncertainty
        self._averaged = averaged
        self._own = (*((HEADING,) if magnetometer else ()), *(VELOCITY if velocity else ()))

    @property
    def expanded(self) -> tuple[str, ...]:
        """Names of the columns that hold half widths of 95 % intervals."""
        return () if self._uncertainty is None else tuple(f"U95_{name}" for name in self._own)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of a call, in order."""
        if self._uncertainty is None:
            return self._own
        return (*self._own, *uncertainty_columns(self._own, averaged=self._averaged))

    def __call__(self, chunk: KernelChunk, field: Array | None, heading: Array | None, velocity: Array | None) -> Array:
        """Return the columns of some rows, shape (columns, n), and mark their flags.

        Parameters
        ----------
        chunk : KernelChunk
            The rows, compensated.
        field : ndarray, shape (n, 3), or None
            In the sensor's frame.
        heading : ndarray, shape (n,), or None
            Degrees; needed without a field.
        velocity : ndarray, shape (n, 3), or None
        """
        up = self._up(chunk)
        if field is not None:
            turned = self._turned(field.T)
            frame = EarthFrame.of_field(up, turned, self._declination)
        elif heading is not None:
            turned = None
            frame = EarthFrame.of_heading(up, np.radians(heading) + self._declination)
        else:
            raise ValueError("heading and velocities take a field or a heading")
        missing = np.zeros(len(chunk.out.flag), bool)
        for given in (field, heading, velocity):
            if given is not None:
                missing |= ~np.isfinite(given).reshape(len(given), -1).all(axis=1)
        mark(chunk.out, missing & (chunk.out.flag < MISSING), FAIL, NOT_A_NUMBER)
        without = ~missing & ~np.isfinite(frame.heading)
        mark(chunk.out, without & (np.isfinite(up[0]) | (chunk.out.flag < FAIL)), FAIL, NO_DIRECTION)
        rows = [] if field is None else [full_circle(np.degrees(frame.heading), 360.0)]
        instrument = None
        if velocity is not None:
            instrument = velocity.T
            rows += [*frame.velocity(instrument)]
        found = np.stack(rows)
        if self._uncertainty is None:
            return found
        total = np.stack(self._uncertainty(chunk, frame, turned, instrument))
        if not self._averaged:
            round_up(total)
            return np.concatenate([found, *total])
        common = np.stack(self._uncertainty(replace(chunk, share=0.0), frame, turned, instrument))
        return np.concatenate([found, with_shares(total, common)])

    def _up(self, chunk: KernelChunk) -> Array:
        """Return the unit vector that points up in the application's frame, shape (3, n); NaN where it is unknown."""
        up = self._compensation.up(chunk)
        length = length_of(up)
        unknown = chunk.out.flag == MISSING
        if len(self._compensation.axes) == 2:
            beyond = length > 1.0 + 1e-9
            mark(chunk.out, beyond, SUSPECT, CLIPPED)
            lost = length > CLIP_LIMIT
            mark(chunk.out, lost, FAIL, CLIPPED)
            unknown |= lost
        elif len(self._compensation.axes) == 3:
            unknown |= np.isnan(chunk.out.angles[:, 0])
        length[unknown | (length <= VANISHES)] = np.nan
        return np.asarray(up / length)

    def _turned(self, vectors: Array) -> Array:
        rotation = self._compensation.rotation
        return vectors if rotation is None else np.asarray(rotation @ vectors)
