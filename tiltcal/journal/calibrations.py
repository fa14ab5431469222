"""A calibration as a function of a journal: its accepted positions, fitted.

``measure`` ends here, and so do ``replay`` and ``--resume``, so they agree by construction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.moments import stamp
from tiltcal.files.pair import PairRecord
from tiltcal.files.procedure import Rotation
from tiltcal.files.results import (
    VIRTUAL,
    BenchRecord,
    BenchSensorRecord,
    FileRecord,
    PairProvenance,
    Provenance,
    SamplesRecord,
)
from tiltcal.journal.reference import compared, uncertainty_with
from tiltcal.journal.session import RecordedSession


def calibrations_of(session: RecordedSession) -> dict[str, CalibrationRecord | PairRecord]:
    """Return the calibrations of a session by serial number, be it about to end; none of a verification.

    That of all pairs of a stage stands by its first device.

    JournalError: the session is not complete.
    EstimateError: the positions cannot determine the coefficients.
    """
    setup = session.setup
    if not session.complete:
        raise session.interrupted()
    statistics = session.playback.link_statistics()
    provenance = {
        "made_by": VIRTUAL if setup.simulated else "measurement",
        "operator": setup.person or setup.operator,
        "software": setup.software,
        "started": stamp(setup.began),
        "ended": setup.stamp_after(session.playback.now_ns),
        "journal": FileRecord(name=setup.journal, sha256=session.journal.sha256),
        "references": setup.references,
    }
    if isinstance(setup.steps, Rotation):
        return {setup.sensors[0].serial: _pair_calibration(session, provenance, statistics)}
    return {} if setup.verifies else {**_tilt_calibrations(session, provenance, statistics)}


def texts_of(calibrations: Mapping[str, CalibrationRecord | PairRecord]) -> dict[str, str]:
    """Return the texts of calibration files, by serial number."""
    return {serial: record.text for serial, record in calibrations.items()}


def fitted(session: RecordedSession) -> list[CalibrationRecord]:
    """Return the calibration of each sensor that was not given up, without its provenance.

    EstimateError: the positions cannot determine the coefficients; WrongPositions where some contradict the others.
    """
    from tiltcal.calibration.calibrate import calibrate
    from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor

    setup, settings, accepted, ramps = session.setup, session.setup.settings, session.results(), session.ramp_records()
    # The steps of the sensors' own thermometers count where those are the only ones.
    own_thermometers = setup.thermometer is None and not any(result.typed for result in accepted)
    return calibrate(
        [
            MeasuredSensor(
                SensorIdentity(
                    sensor.model, sensor.serial, sensor.wired.unit, sensor.wired.channels, angles=sensor.wired.angles
                ),
                [result.measurements[sensor.serial] for result in accepted],
                sensor.wired,
                sensor.orientation.matrix,
                sensor.wired.thermometer_rounding if own_thermometers else 0.0,
                base.calibration if (base := setup.bases.get(sensor.serial)) else None,
                ramps.get(sensor.serial),
            )
            for sensor in session.at_work
        ],
        setup.steps.in_positions(),
        uncertainty_with(
            setup.reference, BenchUncertainty(settings.jig, settings.thermometer, settings.table_lean, settings.heading)
        ),
        typical_temperature=setup.typical_temperature,
        angles=settings.angles,
        settings={"samples": settings.samples, "settle_seconds": settings.settle},
    )


def _tilt_calibrations(
    session: RecordedSession, provenance: Mapping[str, Any], statistics: Mapping[str, dict[str, int]]
) -> dict[str, CalibrationRecord]:
    """Return the calibration of each sensor that was not given up, by its serial number."""
    from tiltcal.calibration.wording import NOTHING_FOLLOWED, quiet_note

    setup, records, calibrations = session.setup, fitted(session), {}
    quiet = session.spans.quiet_channels(setup.steps.positions)
    turned = len({(one.gravity, one.heading or 0.0) for one in setup.steps.positions}) > 1
    for sensor, record in zip(session.at_work, records, strict=True):
        notes = [
            *compared(setup.reference),
            *setup.overdue(),
            *(quiet_note(channel, n) for channel, n in quiet[sensor.serial].items()),
        ]
        if turned and len(quiet[sensor.serial]) == len(record.sensor.channels):
            notes.append(NOTHING_FOLLOWED)
        bench = BenchRecord(
            moving_table=setup.table is not None,
            address=sensor.address,
            axes=() if sensor.orientation.straight else tuple(sensor.orientation.names),
            thermometer=None if setup.thermometer is None else setup.thermometer.address,
            device=sensor.device,
            reference=None if setup.reference is None else setup.reference.address,
        )
        base = setup.bases.get(sensor.serial)
        calibrations[sensor.serial] = replace(
            record,
            fit=record.fit.replaced(notes=(*record.fit.notes, *notes)),
            provenance=Provenance(
                **provenance,
                bench=bench,
                base=None if base is None else base.origin,
                link_statistics=statistics.get(sensor.serial),
            ),
        )
    return calibrations


def _pair_calibration(
    session: RecordedSession, provenance: Mapping[str, Any], statistics: Mapping[str, dict[str, int]]
) -> PairRecord:
    """Return the pairs that a journal gives."""
    from tiltcal.core.pair.matching import rotation_of
    from tiltcal.files.pair import PairRecord, SpinRecord

    setup = session.setup
    channels = setup.stage_channels()
    rotation = rotation_of(channels.columns, session.rotation_rows())
    matchings, unmatched = rotation.matched(channels.pairs)
    sensors = tuple(
        BenchSensorRecord(serial=sensor.serial, model=sensor.model, address=sensor.address) for sensor in setup.sensors
    )
    return PairRecord(
        spin=SpinRecord(turns=rotation.turns, frequency=rotation.frequency, phase=channels.phase),
        matchings=matchings,
        provenance=PairProvenance(
            **provenance,
            bench=BenchRecord(sensors=sensors),
            link_statistics=statistics,
            procedure=setup.steps.name,
            samples=SamplesRecord(
                used=rotation.samples, left_out=rotation.left_out + sum(map(unused, statistics.values()))
            ),
            stopped=None if session.turned is None else session.turned.ended,
            not_matched=(*channels.left_out, *unmatched),
        ),
    )


def unused(link_statistics: Mapping[str, int]) -> int:
    """Return the count of data that were not used: all counts but the first."""
    return sum(list(link_statistics.values())[1:])
