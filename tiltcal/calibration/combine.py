"""A calibration from several sessions: the positions of all files are fitted again, as those of one session.

Positions of one journal count once. A file without positions that were set enters by its values and their covariance.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import combinations
from math import sqrt
from pathlib import Path

import numpy as np

import tiltcal
from tiltcal.calibration import stated
from tiltcal.calibration.combined_session import KINDS, CombinedSession
from tiltcal.calibration.comparison import compare_records, require_same_sensor
from tiltcal.calibration.record import mounting_in_words, stated_mounting
from tiltcal.core.directions import common, tilts
from tiltcal.core.estimation.equations import BASE
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate, estimate, with_hysteresis
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations
from tiltcal.core.estimation.solve import undetermined
from tiltcal.core.model import AXES, Limits, overlap, referred, values
from tiltcal.core.rounding import plus_minus
from tiltcal.core.samples import pooled
from tiltcal.core.uncertain import NORMAL_FACTOR, TURN, Uncertain, selection
from tiltcal.errors import Argument, EstimateError, Parts, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord, tilt_record
from tiltcal.files.coefficients import Uncertainty
from tiltcal.files.document import parse_document
from tiltcal.files.results import NOISE_ALONE, CompletingRun, FileRecord, ProcedureRecord, Provenance
from tiltcal.files.yaml_text import read_text

REFUSED = 0.001  # sessions are refused where chi-square rises over the separate fits with a probability below this
APART = 0.5  # estimated jig of all sessions above which they contradict, where each alone shows none, degrees


def combine_records(
    calibrations: Iterable[CalibrationRecord | str | Path], mounting: Mapping[str, float] | str
) -> CalibrationRecord:
    """Combine calibrations of one sensor, or their files, in their own mounting or in a stated one, degrees."""
    sessions = _sessions(calibrations)
    turned = stated_mounting(mounting) if mounting else None
    if not sessions or (len(sessions) < 2 and turned is None):
        raise UsageError(("name two calibrations or more, or a ", Argument("mounting")))
    _require_consistent(sessions)
    if turned is not None:
        sessions = [replace(session, record=session.record.with_mounting(turned)) for session in sessions]
    if len(sessions) == 1:
        return replace(sessions[0].record, provenance=_provenance(sessions))
    mounted = {s.label: s.coefficients.mounting for s in sessions if s.coefficients.mounting is not None}
    warm = {s.label: s.coefficients.thermal for s in sessions if s.coefficients.thermal is not None}
    mountings = {label: mounting_in_words(mounting) for label, mounting in mounted.items()}
    _require_one("mountings", mountings, ("state one with ", Argument("mounting")))
    lags = {label: f"{thermal.lag:g} s" for label, thermal in warm.items() if thermal.lag}
    _require_one("lags", lags, ("combine one of them",))
    if warm:
        sessions = [replace(s, by_values=any(one.temperature is None for one in s.positions)) for s in sessions]
    design = _design(sessions)
    if any(session.observed for session in sessions):
        seen = _observations(sessions, design)
        _require_agreement(sessions, design, seen)
        together = [one for group in seen for one in group]
        found = with_hysteresis(estimate(together, design), SensorObservations(design, together))
    else:
        found = _of_values(sessions, design)
    thermal, met = found.coefficients.thermal, [one.range for one in warm.values() if one.range is not None]
    if thermal is not None:
        thermal = replace(thermal, lag=max(one.lag for one in warm.values()), range=_union(met))
    turned = next(iter(mounted.values()), None)
    found = replace(found, coefficients=replace(found.coefficients, thermal=thermal, mounting=turned))
    return _record(sessions, found, design)


def _sessions(calibrations: Iterable[CalibrationRecord | str | Path]) -> list[CombinedSession]:
    """Return calibrations or their files with labels that differ; of those of one journal the first."""
    sessions: list[CombinedSession] = []
    journals: set[str | None] = set()
    for given in calibrations:
        if isinstance(given, CalibrationRecord):
            label, record, text = given.procedure.name or "a calibration", given, given.text
        elif isinstance(given, str | Path):
            label, text = Path(given).name, read_text(given)
            record = tilt_record(parse_document(text, str(given)))
        else:
            raise UsageError(f"combine takes tilt calibrations or their files, not {given!r:.40}")
        if label in {session.label for session in sessions}:
            label = f"{label} ({len(sessions) + 1})"
        journal = None if record.provenance.journal is None else record.provenance.journal.sha256
        if journal is None or journal not in journals:
            sessions.append(CombinedSession(label, hashlib.sha256(text.encode()).hexdigest(), record))
        journals.add(journal)
    return sessions


def _require_consistent(sessions: Sequence[CombinedSession]) -> None:
    """Refuse sessions of several sensors, and measurements that would count twice, with a UsageError."""
    for session, other in combinations(sessions, 2):
        one, another = session.record.sensor, other.record.sensor
        if UNKNOWN_MODEL in (one.model, another.model):
            another = another.replaced(model=one.model)
        require_same_sensor(session.record, replace(other.record, sensor=another), (session.label, other.label))
        if session.sha256 == other.sha256:
            raise UsageError(f"{session.label} and {other.label} are one calibration: name it once")
        if session.origins & other.origins:
            raise UsageError(
                f"{session.label} and {other.label} hold the same measurements, which would count twice: name the "
                "calibrations of the sessions themselves"
            )


def _require_one(what: str, stated: Mapping[str, object], advice: Parts) -> None:
    """Refuse sessions that state more than one mounting or thermal lag, with a UsageError."""
    for label, value in stated.items():
        first = next(iter(stated))
        if value != stated[first]:
            why = f"the {what} contradict: {first} has {stated[first]} and {label} has {value}; "
            raise UsageError((why, *advice))


def _design(sessions: Sequence[CombinedSession]) -> Design:
    """Return the coefficients of all sessions, with what is assumed of those that none has measured."""
    scaled = [s for s in sessions if not s.assumes("sensitivity")]
    scaled = scaled or [min(sessions, key=lambda s: "nominal" in s.assumes("sensitivity"))]
    warm = [s for s in sessions if s.coefficients.thermal is not None]
    warm = [s for s in warm if not s.assumes("temperature")] or warm[:1]
    thermals = [s.coefficients.thermal for s in warm if s.coefficients.thermal is not None]
    fits = [s.record.fit for s in sessions if s.observed]
    if not fits and not any(s.record.fit.distinct_attitudes for s in sessions):
        raise UsageError(
            "no calibration has positions that were set, which would be fitted again: measure one of them with a "
            "procedure that sets its positions"
        )
    bends = [s.coefficients.nonlinearity.shape[1] for s in scaled if s.coefficients.nonlinearity is not None]
    design = Design(
        sessions[0].coefficients.channels,
        tuple(axis for axis in AXES if any(axis in s.coefficients.axes for s in scaled)),
        max((thermal.drift.shape[1] for thermal in thermals), default=0),
        max((thermal.gain.shape[1] for thermal in thermals), default=0),
        max(thermals, key=lambda thermal: thermal.drift.shape[1]).reference if thermals else 0.0,
        max((fit.jig_degrees for fit in fits if fit.jig_degrees is not None), default=None),
        table_lean=max((fit.table_lean_degrees for fit in fits if fit.table_lean_degrees is not None), default=None),
        heading=max((fit.heading_degrees or 0.0 for fit in fits), default=0.0),
        thermometer=max(
            (fit.thermometer_celsius or fit.thermometer_estimated_celsius or 0.0 for fit in fits), default=0.0
        ),
        nonlinearity=max(bends, default=0),
        angles=sessions[0].coefficients.angles,
    )
    measured = {name for session in sessions for name in session.measured}
    priors: dict[str, Prior] = {}
    for session in (*scaled, *warm):
        fit, u = session.record.fit, session.record.uncertainty
        at = values(referred(session.coefficients, design.reference)) | dict.fromkeys(fit.priors, 0.0)
        for name in session.assumed & set(design.names) - measured - set(priors):
            priors[name] = Prior(at[name], fit.priors.get(name, u.get(name, 0.0)))
    design = replace(design, priors={name: priors[name] for name in design.names if name in priors})
    slope = next((thermal.drift[:, 0] for thermal in thermals if thermal.drift.size), np.zeros(len(design.channels)))
    by_values = [session for session in sessions if not session.observed]
    statements = tuple(session.statement(design, slope) for session in by_values)
    exact = dict(design.priors)
    for session, (_, stated_here) in zip(by_values, statements, strict=True):
        for name in sorted((session.measured & set(design.names)) - set(stated_here.names)):
            if name.startswith("offset.") and design.thermal and session.record.temperature is None:
                continue  # it is left out
            if any(name in other.measured for other in sessions if other is not session):
                raise UsageError(
                    f"{session.label} states no uncertainty of {name}, which another has: it cannot be weighed"
                )
            exact[name] = Prior(values(session.coefficients)[name])
    return replace(design, priors=exact, stated=statements)


def _of_values(sessions: Sequence[CombinedSession], design: Design) -> Estimate:
    """Return what files state together, none of which has positions that were set, by generalised least squares."""
    from scipy.linalg import block_diag
    from scipy.special import chdtrc

    held = {name: prior.value for name, prior in design.priors.items()}
    known = np.array([held.get(name, 0.0) for name in design.names])
    wanted = np.array([name not in held for name in design.names])
    rows = np.vstack([each for each, _ in design.stated])
    # Over their uncertainty, independent.
    whiten = np.linalg.inv(np.linalg.cholesky(block_diag(*(one.covariance for _, one in design.stated))))
    target, jacobian = whiten @ (np.concatenate([one.value for _, one in design.stated]) - rows @ known), whiten @ rows
    names = [name for name, free in zip(design.names, wanted, strict=True) if free]
    if mixed := undetermined(jacobian[:, wanted], names):
        raise EstimateError(f"the calibrations together leave {', '.join(mixed[:4])} undetermined")
    theta, covariance = known.copy(), np.zeros((len(known), len(known)))
    theta[wanted] = np.linalg.lstsq(jacobian[:, wanted], target, rcond=None)[0]
    covariance[np.ix_(wanted, wanted)] = np.linalg.inv(jacobian[:, wanted].T @ jacobian[:, wanted])
    for k, name in enumerate(design.names):
        covariance[k, k] += design.priors[name].u ** 2 if name in held else 0.0
    dof, rise = len(target) - len(names), float(np.sum((target - jacobian[:, wanted] @ theta[wanted]) ** 2))
    p = float(chdtrc(dof, rise)) if dof else None
    if p is not None and p < REFUSED:
        raise _contradiction(sessions, rise, dof)
    positions = tuple(s.named(name) for s in sessions for name in s.record.fit.residuals)
    each = [[row[c] for c in design.channels] for s in sessions for row in s.record.fit.residuals.values()]
    return Estimate(
        coefficients=SensorObservations(design, ()).coefficients(theta),
        uncertain=Uncertain.errors(design.names, covariance, source=BASE),
        positions=positions,
        residuals=np.array(each),
        dof=dof,
        chi_square=rise,
        p=p,
        stated=True,
    )


def _observations(sessions: Sequence[CombinedSession], design: Design) -> list[list[Observation]]:
    """Return the positions of each session that has such, their noise made better known by that of all."""
    groups = [session.observations(design) for session in sessions if session.observed]
    every = [one for group in groups for one in group]
    u, freedom = (np.array([getattr(one, name) for one in every], dtype=float) for name in ("u", "dof"))
    for k in range(len(design.channels)):
        u[:, k], freedom[:, k] = pooled(u[:, k] ** 2, freedom[:, k])
    better = iter([replace(one, u=np.sqrt(row), dof=dof) for one, row, dof in zip(every, u, freedom, strict=True)])
    return [[next(better) for _ in group] for group in groups]


def _notes(sessions: Sequence[CombinedSession], design: Design) -> Iterator[str]:
    for session in sessions:
        if design.thermal and session.record.temperature is None:
            yield f"{session.label} states no temperature: its offset is left out"
        elif session.observed and session.jig is None and design.jig is not None:
            unsaid = f"{session.label} does not state how level it was (--jig)"
            yield f"{unsaid}: its drift is used; its offset gets almost no weight"


def _require_agreement(
    sessions: Sequence[CombinedSession], design: Design, seen: Sequence[Sequence[Observation]]
) -> None:
    """Refuse sessions whose chi-square rises over that of the separate fits by more than chance, with a UsageError."""
    from scipy.special import chdtrc, fdtrc

    jig, observed = design.jig, [session for session in sessions if session.observed]
    every, designs = [one for group in seen for one in group], [_design([session]) for session in observed]
    # Residuals that the priors of a data sheet can take up show no jig.
    left = [len(group) * len(own.channels) - len(own.names) for group, own in zip(seen, designs, strict=True)]
    free, apart = sum(max(count, 0) for count in left), False
    if jig is None:
        shown = [(session.jig or 0.0, session.record.fit.degrees_of_freedom or 0) for session in observed]
        jig = sqrt(sum(count * size**2 for size, count in shown) / max(sum(count for _, count in shown), 1))
        if not free and any(count for _, count in shown):
            jig = estimate(every, design).estimated_jig or 0.0
            apart = jig > APART
    try:
        together = estimate(every, replace(design, jig=jig))
    except EstimateError as failure:
        raise EstimateError(("the calibrations, fitted together: ", *failure.words)) from failure
    bench = {name: getattr(design, name) for name in ("table_lean", "heading", "reference", "thermometer")}
    alone = [estimate(group, replace(own, jig=jig, **bench)) for group, own in zip(seen, designs, strict=True)]
    dof, chi_square = sum(one.dof for one in alone), sum(one.chi_square or 0.0 for one in alone)
    rise, more = (together.chi_square or 0.0) - chi_square, together.dof - dof
    if not apart:
        shared = design.jig is None and free > 0  # the jig is known from what the separate fits leave
        ratio = rise / max(more, 1) * free / max(chi_square, 1e-9)
        if more <= 0 or rise <= 0.0 or (fdtrc(more, free, ratio) if shared else chdtrc(more, rise)) >= REFUSED:
            return
    raise _contradiction(sessions, rise, more)


def _contradiction(sessions: Sequence[CombinedSession], rise: float, more: int) -> UsageError:
    """Return the refusal of sessions by what they differ in, or by the rise of chi-square."""
    unstated = [session.label for session in sessions if session.record.fit.uncertainty_from == NOISE_ALONE]
    why: Parts = ("one of the sessions is wrong, or the sensor has changed between them",)
    if unstated:
        which = f"the uncertainty of {' and '.join(unstated)} leaves out how well positions were set"
        why = (f"{which}: state the ", Argument("jig"), " there")
    lines = [f"  {line}" for line in _differences(sessions)]
    risen = f"  chi-square rises by {rise:.3g} over the separate fits, with {more} degrees of freedom"
    what = "the calibrations contradict by more than their uncertainty:"
    return UsageError(("\n".join([what, *(lines or [risen]), ""]), *why))


def _differences(sessions: Sequence[CombinedSession]) -> Iterator[str]:
    """Yield what two sessions have measured and differ in by more than the expanded uncertainty of the difference."""
    for one, other in combinations(sessions, 2):
        record = replace(other.record, sensor=one.record.sensor)
        for change in compare_records(one.record, record).changes:
            limit = NORMAL_FACTOR * (change.u or 0.0)
            apart = abs(change.difference)
            if change.name in one.measured & other.measured and apart > limit > 0.0:
                yield (
                    f"{change.name} is {change.before:.6g} in {one.label} and {change.after:.6g} in {other.label}, "
                    f"apart by {plus_minus(apart, limit)} (E_n {apart / limit:.1f})"
                )


def _record(sessions: Sequence[CombinedSession], found: Estimate, design: Design) -> CalibrationRecord:
    """Return the calibration that a combination gives, with remarks on what it left out."""
    records = [session.record for session in sessions]
    fits = [record.fit for record in records]
    scaled = [session.record for session in sessions if not session.assumes("sensitivity")]
    own, mounted, levelled = (
        [one.replaced(position=s.named(one.position)) for s in sessions for one in s.record.runs[k]] for k in range(3)
    )
    runs = (CompletingRun(positions=tuple(one.position for one in run)) if run else None for run in (mounted, levelled))
    derived = stated.derived_record(found, "", mounted=True) if scaled else records[0].derived
    kept = [sessions[0].assumes(kind) for kind in KINDS if all(session.assumes(kind) for session in sessions)]
    noise = max(u for record in records for one in record.positions for u in (one.u or {}).values())
    notes = [*_notes(sessions, design), *found.notes]
    notes += [note for fit in fits for note in fit.notes if note != NO_FREEDOM]
    return CalibrationRecord(
        sensor=next((record.sensor for record in records if record.sensor.model != UNKNOWN_MODEL), records[0].sensor),
        coefficients=replace(stated.rounded(found), mounting=found.coefficients.mounting),
        uncertainty=_uncertainty(sessions, found),
        limits=_limits(records, scaled or records),
        derived=derived.replaced(assumed=tuple(kept)),
        fit=stated.fit_record(found, design, noise).replaced(
            notes=tuple(dict.fromkeys(notes)),
            priors={name: prior.u for name, prior in design.priors.items() if any(name in fit.priors for fit in fits)},
            not_covered=tuple(dict.fromkeys(error for fit in fits for error in fit.not_covered)),
            mounting=next((fit.mounting for fit in fits if fit.mounting), None),
            level=next((fit.level for fit in fits if fit.level), None),
            **({} if any(s.observed for s in sessions) else {"uncertainty_from": "stated by the calibrations"}),
        ),
        procedure=ProcedureRecord(
            name=" + ".join(session.record.procedure.name or session.label for session in sessions),
            title=f"Combined of {len(sessions)} calibrations",
            set={s.named(name): place for s in sessions for name, place in s.record.procedure.set.items()},
            mounting=next(runs),
            level=next(runs),
        ),
        positions=(*own, *mounted, *levelled),
        provenance=_provenance(sessions),
    )


def _uncertainty(sessions: Sequence[CombinedSession], found: Estimate) -> Uncertainty:
    """Return the uncertainty of all coefficients, and that of a mounting with its covariance."""
    each, joint = [session.record.uncertainty for session in sessions], found.uncertain
    mounted = max(sessions, key=lambda session: session.coefficients.mounting is not None).record
    angles, factors = (
        {name: value for name, value in its.items() if name.startswith("mounting.")}
        for its in (mounted.uncertainty, mounted.uncertainty.coverage_factor)
    )
    names = dict.fromkeys(name for one in each for name in one.single_reading)
    single = {name: max(one.single_reading.get(name, 0.0) for one in each) for name in names}
    kept = Uncertainty(angles, single, coverage_factor=factors, alignment=max(one.alignment for one in each))
    before = mounted.uncertain
    if turns := [name for name in before.names if name.startswith(TURN)]:
        # What follows the coefficients of its own session follows those of the combination by as much.
        shared = [name for name, u in before.by_name(before.u).items() if name in joint.names and u > 0.0]
        follows = selection(turns, before.names) @ before.following(shared) @ selection(shared, joint.names)
        size, across = len(joint.names), follows @ joint.covariance
        joint = joint.beside(before.named(turns))
        for matrix in (joint.covariance, joint.wide):
            matrix[size:, :size], matrix[:size, size:] = across, across.T
    return stated.stated_section(joint, kept)


def _limits(records: Sequence[CalibrationRecord], scaled: Sequence[CalibrationRecord]) -> Limits:
    """Return the tilts that are inside for all that measured the sensitivity, °C of the drift, the rails of all."""
    reading: dict[str, tuple[float, float]] = {}
    for channel, rails in (pair for record in records for pair in record.limits.reading.items()):
        reading[channel] = low, high = overlap(rails, reading.get(channel)) or rails
        if not low < high:
            raise EstimateError(
                f"limits.reading.{channel}: the calibrations have no readings in common: they are not of one sensor in "
                "one range; correct the limits, or leave one out"
            )
    met = [record.limits.temperature for record in records if record.limits.temperature and record.coefficients.thermal]
    directions = [record.limits.directions for record in scaled if record.limits.directions is not None]
    if directions:
        inside = common(directions)
        return Limits(tilts(inside), _union(met), reading, directions=inside)
    both = {axis: reduce(overlap, (record.limits.tilt.get(axis) for record in scaled)) for axis in AXES}
    return Limits({axis: tilt for axis, tilt in both.items() if tilt is not None}, _union(met), reading)


def _union(ranges: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    return (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None


def _provenance(sessions: Sequence[CombinedSession]) -> Provenance:
    """Return where the calibrations come from, with their SHA-256."""
    each = [session.record.provenance for session in sessions]
    made = dict.fromkeys(provenance.made_by for provenance in each if provenance.made_by)
    return Provenance(
        made_by=f"combination of calibrations by {' and '.join(made)}" if made else "combination of calibrations",
        operator=" and ".join(dict.fromkeys(provenance.operator for provenance in each if provenance.operator)) or None,
        sources=tuple(FileRecord(name=session.label, sha256=session.sha256) for session in sessions),
        software=f"tiltcal {tiltcal.__version__}",
        started=min((provenance.started for provenance in each if provenance.started), default=None),
        ended=max((provenance.ended for provenance in each if provenance.ended), default=None),
    )
