"""The calibration file of a combination: what it states of its sessions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import tiltcal
from tiltcal.calibration.combined_session import KINDS, CombinedSession
from tiltcal.calibration.estimate_record import (
    derived_record,
    fit_record,
    rounded,
    rounded_covariance,
    stated_section,
)
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate
from tiltcal.core.estimation.positions import Design
from tiltcal.core.model import Limits
from tiltcal.core.uncertain import TURN, selection
from tiltcal.errors import InputError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord
from tiltcal.files.results import FileRecord, FitRecord, PositionRecord, ProcedureRecord, Provenance
from tiltcal.files.uncertainty import Uncertainty, uncertain_coefficients


def combined_record(
    sessions: Sequence[CombinedSession], found: Estimate, design: Design, remarks: Sequence[str]
) -> CalibrationRecord:
    """Return the calibration that a combination gives, with remarks on what it left out."""
    records = [session.record for session in sessions]
    scaled = [session for session in sessions if not session.assumes("sensitivity")]
    positions, renamed = _positions(sessions)
    sensor = next((record.sensor for record in records if record.sensor.model != UNKNOWN_MODEL), records[0].sensor)
    derived = derived_record(found, "", mounted=True) if scaled else records[0].derived
    kept = tuple(
        sessions[0].assumes(kind) or "" for kind in KINDS if all(session.assumes(kind) for session in sessions)
    )
    return CalibrationRecord(
        sensor=sensor,
        coefficients=replace(rounded(found), mounting=found.coefficients.mounting),
        uncertainty=_uncertainty(sessions, found),
        limits=_limits(records, [session.record for session in scaled] or records),
        derived=derived.replaced(assumed=kept),
        fit=_fit(sessions, found, design, renamed, remarks),
        procedure=_procedure(sessions, renamed),
        positions=positions,
        provenance=combined_provenance(sessions),
    )


def _fit(
    sessions: Sequence[CombinedSession],
    found: Estimate,
    design: Design,
    renamed: Mapping[tuple[int, str], str],
    remarks: Sequence[str],
) -> FitRecord:
    """Return how well the positions of all sessions agree, by their new names."""
    fits = [session.record.fit for session in sessions]
    names = {f"{sessions[n].label}/{name}": new for (n, name), new in renamed.items()}
    suspects = [replace(attitude, position=names[attitude.position]) for attitude in found.attitudes]
    found = replace(found, positions=tuple(names[position] for position in found.positions), attitudes=tuple(suspects))
    noise = max(
        u for record in (s.record for s in sessions) for one in record.positions for u in (one.u or {}).values()
    )
    told = [f"combined of {' and '.join(map(_told, sessions))}", *remarks]
    notes = [note for fit in fits for note in fit.notes if note != NO_FREEDOM]
    return fit_record(found, design, noise).replaced(
        notes=tuple(dict.fromkeys([*told, *found.notes, *notes])),
        priors={name: prior.u for name, prior in design.priors.items() if any(name in fit.priors for fit in fits)},
        not_covered=tuple(dict.fromkeys(error for fit in fits for error in fit.not_covered)),
        mounting=next((fit.mounting for fit in fits if fit.mounting), None),
        level=next((fit.level for fit in fits if fit.level), None),
    )


def _procedure(sessions: Sequence[CombinedSession], renamed: Mapping[tuple[int, str], str]) -> ProcedureRecord:
    """Return what was set in all sessions."""
    each = [session.record.procedure for session in sessions]
    return ProcedureRecord(
        name=" + ".join(session.record.procedure.name or session.label for session in sessions),
        title=f"Combined of {len(sessions)} calibrations",
        set={
            renamed[n, name]: position
            for n, procedure in enumerate(each)
            for name, position in procedure.set.items()
            if (n, name) in renamed
        },
        mounting=next((procedure.mounting for procedure in each if procedure.mounting), None),
        level=next((procedure.level for procedure in each if procedure.level), None),
    )


def _told(session: CombinedSession) -> str:
    name, ended = session.record.procedure.name, session.record.provenance.ended
    more = ", ".join(filter(None, (name, ended and ended[:10])))
    return f"{session.label} ({more})" if more else session.label


def _positions(sessions: Sequence[CombinedSession]) -> tuple[tuple[PositionRecord, ...], dict[tuple[int, str], str]]:
    """Return all positions, and the name that each has now by the number of its session and its name there."""
    records = [(n, session.record) for n, session in enumerate(sessions) if not session.counted]
    every = [(n, position.position) for n, record in records for position in record.positions]
    every += [(n, name) for n, record in records for name in record.procedure.set]
    every = list(dict.fromkeys(every))
    count = [name for _, name in every]
    renamed = {
        (n, name): name if count.count(name) == 1 else f"{Path(sessions[n].label).stem}/{name}" for n, name in every
    }
    groups: list[list[PositionRecord]] = [[], [], []]
    for n, record in records:
        for group, own in zip(groups, record.runs, strict=True):
            group += [position.replaced(position=renamed[n, position.position]) for position in own]
    return tuple(position for group in groups for position in group), renamed


def _uncertainty(sessions: Sequence[CombinedSession], found: Estimate) -> Uncertainty:
    """Return the uncertainty of all coefficients, and that of a mounting with its covariance."""
    single: dict[str, float] = {}
    for session in sessions:
        for name, u in session.record.uncertainty.single_reading.items():
            single[name] = max(u, single.get(name, 0.0))
    alignment = max(session.record.uncertainty.alignment for session in sessions)
    both = replace(stated_section(found.uncertain), single_reading=single, alignment=alignment)
    mounted = next((session.record for session in sessions if session.coefficients.mounting), sessions[0].record)
    before = uncertain_coefficients(mounted.uncertainty, mounted.coefficients)
    turns = [name for name in before.names if name.startswith(TURN)]
    if not turns:
        return both
    # What follows the coefficients of its own session follows those of the combination by as much.
    every = found.uncertain
    shared = [name for name, u in before.by_name(before.u).items() if name in every.names and u > 0.0]
    follows = selection(turns, before.names) @ before.following(shared)
    across = every.covariance @ selection(shared, every.names).T @ follows.T
    turned = before.named(turns)
    covariance, wide = (
        np.block([[of_coefficients, across], [across.T, of_turn]])
        for of_coefficients, of_turn in ((every.covariance, turned.covariance), (every.wide, turned.wide))
    )
    joint = replace(every.beside(turned), covariance=covariance, wide=wide)
    angles, factors = (
        {name: value for name, value in named.items() if name.startswith("mounting.")}
        for named in (mounted.uncertainty, mounted.uncertainty.coverage_factor)
    )
    return replace(
        both,
        standard={**both.standard, **angles},
        coverage_factor={**both.coverage_factor, **factors},
        covariance=rounded_covariance(joint),
    )


def _limits(records: Sequence[CalibrationRecord], scaled: Sequence[CalibrationRecord]) -> Limits:
    """Return the tilts that the sensitivity was measured in, the temperatures of the drift, the rails of all."""
    tilt: dict[str, tuple[float, float]] = {}
    reading: dict[str, tuple[float, float]] = {}
    for session in scaled:
        for axis, (low, high) in session.limits.tilt.items():
            before = tilt.get(axis, (low, high))
            tilt[axis] = min(low, before[0]), max(high, before[1])
    for record in records:
        for channel, (low, high) in record.limits.reading.items():
            before = reading.get(channel, (low, high))
            reading[channel] = max(low, before[0]), min(high, before[1])
            if not reading[channel][0] < reading[channel][1]:
                raise InputError(
                    f"limits.reading.{channel}: [{low:g}, {high:g}] and [{before[0]:g}, {before[1]:g}] do not overlap: "
                    "the sessions are not of one sensor in one range; correct the limits, or leave a session out"
                )
    met = [record.limits.temperature for record in records if record.limits.temperature and record.coefficients.thermal]
    return Limits(tilt, (min(low for low, _ in met), max(high for _, high in met)) if met else None, reading)


def combined_provenance(sessions: Sequence[CombinedSession]) -> Provenance:
    """Return where the calibrations come from, with their SHA-256."""
    each = [session.record.provenance for session in sessions]
    started, ended = (
        [t for t in times if t]
        for times in zip(*((provenance.started, provenance.ended) for provenance in each), strict=True)
    )
    made = dict.fromkeys(provenance.made_by for provenance in each if provenance.made_by)
    return Provenance(
        made_by=f"combination of calibrations by {' and '.join(made)}" if made else "combination of calibrations",
        operator=" and ".join(dict.fromkeys(provenance.operator for provenance in each if provenance.operator)) or None,
        sources=tuple(FileRecord(name=session.label, sha256=session.sha256) for session in sessions),
        software=f"tiltcal {tiltcal.__version__}",
        started=min(started) if started else None,
        ended=max(ended) if ended else None,
    )
