"""A calibration from several sessions: scale from the vise, drift from the overnight run, each with its covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from hashlib import sha256
from itertools import combinations
from math import degrees, hypot
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tiltcal
from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.known_mounting import mounting_in_words, stated_mounting, with_mounting
from tiltcal.calibration.results import (
    DIGITS,
    NOISE_ALONE,
    SHARE_DIGITS,
    derived_record,
    rounded,
    rounded_covariance,
    uncertainty_of,
)
from tiltcal.calibration.verdict import judge
from tiltcal.core.angle_uncertainty import TURN
from tiltcal.core.combination import ASSUMED, Combination, Statement, combine_statements, conditional
from tiltcal.core.estimation.design import Design
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate
from tiltcal.core.frames import gravity_from_tilt
from tiltcal.core.model import AXES, Array, Coefficients, Limits, Thermal
from tiltcal.core.named_coefficients import values
from tiltcal.core.rounding import significant
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord, calibration_of, dump_calibration, require_same_sensor
from tiltcal.files.document import checked_kind, parse_document, read_text
from tiltcal.files.records import FileRecord, FitRecord, PositionRecord, ProcedureRecord, Provenance
from tiltcal.files.uncertainty import Uncertainty, stated_uncertainty
from tiltcal.frozen import frozen

UNKNOWN_MODEL = "recorded"
"""The model of a sensor that `fit` was told none of."""

KINDS = {"sensitivity": ("sensitivity.", "nonlinearity."), "temperature": ("temperature.",)}
"""The coefficients that ``derived.assumed`` names by their first word."""


def combine(
    calibrations: Sequence[Calibration | str | Path], *, mounting: Mapping[str, float] | str = ""
) -> Calibration:
    """Combine calibrations of one sensor from several sessions.

    What one session alone has measured is taken from it; what several have measured is their mean, weighted by its
    covariance. What a session has assumed, such as a nominal sensitivity or that of its base, is no information. Each
    session's offset is converted to the common reference temperature by the drift.

    Parameters
    ----------
    calibrations : sequence of Calibration, str or Path
        Calibrations, or their files. One alone is enough with a mounting.
    mounting : mapping of str to float, or str
        How the sensor sits, degrees, such as ``{"roll": 180}`` or ``"roll=180"``, in place of the calibrations' own.

    Returns
    -------
    Calibration

    Raises
    ------
    UsageError
        They are not of one sensor, or what they state contradicts by more than its uncertainty; the message names
        files and figures.
    EstimateError
        A calibration states no uncertainty, or together they determine no sensor.

    Examples
    --------
    >>> both = tiltcal.combine(["S-0042.yaml"], mounting="roll=180")
    """
    sessions = _named([_Session.of(one) for one in calibrations])
    known = stated_mounting(mounting) if mounting else None
    if len(sessions) < 2 and known is None:
        raise UsageError("name two calibrations or more, or a --mounting")
    _require_one_sensor(sessions)
    _require_independent(sessions)
    if known is not None:
        sessions = [replace(one, record=with_mounting(one.record, known)) for one in sessions]
    if len(sessions) == 1:
        (one,) = sessions
        return Calibration(replace(one.record, provenance=_provenance(sessions)))
    return Calibration(_combined(sessions))


@frozen
class _Session:
    """One calibration, with what messages call it and the SHA-256 of its file."""

    label: str
    sha256: str
    record: CalibrationRecord

    @classmethod
    def of(cls, given: Calibration | str | Path) -> _Session:
        if isinstance(given, Calibration):
            return cls(given.procedure.name or "a calibration", _sha(dump_calibration(given.record)), given.record)
        text = read_text(given)
        return cls(Path(given).name, _sha(text), calibration_of(checked_kind(parse_document(text, str(given)), "tilt")))

    @property
    def coefficients(self) -> Coefficients:
        return self.record.coefficients

    def assumes(self, kind: str) -> str | None:
        """Return what the session has assumed of ``sensitivity`` or ``temperature``; None where it measured it."""
        return next((one for one in self.record.derived.assumed if one.startswith(f"{kind}:")), None)

    @cached_property
    def assumed(self) -> frozenset[str]:
        """The coefficients that were not measured."""
        starts = tuple(start for kind, all_ in KINDS.items() if self.assumes(kind) for start in all_)
        return frozenset(name for name in values(self.coefficients) if starts and name.startswith(starts))

    @cached_property
    def known(self) -> tuple[tuple[str, ...], Array, Array]:
        """Names, covariance and coverage factors of what is uncertain, turns of the mounting in radians."""
        try:
            stated = stated_uncertainty(self.record.uncertainty, self.coefficients).inputs
        except EstimateError as failure:
            raise EstimateError(f"{self.label}: {failure}") from failure
        some = np.flatnonzero(np.diag(stated.covariance) > 0.0)
        return tuple(stated.names[k] for k in some), stated.covariance[np.ix_(some, some)], stated.factors[some]

    @property
    def exact(self) -> frozenset[str]:
        """The coefficients that were measured and whose uncertainty is not stated."""
        return frozenset(values(self.coefficients)) - self.assumed - set(self.known[0])

    @property
    def places(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which of :attr:`known` are measured coefficients, and which assumed ones."""
        names = self.known[0]
        assumed = np.array([name in self.assumed for name in names], dtype=bool)
        return ~assumed & np.array([not name.startswith(TURN) for name in names], dtype=bool), assumed

    @property
    def temperature(self) -> tuple[float, float] | None:
        """Where the offset holds, °C, and the standard uncertainty of that; None where nobody knows."""
        thermal, fit = self.coefficients.thermal, self.record.fit
        if thermal is not None:
            return thermal.reference, 0.0
        met = [one.temperature for one in self.record.positions if one.temperature is not None]
        if not met:
            return None
        return float(np.mean(met)), hypot(float(np.std(met)), fit.thermometer_celsius or 0.0)

    @property
    def gravity(self) -> Array | None:
        """Up in the sensor's frame, where it is the same in every position of the session."""
        seen = [
            np.array(one.gravity if one.tilt is None else gravity_from_tilt(one.tilt))
            for one in self.record.procedure.set.values()
            if one.gravity is not None or one.tilt is not None
        ]
        return seen[0] if seen and all(np.allclose(one, seen[0], atol=1e-6) for one in seen) else None

    def statement(self, target: Coefficients) -> tuple[Statement, str]:
        """Return what the session states of a sensor with the axes and temperature terms of a target; and a remark."""
        names, covariance, factors = self.known
        measured, assumed = self.places
        stated = values(self.coefficients)
        own = [name for name, kept in zip(names, measured, strict=True) if kept]
        both = measured | assumed
        conditioned, by = conditional(
            [name for name, kept in zip(names, both, strict=True) if kept],
            covariance[np.ix_(both, both)],
            measured[both],
        )
        uncertain = [name for name, kept in zip(names, assumed, strict=True) if kept]
        value = np.array([stated[name] for name in own])
        wanted = set(values(target))
        given, columns = [], []
        for k, name in enumerate(uncertain):
            if name in wanted:
                given.append(name)
                columns.append(-by[:, k])
        for name in self._missing(target, uncertain):
            if self.gravity is None:
                continue
            _, channel, axis = name.split(".")
            column = np.array([float(row == f"offset.{channel}") * self.gravity[AXES.index(axis)] for row in own])
            if name in wanted:
                given.append(name)
                columns.append(column)
            else:  # the target's offset holds what this axis adds
                value = value + column * stated[name]
        kept = list(range(len(own)))
        at, remark = self.temperature, ""
        if target.thermal is None:
            at = None
        elif at is None:
            kept = [k for k in kept if not own[k].startswith("offset.")]
            remark = f"{self.label} states no temperature: its offset is left out"
        return (
            Statement(
                self.label,
                tuple(own[k] for k in kept),
                value[kept],
                conditioned[np.ix_(kept, kept)],
                factors[measured][kept],
                None if at is None else at[0],
                0.0 if at is None else at[1],
                tuple(given),
                np.array([stated.get(name, 0.0) for name in given]),
                np.array(columns).reshape(len(given), len(own)).T[kept],
            ),
            remark,
        )

    def _missing(self, target: Coefficients, uncertain: Sequence[str]) -> Iterator[str]:
        """Yield the sensitivities that the session took as exact, or left out."""
        if not self.assumes("sensitivity"):
            return
        for channel in target.channels:
            for axis in AXES:
                name = f"sensitivity.{channel}.{axis}"
                if name not in uncertain and (axis in target.axes or axis in self.coefficients.axes):
                    yield name


def _sha(text: str) -> str:
    return sha256(text.encode()).hexdigest()


def _named(sessions: Sequence[_Session]) -> list[_Session]:
    """Return the sessions with labels that differ."""
    labels = [one.label for one in sessions]
    return [
        one if labels.count(one.label) == 1 else replace(one, label=f"{one.label} ({number})")
        for number, one in enumerate(sessions, start=1)
    ]


def _require_one_sensor(sessions: Sequence[_Session]) -> None:
    for one, other in combinations(sessions, 2):
        models = {one.record.sensor.model, other.record.sensor.model} - {UNKNOWN_MODEL}
        alike = replace(other.record.sensor, model=one.record.sensor.model) if len(models) < 2 else other.record.sensor
        require_same_sensor(one.record, replace(other.record, sensor=alike), (one.label, other.label))


def _require_independent(sessions: Sequence[_Session]) -> None:
    """Refuse measurements that would count twice.

    Raises
    ------
    UsageError
    """
    for one, other in combinations(sessions, 2):
        if one.sha256 == other.sha256:
            raise UsageError(f"{one.label} and {other.label} are one calibration: name it once")
        shared = _origins(one) & _origins(other)
        if shared:
            raise UsageError(
                f"{one.label} and {other.label} hold the same measurements, which would count twice: name the "
                "calibrations of the sessions themselves"
            )


def _origins(session: _Session) -> set[str]:
    """Return the checksums of the calibrations whose measurements a calibration holds, its own among them."""
    provenance = session.record.provenance
    held = {session.sha256, *(one.sha256 for one in provenance.sources if one.sha256)}
    if provenance.base is not None and provenance.base.sha256 and not session.assumes("sensitivity"):
        held.add(provenance.base.sha256)
    return held


def _combined(sessions: Sequence[_Session]) -> CalibrationRecord:
    target = _target(sessions)
    told = [one.statement(target) for one in sessions]
    statements = [one for one, _ in told if one.names]
    names = [name for name in values(target) if any(name in one.names for one in statements)]
    assumed = _assumed(sessions, names, target)
    found = combine_statements([*statements, *assumed], target, [*names, *(n for one in assumed for n in one.names)])
    _require_agreement(sessions, found)
    return _record(sessions, found, [remark for _, remark in told if remark])


def _target(sessions: Sequence[_Session]) -> Coefficients:
    """Return the coefficients to determine, with a first guess of each."""
    scaled = [one for one in sessions if not one.assumes("sensitivity")] or [
        min(sessions, key=lambda one: "nominal" in (one.assumes("sensitivity") or ""))
    ]
    drifted = [one for one in sessions if one.coefficients.thermal is not None]
    drifted = [one for one in drifted if not one.assumes("temperature")] or drifted[:1]
    first = scaled[0]
    for one in scaled[1:]:
        if set(one.coefficients.axes) != set(first.coefficients.axes):
            raise UsageError(
                f"{first.label} determines the sensitivity to {', '.join(first.coefficients.axes)} and {one.label} to "
                f"{', '.join(one.coefficients.axes)}: an offset of the one is not that of the other; combine sessions "
                "of the same axes"
            )
    for one, other in combinations(drifted, 2):
        a, b = one.coefficients.thermal, other.coefficients.thermal
        for what in ("drift", "gain"):
            orders = [getattr(t, what).shape[1] for t in (a, b)]
            if min(orders) and orders[0] != orders[1]:
                raise UsageError(
                    f"the {what} of {one.label} has order {orders[0]} and that of {other.label} {orders[1]}: a "
                    "polynomial of one order is not weighed against one of another; combine one of them"
                )
    _require_exact_once(sessions)
    _require_one_mounting(sessions)
    thermals = [one.coefficients.thermal for one in drifted if one.coefficients.thermal is not None]
    bent = [one.coefficients.nonlinearity for one in scaled if one.coefficients.nonlinearity is not None]
    return replace(
        first.coefficients,
        thermal=_thermal(thermals) if thermals else None,
        nonlinearity=bent[0] if bent else None,
        mounting=next((one.coefficients.mounting for one in sessions if one.coefficients.mounting), None),
    )


def _thermal(thermals: Sequence[Thermal]) -> Thermal:
    """Return temperature terms of the highest orders, at the first one's reference."""
    drift, gain = (
        max((getattr(one, what) for one in thermals), key=lambda t: t.shape[1]) for what in ("drift", "gain")
    )
    ranges = [one.range for one in thermals if one.range is not None]
    lags = {one.lag for one in thermals if one.lag}
    if len(lags) > 1:
        raise UsageError(
            f"the lags contradict: {' s and '.join(f'{lag:g}' for lag in sorted(lags))} s; combine one of them"
        )
    covered = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
    return replace(thermals[0], range=covered, drift=drift, gain=gain, lag=lags.pop() if lags else 0.0)


def _require_exact_once(sessions: Sequence[_Session]) -> None:
    for one in sessions:
        for other in sessions:
            twice = sorted(one.exact & (set(values(other.coefficients)) - other.assumed)) if other is not one else []
            if twice:
                raise UsageError(
                    f"{one.label} states no uncertainty of {', '.join(twice)}, which {other.label} has too: it cannot "
                    "be weighed"
                )


def _require_one_mounting(sessions: Sequence[_Session]) -> None:
    mounted = [one for one in sessions if one.coefficients.mounting is not None]
    for one in mounted[1:]:
        if one.coefficients.mounting != mounted[0].coefficients.mounting:
            told = " and ".join(
                f"{s.label} has {mounting_in_words(s.coefficients.mounting)}"
                for s in (mounted[0], one)
                if s.coefficients.mounting is not None
            )
            raise UsageError(f"the mountings contradict: {told}; state one with --mounting")


def _assumed(sessions: Sequence[_Session], measured: Sequence[str], target: Coefficients) -> list[Statement]:
    """Return what nobody has measured as it was assumed, once."""
    for kind in KINDS:
        if all(one.assumes(kind) or (kind == "temperature" and one.coefficients.thermal is None) for one in sessions):
            source = min(
                (one for one in sessions if one.assumes(kind)),
                key=lambda one: "nominal" in (one.assumes(kind) or ""),
                default=None,
            )
            if source is None:
                continue
            names, covariance, factors = source.known
            starts = KINDS[kind]
            some = [
                k
                for k, name in enumerate(names)
                if name.startswith(starts) and name in values(target) and name not in measured
            ]
            if some:
                stated = values(source.coefficients)
                own = tuple(names[k] for k in some)
                return [
                    Statement(
                        ASSUMED,
                        own,
                        np.array([stated[name] for name in own]),
                        covariance[np.ix_(some, some)],
                        factors[some],
                        temperature=None,
                        u_temperature=0.0,
                        given=(),
                        given_values=np.zeros(0),
                        by_given=np.zeros((len(own), 0)),
                    )
                ]
    return []


def _require_agreement(sessions: Sequence[_Session], found: Combination) -> None:
    """Refuse sessions that differ by more than their uncertainty.

    Raises
    ------
    UsageError
    """
    verdict = judge([change for _, change in found.differences])
    if not verdict.changed:
        return
    told = []
    for label, change in found.differences:
        if change.name in verdict.changed and change.u:
            expanded = verdict.thresholds[change.name] * change.u
            told.append(
                f"{change.name} is {change.after:.6g} in {label} and {change.before:.6g} by the others, apart by "
                f"{abs(change.difference):.3g} ± {expanded:.2g} (E_n {abs(change.difference) / expanded:.1f})"
            )
    alone = [one.label for one in sessions if one.record.fit.uncertainty_from == NOISE_ALONE]
    why = (
        f"; the uncertainty of {' and '.join(alone)} leaves out how well positions were set: state the --jig there"
        if alone
        else "; one of the sessions is wrong, or the sensor has changed between them"
    )
    raise UsageError(f"the calibrations contradict by more than their uncertainty: {'; '.join(told)}{why}")


def _record(sessions: Sequence[_Session], found: Combination, remarks: Sequence[str]) -> CalibrationRecord:
    records = [one.record for one in sessions]
    scaled = [one for one in sessions if not one.assumes("sensitivity")]
    measured = bool(scaled)
    positions, renamed = _positions(sessions)
    fits = [one.fit for one in records]
    dofs = [one.degrees_of_freedom for one in fits]
    estimate = Estimate(
        coefficients=found.coefficients,
        names=found.names,
        budget=found.budget,
        positions=(),
        residuals=np.zeros((0, 0)),
        remainders=np.zeros((0, 0)),
        dof=found.dof,
        chi_square=found.chi_square if found.dof else None,
        p=None,
        stated=True,
    )
    sensor = next((one.sensor for one in records if one.sensor.model != UNKNOWN_MODEL), records[0].sensor)
    design = Design(found.coefficients.channels, found.coefficients.axes, jig=0.0)
    derived = derived_record(estimate, design, "") if measured else records[0].derived
    kept = tuple(sessions[0].assumes(kind) or "" for kind in KINDS if all(one.assumes(kind) for one in sessions))
    sources = {one.uncertainty_from for one in fits if one.uncertainty_from}
    left = [note for one in fits for note in one.notes if note != NO_FREEDOM or not found.dof]
    notes = dict.fromkeys([f"combined of {' and '.join(_told(one) for one in sessions)}", *remarks, *left])
    return CalibrationRecord(
        sensor=sensor,
        coefficients=replace(rounded(estimate), mounting=found.coefficients.mounting),
        uncertainty=_uncertainty(sessions, estimate, found),
        limits=_limits(records, [one.record for one in scaled] or records),
        derived=replace(derived, assumed=tuple(kept)),
        fit=FitRecord(
            residuals={renamed[n, name]: row for n, one in enumerate(fits) for name, row in one.residuals.items()},
            degrees_of_freedom=None if None in dofs else sum(one or 0 for one in dofs) + found.dof,
            chi_square=significant(found.chi_square + sum(one.chi_square or 0.0 for one in fits), DIGITS)
            if all(one.chi_square is not None or not one.degrees_of_freedom for one in fits)
            else None,
            uncertainty_from=NOISE_ALONE if NOISE_ALONE in sources else "; ".join(sorted(sources)) or None,
            thermometer_celsius=max((one.thermometer_celsius or 0.0 for one in fits), default=0.0) or None,
            budget=_budget(sessions, found),
            notes=tuple(notes),
            mounting=next((one.mounting for one in fits if one.mounting), None),
            level=next((one.level for one in fits if one.level), None),
        ),
        procedure=ProcedureRecord(
            name=" + ".join(one.record.procedure.name or one.label for one in sessions),
            title=f"Combined of {len(sessions)} calibrations",
            set={
                renamed[n, name]: one for n, record in enumerate(records) for name, one in record.procedure.set.items()
            },
            mounting=next((one.procedure.mounting for one in records if one.procedure.mounting), None),
            level=next((one.procedure.level for one in records if one.procedure.level), None),
        ),
        positions=positions,
        provenance=_provenance(sessions),
    )


def _told(session: _Session) -> str:
    name, ended = session.record.procedure.name, session.record.provenance.ended
    more = ", ".join(filter(None, (name, ended and ended[:10])))
    return f"{session.label} ({more})" if more else session.label


def _positions(sessions: Sequence[_Session]) -> tuple[tuple[PositionRecord, ...], dict[tuple[int, str], str]]:
    """Return all positions, and the name that each has now by the number of its session and its name there."""
    every = [(n, one.position) for n, session in enumerate(sessions) for one in session.record.positions]
    every += [(n, name) for n, session in enumerate(sessions) for name in session.record.fit.residuals]
    every += [(n, name) for n, session in enumerate(sessions) for name in session.record.procedure.set]
    every = list(dict.fromkeys(every))
    count = [name for _, name in every]
    renamed = {
        (n, name): name if count.count(name) == 1 else f"{Path(sessions[n].label).stem}/{name}" for n, name in every
    }
    groups: list[list[PositionRecord]] = [[], [], []]
    for n, session in enumerate(sessions):
        record = session.record
        fitted = record.positions_with(mounting=(), level=())
        mounted = record.positions_with(level=())[len(fitted) :]
        levelled = record.positions[len(fitted) + len(mounted) :]
        for group, own in zip(groups, (fitted, mounted, levelled), strict=True):
            group += [replace(one, position=renamed[n, one.position]) for one in own]
    return tuple(one for group in groups for one in group), renamed


def _uncertainty(sessions: Sequence[_Session], estimate: Estimate, found: Combination) -> Uncertainty:
    """Return the uncertainty of all coefficients, and that of a mounting with its covariance."""
    single: dict[str, float] = {}
    for one in sessions:
        for name, u in one.record.uncertainty.single_reading.items():
            single[name] = max(u, single.get(name, 0.0))
    both = uncertainty_of(estimate, single)
    both = replace(both, alignment=max(one.record.uncertainty.alignment for one in sessions))
    for session in sessions:
        names, covariance, factors = session.known
        turns = [k for k, name in enumerate(names) if name.startswith(TURN)]
        if not turns:
            continue
        across = np.zeros((len(found.names), len(turns)))
        for statement, by in zip(found.statements, found.parts, strict=True):
            if statement.label == session.label:
                across = by @ covariance[np.ix_([names.index(name) for name in statement.names], turns)]
        own, scale = covariance[np.ix_(turns, turns)], degrees(1.0)
        joint = np.block([[estimate.covariance, across * scale], [across.T * scale, own * scale**2]])
        mounted = {name: u for name, u in session.record.uncertainty.items() if name.startswith("mounting.")}
        return replace(
            both,
            standard={**both.standard, **mounted},
            coverage_factor={**both.coverage_factor, **{names[k]: round(float(factors[k]), 3) for k in turns}},
            covariance=rounded_covariance((*estimate.names, *(names[k] for k in turns)), joint),
        )
    return both


def _budget(sessions: Sequence[_Session], found: Combination) -> dict[str, dict[str, float]]:
    """Return the share of each source in each variance, by the sessions' own budgets."""
    shares: dict[str, dict[str, float]] = {}
    measured = {one.label: one.names for one in found.statements}
    own = {
        one.label: {name: row for name, row in one.record.fit.budget.items() if name in measured.get(one.label, ())}
        for one in sessions
    }
    for k, name in enumerate(found.names):
        row: dict[str, float] = {}
        for label, column in found.budget.shares.items():
            sources = own.get(label, {}).get(name) or {ASSUMED if label == ASSUMED else "other sessions": 1.0}
            for source, share in sources.items():
                row[source] = row.get(source, 0.0) + share * float(column[k])
        shares[name] = {source: part for source, share in row.items() if (part := round(share, SHARE_DIGITS))}
    return shares


def _limits(records: Sequence[CalibrationRecord], scaled: Sequence[CalibrationRecord]) -> Limits:
    """Return the tilts that the sensitivity was measured in, the temperatures of the drift, the rails of all."""
    tilt: dict[str, tuple[float, float]] = {}
    reading: dict[str, tuple[float, float]] = {}
    for one in scaled:
        for axis, (low, high) in one.limits.tilt.items():
            before = tilt.get(axis, (low, high))
            tilt[axis] = min(low, before[0]), max(high, before[1])
    for one in records:
        for channel, (low, high) in one.limits.reading.items():
            before = reading.get(channel, (low, high))
            reading[channel] = max(low, before[0]), min(high, before[1])
    met = [one.limits.temperature for one in records if one.limits.temperature and one.coefficients.thermal]
    return Limits(tilt, (min(low for low, _ in met), max(high for _, high in met)) if met else None, reading)


def _provenance(sessions: Sequence[_Session]) -> Provenance:
    """Return where the calibrations come from, and their SHA-256."""
    each = [one.record.provenance for one in sessions]
    started, ended = (
        [t for t in times if t] for times in zip(*((one.started, one.ended) for one in each), strict=True)
    )
    made = dict.fromkeys(one.made_by for one in each if one.made_by)
    return Provenance(
        made_by=f"combination of calibrations by {' and '.join(made)}" if made else "combination of calibrations",
        operator=" and ".join(dict.fromkeys(one.operator for one in each if one.operator)) or None,
        sources=tuple(FileRecord(name=one.label, sha256=one.sha256) for one in sessions),
        software=f"tiltcal {tiltcal.__version__}",
        started=min(started) if started else None,
        ended=max(ended) if ended else None,
    )
