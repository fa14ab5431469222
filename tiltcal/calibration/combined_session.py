"""One calibration of a combination, as the estimator takes it: by its positions, or by what its file states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import hypot, inf

import numpy as np

from tiltcal.calibration.stated import stated_uncertainty
from tiltcal.core.estimation.positions import Design, Observation
from tiltcal.core.model import AXES, Array, Coefficients, values, vector_of
from tiltcal.core.samples import BLOCKS
from tiltcal.core.uncertain import ALIGNMENT, READING, TURN, Uncertain, selection
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.results import PositionRecord

KINDS = {"offset": ("offset.",), "sensitivity": ("sensitivity.", "nonlinearity."), "temperature": ("temperature.",)}
"""The coefficients that ``derived.assumed`` names by their first word."""

UNKNOWN_JIG = 5.0  # u of a set angle where a session neither states nor shows one and others state theirs, degrees


@dataclass(frozen=True)
class CombinedSession:
    """One calibration of a combination."""

    label: str  # what messages call it
    sha256: str  # of its file
    record: CalibrationRecord
    by_values: bool = False  # its positions cannot be fitted with those of the others

    @property
    def coefficients(self) -> Coefficients:
        return self.record.coefficients

    @property
    def positions(self) -> tuple[PositionRecord, ...]:
        return self.record.offset_positions

    def named(self, position: str) -> str:
        """Return the name of one of its positions in the combination."""
        return f"{self.label.replace('.yaml', '')}/{position}"

    @property
    def origins(self) -> set[str]:
        """The checksums of the calibrations whose measurements it holds, its own among them."""
        sources, base = self.record.provenance.sources, self.record.provenance.base
        files = sources if base is None or self.assumes("sensitivity") else (*sources, base)
        return {self.sha256, *(file.sha256 for file in files if file.sha256)}

    def assumes(self, kind: str) -> str:
        """Return what the session has assumed of ``sensitivity`` or ``temperature``; empty where it measured it."""
        return next((name for name in self.record.derived.assumed if name.startswith(f"{kind}:")), "")

    @cached_property
    def assumed(self) -> frozenset[str]:
        """The coefficients that were not measured, those that the data sheet states among them."""
        starts = tuple(start for kind, all_ in KINDS.items() if self.assumes(kind) for start in all_)
        names = (name for name in values(self.coefficients) if starts and name.startswith(starts))
        return frozenset(names) | set(self.record.fit.priors)

    @property
    def measured(self) -> frozenset[str]:
        """The coefficients that it has, and has not assumed."""
        return frozenset(values(self.coefficients)) - self.assumed

    @cached_property
    def observed(self) -> bool:
        """Whether it has positions that were set, with their uncertainty, and they give its coefficients."""
        fit, places = self.record.fit, self.record.procedure.set
        apart = self.by_values or fit.level or fit.ramp or fit.distinct_attitudes is not None
        complete = [one.u and one.position in places and places[one.position].up for one in self.positions]
        return not apart and bool(complete) and all(complete)

    @property
    def jig(self) -> float | None:
        """The standard uncertainty of a set angle that it states or shows, degrees; None where it does neither."""
        fit = self.record.fit
        return fit.jig_estimated_degrees if fit.jig_degrees is None else fit.jig_degrees

    def observations(self, design: Design) -> list[Observation]:
        """Return its positions for the estimator, by their names in the combination."""
        places = [self.record.procedure.set[one.position] for one in self.positions]
        settings = [None, *((place.up, place.heading) for place in places)]
        looser = (self.jig or UNKNOWN_JIG) / design.jig if design.jig and self.jig != 0.0 else 1.0
        return [
            Observation(
                self.named(one.position),
                np.array(place.up),
                np.array([one.mean[c] for c in design.channels]),
                np.array([(one.u or {})[c] for c in design.channels]),
                one.temperature,
                place.heading,
                held=before == setting,
                dof=np.full(len(design.channels), inf if (one.n or 0) < 2 else min(BLOCKS, one.n or 0) - 1.0),
                looser=max(looser, 1e-3),
            )
            for one, place, (before, setting) in zip(self.positions, places, pairwise(settings), strict=True)
        ]

    def statement(self, design: Design, slope: Array) -> tuple[Array, Uncertain]:
        """Return what the file states of the coefficients of a design that it has measured, as the design takes it.

        ``slope`` is the drift that the temperature of a file without one is worth, unit/°C, shape (channels,).
        """
        try:
            own = stated_uncertainty(self.record)[0]
        except EstimateError as failure:
            raise EstimateError((f"{self.label}: ", *failure.words)) from failure
        at, thermal, axes = self.record.temperature, self.coefficients.thermal, self.coefficients.axes
        fit = self.record.fit
        straight = int(fit.distinct_attitudes is not None and thermal is not None)  # by free positions
        for what in ("drift", "gain") if thermal is not None else ():
            if (order := getattr(thermal, what).shape[1]) not in (0, getattr(design, what), straight):
                raise UsageError(
                    f"the {what} of {self.label} has order {order} and that of another calibration "
                    f"{getattr(design, what)}; combine one of them"
                )
        if not self.assumes("sensitivity") and set(axes) != set(design.axes):
            raise UsageError(
                f"{self.label} determines the sensitivity to {', '.join(axes)} and another calibration to "
                f"{', '.join(design.axes)}; combine sessions of the same axes"
            )
        own = own.without(TURN, READING, ALIGNMENT, *(["offset."] if design.thermal and at is None else []))
        own = own.named([name for name in own.names if name in design.names and name in self.measured])
        own = own.chosen(np.flatnonzero(own.u > 0.0))
        rows, covariance, place = selection(own.names, design.names), own.wide.copy(), design.names.index
        directions = [setting.up for setting in self.record.procedure.set.values() if setting.up]
        same = bool(directions) and np.allclose(directions, directions[0], atol=1e-6) and self.assumes("sensitivity")
        met = [one.temperature for one in self.positions if one.temperature is not None] or [0.0]
        u_at = hypot(float(np.std(met)), fit.thermometer_celsius or fit.thermometer_estimated_celsius or 0.0)

        def line(order: int) -> Array:
            """Slope and level of the line that fits a power best at the temperatures met, as free positions see it."""
            return np.polyfit(np.array(met) - (at or 0.0), (np.array(met) - design.reference) ** order, 1)

        for k, name in enumerate(own.names):
            kind, _, channel = name.partition(".")
            if kind == "offset" and at is not None:
                for order in range(1, design.drift + 1):
                    level = line(order)[1] if straight else (at - design.reference) ** order
                    rows[k, place(f"temperature.offset.{channel}.{order}")] = level
                if thermal is None:
                    covariance[k, k] += (slope[design.channels.index(channel)] * u_at) ** 2
            for order in range(2, design.drift + 1) if straight and kind == "temperature" else ():
                rows[k, place(f"{name.removesuffix('1')}{order}")] = line(order)[0]
            for axis in set(design.axes) - set(axes) if kind == "offset" and same else ():
                # A column that it lacks is in its offset.
                rows[k, place(f"sensitivity.{channel}.{axis}")] = directions[0][AXES.index(axis)]
        return rows, Uncertain(own.names, vector_of(self.coefficients, own.names), covariance, covariance)
