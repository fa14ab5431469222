"""A calibration from several sessions: scale from the vise, drift from the overnight run, each with its covariance."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, permutations
from pathlib import Path

import numpy as np

from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.combined_record import combined_provenance, combined_record
from tiltcal.calibration.combined_session import KINDS, CombinedSession
from tiltcal.calibration.stated_mounting import mounting_in_words, stated_mounting, with_mounting
from tiltcal.calibration.verdict import judge
from tiltcal.core.combination import ASSUMED, Combination, Statement, combine_statements
from tiltcal.core.coverage_factor import COVERAGE
from tiltcal.core.model import Coefficients, Thermal, vector_of
from tiltcal.core.named_coefficients import values
from tiltcal.core.rounding import plus_minus
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord, require_same_sensor
from tiltcal.files.results import NOISE_ALONE

REFUSED = 0.999
"""Sessions that agree are refused once in a thousand combinations (Baarda's level); at 95 % they are noted."""


def combine(
    calibrations: Sequence[Calibration | str | Path] | Calibration | str | Path,
    *,
    mounting: Mapping[str, float] | str = "",
) -> Calibration:
    """Combine calibrations of one sensor from several sessions.

    What one session alone has measured is taken from it; what several have measured is their mean, weighted by its
    covariance. ``fit.notes`` names a difference that sessions in agreement have once in twenty times. What a session
    has assumed, such as a nominal sensitivity or that of its base, is no information. Each session's offset is
    converted to the common reference temperature by the drift.

    Parameters
    ----------
    calibrations : sequence of Calibration, str or Path
        Calibrations, or their files. One alone is enough with a mounting, and needs no sequence.
    mounting : mapping of str to float, or str
        How the sensor sits, degrees, such as ``{"roll": 180}`` or ``"roll=180"``, in place of the calibrations' own.

    Returns
    -------
    Calibration

    Raises
    ------
    UsageError
        They are not of one sensor, or what they state differs by so much as it does in one of a thousand combinations
        of sessions that agree; the message names files and figures.
    EstimateError
        A calibration states no uncertainty, or together they determine no sensor.

    Examples
    --------
    >>> both = tiltcal.combine(["S-0042.yaml"], mounting="roll=180")
    """
    if isinstance(calibrations, str | Path | Calibration):
        calibrations = [calibrations]
    if not isinstance(calibrations, Iterable):
        raise UsageError(f"combine takes tilt calibrations or their files, not {calibrations!r}")
    found = [CombinedSession.of(calibration) for calibration in calibrations]
    known = stated_mounting(mounting) if mounting else None
    if not found or (len(found) < 2 and known is None):
        raise UsageError("name two calibrations or more, or a --mounting")
    sessions = _named(found)
    _require_one_sensor(sessions)
    _require_independent(sessions)
    if known is not None:
        sessions = [replace(session, record=with_mounting(session.record, known)) for session in sessions]
    if len(sessions) == 1:
        return Calibration(replace(sessions[0].record, provenance=combined_provenance(sessions)))
    return Calibration(_combined(sessions))


def _named(sessions: Sequence[CombinedSession]) -> list[CombinedSession]:
    """Return the sessions with labels that differ."""
    labels = [session.label for session in sessions]
    return [
        session if labels.count(session.label) == 1 else replace(session, label=f"{session.label} ({number})")
        for number, session in enumerate(sessions, start=1)
    ]


def _require_one_sensor(sessions: Sequence[CombinedSession]) -> None:
    for session, other in combinations(sessions, 2):
        one, another = session.record.sensor, other.record.sensor
        if UNKNOWN_MODEL in (one.model, another.model):
            another = another.replaced(model=one.model)
        require_same_sensor(session.record, replace(other.record, sensor=another), (session.label, other.label))


def _require_independent(sessions: Sequence[CombinedSession]) -> None:
    """Refuse measurements that would count twice, with a UsageError."""
    for session, other in combinations(sessions, 2):
        if session.sha256 == other.sha256:
            raise UsageError(f"{session.label} and {other.label} are one calibration: name it once")
        shared = _origins(session) & _origins(other)
        if shared:
            raise UsageError(
                f"{session.label} and {other.label} hold the same measurements, which would count twice: name the "
                "calibrations of the sessions themselves"
            )


def _origins(session: CombinedSession) -> set[str]:
    """Return the checksums of the calibrations whose measurements a calibration holds, its own among them."""
    provenance = session.record.provenance
    held = {session.sha256, *(source.sha256 for source in provenance.sources if source.sha256)}
    if provenance.base is not None and provenance.base.sha256 and not session.assumes("sensitivity"):
        held.add(provenance.base.sha256)
    return held


def _combined(sessions: Sequence[CombinedSession]) -> CalibrationRecord:
    target = _target(sessions)
    found, remarks = _estimate(sessions, target, unstated_levels=True)
    if _contradictions(found, COVERAGE) and any(session.level_unstated for session in sessions):
        with suppress(EstimateError):  # no other session has measured its offset
            found, remarks = _estimate(sessions, target, unstated_levels=False)
    _require_agreement(sessions, found)
    contradictions = _contradictions(found, COVERAGE)
    remarks += [f"{line}; sessions that agree differ by so much once in 20 combinations" for line in contradictions]
    return combined_record(sessions, found, remarks)


def _estimate(
    sessions: Sequence[CombinedSession], target: Coefficients, *, unstated_levels: bool
) -> tuple[Combination, list[str]]:
    """Return what the sessions together state, and remarks on what was left out; EstimateError without any offset."""
    stated = [session.statement(target, unstated_levels=unstated_levels) for session in sessions]
    statements = [statement for statement, _ in stated if statement.names]
    remarks = [remark for _, remark in stated if remark]
    names = [name for name in values(target) if any(name in statement.names for statement in statements)]
    lost = [name for name in values(target) if name.startswith("offset.") and name not in names]
    if lost and not any(lost[0] in session.exact for session in sessions):
        raise EstimateError(f"no calibration determines {' and '.join(lost)}: {'; '.join(remarks)}")
    assumed = _assumed(sessions, names, target)
    every = [*names, *(name for statement in assumed for name in statement.names)]
    return combine_statements([*statements, *assumed], target, every), remarks


def _target(sessions: Sequence[CombinedSession]) -> Coefficients:
    """Return the coefficients to determine, with a first guess of each."""
    scaled = [session for session in sessions if not session.assumes("sensitivity")] or [
        min(sessions, key=lambda session: "nominal" in (session.assumes("sensitivity") or ""))
    ]
    drifted = [session for session in sessions if session.coefficients.thermal is not None]
    drifted = [session for session in drifted if not session.assumes("temperature")] or drifted[:1]
    _require_one_set_of_axes(scaled)
    _require_one_order(drifted)
    _require_exact_once(sessions)
    _require_one_mounting(sessions)
    thermals = [session.coefficients.thermal for session in drifted if session.coefficients.thermal is not None]
    bent = [session.coefficients.nonlinearity for session in scaled if session.coefficients.nonlinearity is not None]
    return replace(
        scaled[0].coefficients,
        thermal=_thermal(thermals) if thermals else None,
        nonlinearity=bent[0] if bent else None,
        mounting=next((session.coefficients.mounting for session in sessions if session.coefficients.mounting), None),
    )


def _thermal(thermals: Sequence[Thermal]) -> Thermal:
    """Return temperature terms of the highest orders, at the first one's reference."""
    drift, gain = (
        max((getattr(thermal, what) for thermal in thermals), key=lambda t: t.shape[1]) for what in ("drift", "gain")
    )
    ranges = [thermal.range for thermal in thermals if thermal.range is not None]
    lags = {thermal.lag for thermal in thermals if thermal.lag}
    if len(lags) > 1:
        raise UsageError(
            f"the lags contradict: {' s and '.join(f'{lag:g}' for lag in sorted(lags))} s; combine one of them"
        )
    covered = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
    return replace(thermals[0], range=covered, drift=drift, gain=gain, lag=lags.pop() if lags else 0.0)


def _require_one_set_of_axes(scaled: Sequence[CombinedSession]) -> None:
    first = scaled[0]
    for session in scaled[1:]:
        if set(session.coefficients.axes) != set(first.coefficients.axes):
            raise UsageError(
                f"{first.label} determines the sensitivity to {', '.join(first.coefficients.axes)} and "
                f"{session.label} to {', '.join(session.coefficients.axes)}: an offset of the one is not that of the "
                "other; combine sessions of the same axes"
            )


def _require_one_order(drifted: Sequence[CombinedSession]) -> None:
    for session, other in combinations(drifted, 2):
        for what in ("drift", "gain"):
            orders = [getattr(one.coefficients.thermal, what).shape[1] for one in (session, other)]
            if min(orders) and orders[0] != orders[1]:
                raise UsageError(
                    f"the {what} of {session.label} has order {orders[0]} and that of {other.label} {orders[1]}: a "
                    "polynomial of one order is not weighed against one of another; combine one of them"
                )


def _require_exact_once(sessions: Sequence[CombinedSession]) -> None:
    for session, other in permutations(sessions, 2):
        twice = sorted(session.exact & (set(values(other.coefficients)) - other.assumed))
        if twice:
            raise UsageError(
                f"{session.label} states no uncertainty of {', '.join(twice)}, which {other.label} has too: "
                "it cannot be weighed"
            )


def _require_one_mounting(sessions: Sequence[CombinedSession]) -> None:
    mounted = [session for session in sessions if session.coefficients.mounting is not None]
    for session in mounted[1:]:
        if session.coefficients.mounting != mounted[0].coefficients.mounting:
            mountings = " and ".join(
                f"{s.label} has {mounting_in_words(s.coefficients.mounting)}"
                for s in (mounted[0], session)
                if s.coefficients.mounting is not None
            )
            raise UsageError(f"the mountings contradict: {mountings}; state one with --mounting")


def _assumed(sessions: Sequence[CombinedSession], measured: Sequence[str], target: Coefficients) -> list[Statement]:
    """Return what one session has assumed and no session has measured, as a statement; none where there is nothing."""
    found: list[Statement] = []
    for kind, starts in KINDS.items():
        sources = [session for session in sessions if session.assumes(kind)]
        others = [session for session in sessions if not session.assumes(kind)]
        if sources and not any(kind != "temperature" or session.coefficients.thermal for session in others):
            source = min(sources, key=lambda session: "nominal" in (session.assumes(kind) or ""))
            names = [name for name in source.known.names if name.startswith(starts)]
            found = found or _statements(source, names, measured, target)
    lent = next((session for session in sessions if session.record.fit.priors), None)
    return found if lent is None else found + _statements(lent, lent.record.fit.priors, measured, target)


def _statements(
    source: CombinedSession, names: Collection[str], measured: Sequence[str], target: Coefficients
) -> list[Statement]:
    """Return what a session has assumed of some coefficients and none has measured, as a statement; or nothing."""
    own = source.known.chosen(
        [
            k
            for k, name in enumerate(source.known.names)
            if name in names and name in values(target) and name not in measured
        ]
    )
    if not own.names:
        return []
    return [
        Statement(
            label=ASSUMED,
            names=own.names,
            values=vector_of(source.coefficients, own.names),
            covariance=own.covariance,
            factors=own.factors,
            temperature=None,
            u_temperature=0.0,
            given=(),
            given_values=np.zeros(0),
            by_given=np.zeros((len(own.names), 0)),
        )
    ]


def _require_agreement(sessions: Sequence[CombinedSession], found: Combination) -> None:
    """Refuse sessions that differ by far more than their uncertainty, with a UsageError."""
    contradictions = _contradictions(found, REFUSED)
    if not contradictions:
        return
    alone = [session.label for session in sessions if session.record.fit.uncertainty_from == NOISE_ALONE]
    why = (
        f"the uncertainty of {' and '.join(alone)} leaves out how well positions were set: state the --jig there"
        if alone
        else "one of the sessions is wrong, or the sensor has changed between them"
    )
    lines = [
        "the calibrations contradict by more than their uncertainty:",
        *(f"  {each}" for each in contradictions),
        why,
    ]
    raise UsageError("\n".join(lines))


def _contradictions(found: Combination, confidence: float) -> list[str]:
    """Return each difference at a level of confidence, with its expanded uncertainty (95 %)."""
    changes = [change for _, change in found.differences]
    expanded = judge(changes, among=found.compared).thresholds
    changed = judge(changes, among=found.compared, confidence=confidence).changed
    lines = []
    for label, change in found.differences:
        if change.name in changed and change.u:
            size, limit = abs(change.difference), expanded[change.name] * change.u
            lines.append(
                f"{change.name} is {change.after:.6g} in {label} and {change.before:.6g} by the others, apart by "
                f"{plus_minus(size, limit)} (E_n {size / limit:.1f})"
            )
    return lines
