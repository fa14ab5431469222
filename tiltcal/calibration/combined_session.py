"""One session of a combination: the coefficients that it measured, and those that it assumed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import product
from math import hypot
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiltcal.calibration.calibration import Calibration
from tiltcal.core.combination import Statement, conditional
from tiltcal.core.gravity_direction import gravity_from_tilt
from tiltcal.core.model import AXES, Array, Coefficients, vector_of
from tiltcal.core.named_coefficients import values
from tiltcal.core.uncertainty_inputs import UncertaintyInputs, is_turn
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord, dump_calibration, tilt_record
from tiltcal.files.document import parse_document, read_text
from tiltcal.files.results import NOISE_ALONE
from tiltcal.files.uncertainty import stated_uncertainty

KINDS = {"sensitivity": ("sensitivity.", "nonlinearity."), "temperature": ("temperature.",)}
"""The coefficients that ``derived.assumed`` names by their first word."""


@dataclass(frozen=True)
class CombinedSession:
    """One calibration, with what messages call it and the SHA-256 of its file."""

    label: str
    sha256: str
    record: CalibrationRecord

    @classmethod
    def of(cls, given: Calibration | str | Path) -> CombinedSession:
        if isinstance(given, Calibration):
            return cls(given.procedure.name or "a calibration", _sha(dump_calibration(given.record)), given.record)
        if not isinstance(given, str | Path):
            raise UsageError(f"combine takes tilt calibrations or their files, not {given!r:.40}")
        text = read_text(given)
        return cls(Path(given).name, _sha(text), tilt_record(parse_document(text, str(given))))

    @property
    def coefficients(self) -> Coefficients:
        return self.record.coefficients

    def assumes(self, kind: str) -> str | None:
        """Return what the session has assumed of ``sensitivity`` or ``temperature``; None where it measured it."""
        return next((name for name in self.record.derived.assumed if name.startswith(f"{kind}:")), None)

    @cached_property
    def assumed(self) -> frozenset[str]:
        """The coefficients that were not measured, those that the data sheet states among them."""
        starts = tuple(start for kind, all_ in KINDS.items() if self.assumes(kind) for start in all_)
        found = frozenset(name for name in values(self.coefficients) if starts and name.startswith(starts))
        return found | set(self.record.fit.priors)

    @cached_property
    def known(self) -> UncertaintyInputs:
        """The inputs of the combination that are uncertain."""
        try:
            stated = stated_uncertainty(self.record.uncertainty, self.coefficients).inputs
        except EstimateError as failure:
            raise EstimateError(f"{self.label}: {failure}") from failure
        return stated.chosen(np.flatnonzero(np.diag(stated.covariance) > 0.0))

    @property
    def exact(self) -> frozenset[str]:
        """The coefficients that were measured and whose uncertainty is not stated."""
        return frozenset(values(self.coefficients)) - self.assumed - set(self.known.names)

    @property
    def places(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which of :attr:`known` are measured coefficients, and which assumed ones."""
        names = self.known.names
        assumed = np.array([name in self.assumed for name in names], dtype=bool)
        return ~assumed & ~is_turn(names), assumed

    @property
    def temperature(self) -> tuple[float, float] | None:
        """Where the offset holds, °C, and the standard uncertainty of that; None where it is not known."""
        thermal, fit = self.coefficients.thermal, self.record.fit
        if thermal is not None:
            return thermal.reference, 0.0
        own, _, levelled = self.record.runs  # a level renews the offset at its own temperature
        met = [position.temperature for position in levelled or own if position.temperature is not None]
        if not met:
            return None
        stated = fit.thermometer_celsius
        return float(np.mean(met)), hypot(float(np.std(met)), stated or fit.thermometer_estimated_celsius or 0.0)

    @property
    def gravity(self) -> Array | None:
        """Up in the sensor's frame, where it is the same in every position of the session."""
        seen = [
            np.array(position.gravity if position.tilt is None else gravity_from_tilt(position.tilt))
            for position in self.record.procedure.set.values()
            if position.gravity is not None or position.tilt is not None
        ]
        return seen[0] if seen and all(np.allclose(gravity, seen[0], atol=1e-6) for gravity in seen) else None

    @property
    def level_unstated(self) -> bool:
        """Whether nothing is stated of how level a session lay that determined no sensitivity."""
        return bool(self.assumes("sensitivity")) and self.record.fit.uncertainty_from == NOISE_ALONE

    def statement(self, target: Coefficients, *, unstated_levels: bool) -> tuple[Statement, str]:
        """Return what the session states of a sensor with the axes and temperature terms of a target; and a remark.

        The offset is left out where its temperature is not known, and without ``unstated_levels`` that of a session
        whose level is not stated.
        """
        known, (measured, assumed) = self.known, self.places
        both = np.flatnonzero(measured | assumed)
        joint, own = known.chosen(both), known.chosen(np.flatnonzero(measured))
        conditioned, by = conditional(joint.names, joint.covariance, measured[both])
        stated, uncertain = values(self.coefficients), known.chosen(np.flatnonzero(assumed)).names
        value = vector_of(self.coefficients, own.names)
        columns = [(name, -by[:, k]) for k, name in enumerate(uncertain)]
        given: dict[str, Array] = {}
        for name, column in (*columns, *self._along_gravity(target, uncertain, own.names)):
            if name in values(target):
                given[name] = column
            else:  # the target's offset holds what this axis adds
                value = value + column * stated[name]
        why = self._no_offset(target, unstated_levels)
        kept = [k for k, name in enumerate(own.names) if not (why and name.startswith("offset."))]
        at = self.temperature if target.thermal is not None else None
        statement = Statement(
            label=self.label,
            names=tuple(own.names[k] for k in kept),
            values=value[kept],
            covariance=conditioned[np.ix_(kept, kept)],
            factors=own.factors[kept],
            temperature=None if at is None else at[0],
            u_temperature=0.0 if at is None else at[1],
            given=tuple(given),
            given_values=np.array([stated.get(name, 0.0) for name in given]),
            by_given=np.array(list(given.values())).reshape(len(given), len(own.names)).T[kept],
        )
        return statement, why

    def _no_offset(self, target: Coefficients, unstated_levels: bool) -> str:
        """Return why the offset of the session is left out; empty where it is not."""
        if self.level_unstated and not unstated_levels:
            return f"{self.label} does not state how level it was (--jig), and its offset contradicts: it is left out"
        if target.thermal is not None and self.temperature is None:
            return f"{self.label} states no temperature: its offset is left out"
        return ""

    def _along_gravity(
        self, target: Coefficients, uncertain: Sequence[str], own: Sequence[str]
    ) -> Iterator[tuple[str, Array]]:
        """Yield the sensitivities that the session took as exact, or left out, and how its values follow them."""
        if self.gravity is None or not self.assumes("sensitivity"):
            return
        for channel, (axis, along) in product(target.channels, zip(AXES, self.gravity, strict=True)):
            name = f"sensitivity.{channel}.{axis}"
            if name not in uncertain and (axis in target.axes or axis in self.coefficients.axes):
                yield name, np.array([float(row == f"offset.{channel}") * along for row in own])


def _sha(text: str) -> str:
    return sha256(text.encode()).hexdigest()
