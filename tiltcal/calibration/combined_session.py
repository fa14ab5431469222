"""One session of a combination: its positions, or what its calibration states of the coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from math import hypot, inf
from pathlib import Path

import numpy as np

from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.core.estimation.positions import Design, Observation, StatedCoefficients
from tiltcal.core.model import AXES, Array, Coefficients, vector_of
from tiltcal.core.named_coefficients import values
from tiltcal.core.samples import BLOCKS
from tiltcal.core.uncertain import ALIGNMENT, READING, TURN
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord, dump_calibration, tilt_record
from tiltcal.files.document import parse_document
from tiltcal.files.results import PositionRecord, PositionSet
from tiltcal.files.uncertainty import stated_uncertainty, uncertain_coefficients
from tiltcal.files.yaml_text import read_text

KINDS = {"sensitivity": ("sensitivity.", "nonlinearity."), "temperature": ("temperature.",)}
"""The coefficients that ``derived.assumed`` names by their first word."""

UNKNOWN_JIG = 5.0
"""Standard uncertainty of a set angle where a session states and shows none and others state theirs, degrees."""


@dataclass(frozen=True)
class CombinedSession:
    """One calibration, with what messages call it and the SHA-256 of its file.

    ``counted`` where another calibration of the combination holds the same positions; ``by_values`` where its positions
    cannot be fitted with those of the others.
    """

    label: str
    sha256: str
    record: CalibrationRecord
    counted: bool = False
    by_values: bool = False

    @classmethod
    def of(cls, given: CalibrationRecord | str | Path) -> CombinedSession:
        if isinstance(given, CalibrationRecord):
            return cls(given.procedure.name or "a calibration", _sha(dump_calibration(given)), given)
        if not isinstance(given, str | Path):
            raise UsageError(f"combine takes tilt calibrations or their files, not {given!r:.40}")
        text = read_text(given)
        return cls(Path(given).name, _sha(text), tilt_record(parse_document(text, str(given))))

    @property
    def coefficients(self) -> Coefficients:
        return self.record.coefficients

    @property
    def journal(self) -> str | None:
        """The SHA-256 of its journal."""
        journal = self.record.provenance.journal
        return None if journal is None else journal.sha256

    @property
    def origins(self) -> set[str]:
        """The checksums of the calibrations whose measurements it holds, its own among them."""
        provenance = self.record.provenance
        origins = {self.sha256, *(source.sha256 for source in provenance.sources if source.sha256)}
        if provenance.base is not None and provenance.base.sha256 and not self.assumes("sensitivity"):
            origins.add(provenance.base.sha256)
        return origins

    def assumes(self, kind: str) -> str | None:
        """Return what the session has assumed of ``sensitivity`` or ``temperature``; None where it measured it."""
        return next((name for name in self.record.derived.assumed if name.startswith(f"{kind}:")), None)

    @cached_property
    def assumed(self) -> frozenset[str]:
        """The coefficients that were not measured, those that the data sheet states among them."""
        starts = tuple(start for kind, all_ in KINDS.items() if self.assumes(kind) for start in all_)
        names = frozenset(name for name in values(self.coefficients) if starts and name.startswith(starts))
        return names | set(self.record.fit.priors)

    @property
    def measured(self) -> frozenset[str]:
        """The coefficients that it has, and has not assumed."""
        return frozenset(values(self.coefficients)) - self.assumed

    @property
    def exact(self) -> frozenset[str]:
        """The coefficients that were measured and whose uncertainty is not stated."""
        stated = uncertain_coefficients(self.record.uncertainty, self.coefficients)
        return self.measured - {name for name, u in stated.by_name(stated.u).items() if u}

    @cached_property
    def positions(self) -> tuple[PositionRecord, ...]:
        """The positions that determined its offset: a level renews it at its own temperature."""
        own, _, levelled = self.record.runs
        return levelled or own

    @property
    def observed(self) -> bool:
        """Whether it has positions that were set, with their uncertainty, and they give its coefficients."""
        fit, places = self.record.fit, self.record.procedure.set
        if (
            self.counted
            or self.by_values
            or fit.level
            or fit.ramp
            or fit.distinct_attitudes is not None
            or not self.positions
        ):
            return False
        return all(
            one.u and one.position in places and (places[one.position].gravity or places[one.position].tilt)
            for one in self.positions
        )

    @property
    def jig(self) -> float | None:
        """The standard uncertainty of a set angle that it states or shows, degrees; None where it does neither."""
        fit = self.record.fit
        return fit.jig_estimated_degrees if fit.jig_degrees is None else fit.jig_degrees

    @property
    def temperature(self) -> tuple[float, float] | None:
        """Where the offset holds, °C, and the standard uncertainty of that; None where it is not known."""
        thermal, fit = self.coefficients.thermal, self.record.fit
        if thermal is not None:
            return thermal.reference, 0.0
        met = [position.temperature for position in self.positions if position.temperature is not None]
        if not met:
            return None
        stated = fit.thermometer_celsius
        return float(np.mean(met)), hypot(float(np.std(met)), stated or fit.thermometer_estimated_celsius or 0.0)

    @property
    def _gravity(self) -> Array:
        """Up in the sensor's frame where all its positions have one direction; otherwise 0, shape (3,)."""
        places = [_gravity(place) for place in self.record.procedure.set.values() if place.gravity or place.tilt]
        same = bool(places) and all(np.allclose(place, places[0], atol=1e-6) for place in places)
        return places[0] if same and self.assumes("sensitivity") else np.zeros(3)

    def observations(self, design: Design) -> list[Observation]:
        """Return its positions for the estimator, named after the session."""
        places = self.record.procedure.set
        looser = (self.jig or UNKNOWN_JIG) / design.jig if design.jig and self.jig != 0.0 else 1.0
        before = [None, *(places[one.position] for one in self.positions)]
        return [
            Observation(
                f"{self.label}/{one.position}",
                _gravity(places[one.position]),
                np.array([one.mean[c] for c in design.channels]),
                np.array([(one.u or {})[c] for c in design.channels]),
                one.temperature,
                places[one.position].heading,
                held=last is not None and _setting(last) == _setting(places[one.position]),
                dof=np.full(len(design.channels), inf if (one.n or 0) < 2 else min(BLOCKS, one.n or 0) - 1.0),
                looser=max(looser, 1e-3),
            )
            for one, last in zip(self.positions, before, strict=False)
        ]

    def statement(self, design: Design, slope: Array) -> StatedCoefficients:
        """Return what the file states of the coefficients of a design that it has measured.

        ``slope`` is the drift that the temperature of a file without one is worth, unit/°C, shape (channels,).

        EstimateError: it states no uncertainty. UsageError: its drift has another order, or its sensitivity other axes.
        """
        try:
            stated = stated_uncertainty(self.record.uncertainty, self.coefficients)[0].without(TURN, READING, ALIGNMENT)
        except EstimateError as failure:
            raise EstimateError(f"{self.label}: {failure}") from failure
        at, thermal = self.temperature, self.coefficients.thermal
        for what in ("drift", "gain") if thermal is not None else ():
            own, order = getattr(thermal, what).shape[1], getattr(design, what)
            if own and own != order:
                raise UsageError(
                    f"the {what} of {self.label} has order {own} and that of another calibration {order}: a polynomial "
                    "of one order is not weighed against one of another; combine one of them"
                )
        if not self.assumes("sensitivity") and set(self.coefficients.axes) != set(design.axes):
            raise UsageError(
                f"{self.label} determines the sensitivity to {', '.join(self.coefficients.axes)} and another "
                f"calibration to {', '.join(design.axes)}: an offset of the one is not that of the other; combine "
                "sessions of the same axes"
            )
        kept = [
            k
            for k, name in enumerate(stated.names)
            if name in design.names
            and name not in self.assumed
            and stated.covariance[k, k] > 0.0
            and not (name.startswith("offset.") and design.thermal and at is None)
        ]
        stated = stated.chosen(kept)
        rows = np.array([[float(name == other) for other in design.names] for name in stated.names]).reshape(
            -1, len(design.names)
        )
        covariance = stated.wide.copy()
        warmer = at[0] - design.reference if at is not None else 0.0
        for k, name in enumerate(stated.names):
            if not name.startswith("offset."):
                continue
            channel = name.split(".")[1]
            if thermal is None and at is not None:
                covariance[k, k] += (slope[design.channels.index(channel)] * at[1]) ** 2
            for order in range(1, design.drift + 1):
                rows[k, design.names.index(f"temperature.offset.{channel}.{order}")] = warmer**order
            for axis, along in zip(AXES, self._gravity, strict=True):  # a column that it lacks is in its offset
                if axis in design.axes and axis not in self.coefficients.axes:
                    rows[k, design.names.index(f"sensitivity.{channel}.{axis}")] = along
        return StatedCoefficients(stated.names, rows, vector_of(self.coefficients, stated.names), covariance)


def _gravity(place: PositionSet) -> Array:
    """Return up in the sensor's frame as set, shape (3,)."""
    return np.array(place.gravity if place.tilt is None else gravity_from_tilt(place.tilt), dtype=float)


def _setting(place: PositionSet) -> tuple[object, ...]:
    return tuple(_gravity(place)), place.heading


def _sha(text: str) -> str:
    return sha256(text.encode()).hexdigest()
