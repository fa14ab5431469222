"""A calibration from several sessions: the positions of all files are fitted again, as those of one session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import sqrt
from pathlib import Path

import numpy as np

from tiltcal.calibration.combined_record import combined_provenance, combined_record
from tiltcal.calibration.combined_session import CombinedSession
from tiltcal.calibration.record import mounting_in_words, stated_mounting, with_mounting
from tiltcal.core.estimation.estimate import Estimate, estimate
from tiltcal.core.estimation.hysteresis import with_hysteresis
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations
from tiltcal.core.model import AXES, Thermal, polynomial
from tiltcal.core.named_coefficients import referred, values
from tiltcal.core.rounding import plus_minus
from tiltcal.core.samples import pooled
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord, require_same_sensor
from tiltcal.files.results import NOISE_ALONE

REFUSED, NOTED = 0.001, 0.05
"""Probabilities of a rise of chi-square over the separate fits below which sessions are refused, and it is noted."""

MOSTLY = 0.9
"""The others check a coefficient of a session where they leave less than this share of its uncertainty."""


def combine_records(
    calibrations: Iterable[CalibrationRecord | str | Path], mounting: Mapping[str, float] | str = ""
) -> CalibrationRecord:
    """Combine calibrations of one sensor, or their files, in their own mounting or in a stated one, degrees.

    UsageError: they are not of one sensor, or contradict each other.
    EstimateError: a calibration states no uncertainty, or together they determine no sensor.
    """
    sessions = _named([CombinedSession.of(calibration) for calibration in calibrations])
    stated = stated_mounting(mounting) if mounting else None
    if not sessions or (len(sessions) < 2 and stated is None):
        raise UsageError("name two calibrations or more, or a --mounting")
    _require_one_sensor(sessions)
    _require_independent(sessions)
    if stated is not None:
        sessions = [replace(session, record=with_mounting(session.record, stated)) for session in sessions]
    if len(sessions) == 1:
        return replace(sessions[0].record, provenance=combined_provenance(sessions))
    _require_one_mounting(sessions)
    if any(session.coefficients.thermal is not None for session in sessions):
        cold = [any(one.temperature is None for one in session.positions) for session in sessions]
        sessions = [replace(session, by_values=lacks) for session, lacks in zip(sessions, cold, strict=True)]
    design = _design(sessions)
    observations = _observations(sessions, design)
    remarks = [*_notes(sessions, design), *_disagreement(sessions, design, observations)]
    found = with_hysteresis(estimate(observations, design), SensorObservations(design, observations))
    lag = design.thermal and max(s.coefficients.thermal.lag for s in sessions if s.coefficients.thermal)
    coefficients = found.coefficients
    thermal = coefficients.thermal and replace(coefficients.thermal, lag=float(lag), range=_covered(sessions))
    mountings = [session.coefficients.mounting for session in sessions if session.coefficients.mounting]
    found = replace(
        found, coefficients=replace(coefficients, thermal=thermal, mounting=mountings[0] if mountings else None)
    )
    return combined_record(sessions, found, design, remarks)


def _named(sessions: Sequence[CombinedSession]) -> list[CombinedSession]:
    """Return the sessions with labels that differ; a journal that came before is marked as counted."""
    labels, journals = [session.label for session in sessions], [session.journal for session in sessions]
    return [
        replace(
            session,
            label=session.label if labels.count(session.label) == 1 else f"{session.label} ({number})",
            counted=session.journal is not None and session.journal in journals[: number - 1],
        )
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
        if not other.counted and session.origins & other.origins:
            raise UsageError(
                f"{session.label} and {other.label} hold the same measurements, which would count twice: name the "
                "calibrations of the sessions themselves"
            )


def _require_one_mounting(sessions: Sequence[CombinedSession]) -> None:
    mounted = [(s.label, s.coefficients.mounting) for s in sessions if s.coefficients.mounting is not None]
    for label, mounting in mounted[1:]:
        if mounting != mounted[0][1]:
            mountings = f"{mounted[0][0]} has {mounting_in_words(mounted[0][1])} and {label} has"
            raise UsageError(
                f"the mountings contradict: {mountings} {mounting_in_words(mounting)}; state one with --mounting"
            )


def _design(sessions: Sequence[CombinedSession]) -> Design:
    """Return the coefficients of all sessions, with what is assumed of those that none has measured."""
    scaled = [s for s in sessions if not s.assumes("sensitivity")]
    scaled = scaled or [min(sessions, key=lambda s: "nominal" in (s.assumes("sensitivity") or ""))]
    warm = [s for s in sessions if s.coefficients.thermal is not None]
    warm = [s for s in warm if not s.assumes("temperature")] or warm[:1]
    thermals = [s.coefficients.thermal for s in warm if s.coefficients.thermal is not None]
    _require_one_lag(thermals)
    fits = [s.record.fit for s in sessions if s.observed]
    if not fits:
        raise UsageError(
            "no calibration has positions that were set, which would be fitted again: measure one of them with a "
            "procedure that sets its positions"
        )
    thermometers = [fit.thermometer_celsius or fit.thermometer_estimated_celsius or 0.0 for fit in fits]
    jigs = [fit.jig_degrees for fit in fits if fit.jig_degrees is not None]
    tables = [fit.table_degrees for fit in fits if fit.table_degrees is not None]
    bent = [s.coefficients.nonlinearity.shape[1] for s in scaled if s.coefficients.nonlinearity is not None]
    design = Design(
        sessions[0].coefficients.channels,
        tuple(axis for axis in AXES if any(axis in s.coefficients.axes for s in scaled)),
        max((thermal.drift.shape[1] for thermal in thermals), default=0),
        max((thermal.gain.shape[1] for thermal in thermals), default=0),
        thermals[0].reference if thermals else 0.0,
        max(jigs) if jigs else None,
        table=max(tables) if tables else None,
        heading=max(fit.heading_degrees or 0.0 for fit in fits),
        thermometer=max(thermometers),
        nonlinearity=max(bent, default=0),
    )
    measured = {name for session in sessions for name in session.measured}
    priors: dict[str, Prior] = {}
    for session in (*scaled, *warm):
        lent = {name: session.record.uncertainty.get(name, 0.0) for name in session.assumed}
        lent |= session.record.fit.priors
        at = values(referred(session.coefficients, design.reference)) | dict.fromkeys(session.record.fit.priors, 0.0)
        priors = {name: Prior(at[name], u) for name, u in lent.items()} | priors
    priors = {name: prior for name, prior in priors.items() if name in design.names and name not in measured}
    by_values = [session for session in sessions if not (session.observed or session.counted)]
    slope = next((thermal.drift[:, 0] for thermal in thermals if thermal.drift.size), np.zeros(len(design.channels)))
    stated = tuple(session.statement(replace(design, priors=priors), slope) for session in by_values)
    for session in by_values:
        for name in sorted(session.exact & set(design.names)):
            if any(name in other.measured for other in sessions if other is not session):
                raise UsageError(
                    f"{session.label} states no uncertainty of {name}, which another has: it cannot be weighed"
                )
            priors[name] = Prior(values(session.coefficients)[name])
    return replace(design, priors=priors, stated=stated)


def _require_one_lag(thermals: Sequence[Thermal]) -> None:
    lags = sorted({thermal.lag for thermal in thermals if thermal.lag})
    if len(lags) > 1:
        raise UsageError(f"the lags contradict: {' s and '.join(f'{lag:g}' for lag in lags)} s; combine one of them")


def _covered(sessions: Sequence[CombinedSession]) -> tuple[float, float] | None:
    """Return the temperatures that the drifts of all sessions cover, °C."""
    ranges = [s.coefficients.thermal.range for s in sessions if s.coefficients.thermal is not None]
    met = [covered for covered in ranges if covered is not None]
    return (min(low for low, _ in met), max(high for _, high in met)) if met else None


def _observations(sessions: Sequence[CombinedSession], design: Design) -> list[Observation]:
    """Return the positions of all sessions, each session's noise made better known by that of the others."""
    seen = [one for s in sessions if s.observed for one in s.observations(design)]
    u, freedom = (np.array([getattr(one, name) for one in seen], dtype=float) for name in ("u", "dof"))
    for k in range(len(design.channels)):
        u[:, k], freedom[:, k] = pooled(u[:, k] ** 2, freedom[:, k])
    return [replace(one, u=np.sqrt(row), dof=dof) for one, row, dof in zip(seen, u, freedom, strict=True)]


def _notes(sessions: Sequence[CombinedSession], design: Design) -> Iterator[str]:
    for session in sessions:
        if session.counted:
            yield f"{session.label} has the journal of another calibration: its positions count once"
        elif design.thermal and session.temperature is None:
            yield f"{session.label} states no temperature: its offset is left out"
        elif session.observed and session.jig is None and design.jig is not None:
            yield f"{session.label} does not state how level it was (--jig): its offset hardly counts"


def _disagreement(sessions: Sequence[CombinedSession], design: Design, seen: Sequence[Observation]) -> list[str]:
    """Return what to note of a rise of chi-square over the separate fits; a large one is refused with a UsageError."""
    from scipy.special import chdtrc, fdtrc

    jig, observed = design.jig, [session for session in sessions if session.observed]
    if jig is None:
        shown = [(session.jig or 0.0, session.record.fit.degrees_of_freedom or 0) for session in observed]
        jig = sqrt(sum(count * size**2 for size, count in shown) / max(sum(count for _, count in shown), 1))
    try:
        together, alone = estimate(seen, replace(design, jig=jig)), []
    except EstimateError as failure:
        raise EstimateError(f"the calibrations, fitted together: {failure}") from failure
    for session in observed:
        own = replace(_design([session]), jig=jig, table=design.table, heading=design.heading)
        own = replace(own, reference=design.reference, thermometer=design.thermometer)
        alone.append(estimate([one for one in seen if one.position.startswith(f"{session.label}/")], own))
    dof, chi_square = sum(one.dof for one in alone), sum(one.chi_square or 0.0 for one in alone)
    rise, more = (together.chi_square or 0.0) - chi_square, together.dof - dof
    if more <= 0 or rise <= 0.0:
        return []
    shared = design.jig is None and dof > 0  # the jig is known from what the separate fits leave
    p = float(fdtrc(more, dof, rise / more * dof / max(chi_square, 1e-9)) if shared else chdtrc(more, rise))
    if p >= NOTED:
        return []
    count = Counter(name for session in sessions for name in session.measured)
    common = {name for name, times in count.items() if times > 1}
    differing = [pair for one in zip(observed, alone, strict=True) for pair in _differences(*one, together, common)]
    lines = list(dict(reversed(differing)).values()) or [
        f"chi-square rises by {rise:.3g} over the separate fits, with {more} degrees of freedom"
    ]
    if p >= REFUSED:
        return [f"{line}; sessions that agree differ by so much once in 20 combinations" for line in lines]
    unstated = [session.label for session in sessions if session.record.fit.uncertainty_from == NOISE_ALONE]
    why = (
        f"the uncertainty of {' and '.join(unstated)} leaves out how well positions were set: state the --jig there"
        if unstated
        else "one of the sessions is wrong, or the sensor has changed between them"
    )
    what = "the calibrations contradict by more than their uncertainty:"
    raise UsageError("\n".join([what, *(f"  {line}" for line in lines), why]))


def _differences(
    session: CombinedSession, alone: Estimate, together: Estimate, common: Collection[str]
) -> Iterator[tuple[str, str]]:
    """Yield what a session differs in from the others by more than the expanded uncertainty of the difference."""
    own, u_own = values(alone.coefficients), alone.uncertainty()
    every, u_every = values(together.coefficients), together.uncertainty()
    thermal, level = together.coefficients.thermal, session.temperature
    for name in every:
        if name not in session.measured or name not in common or not u_every[name] < u_own[name] * MOSTLY:
            continue
        value, share = own[name], (u_every[name] / u_own[name]) ** 2
        if name.startswith("offset.") and alone.coefficients.thermal is None and thermal is not None:
            if level is None:
                continue
            row = thermal.drift[together.coefficients.channels.index(name.split(".")[1])]
            value -= float(polynomial(row, np.array(level[0] - thermal.reference)))
        others = (every[name] - share * value) / (1.0 - share)
        limit = NORMAL_FACTOR * u_own[name] / sqrt(1.0 - share)
        if abs(value - others) > limit:
            apart = plus_minus(abs(value - others), limit)
            yield (
                name,
                f"{name} is {value:.6g} in {session.label} and {others:.6g} by the others, apart by {apart} "
                f"(E_n {abs(value - others) / limit:.1f})",
            )
