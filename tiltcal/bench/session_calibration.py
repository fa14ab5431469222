"""The calibrations of a session of positions, and what their files state of the session."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from math import hypot
from typing import Any

from tiltcal.bench.device_setup import DeviceSetup
from tiltcal.bench.position_result import PositionResult
from tiltcal.bench.sensor_set import ConnectedSensor
from tiltcal.bench.session_plan import SessionPlan
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.calibration.summary import NOT_FOLLOWED
from tiltcal.core.ramp.record import RampRecord
from tiltcal.core.rounding import plus_minus
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.moments import stamp
from tiltcal.files.results import VIRTUAL, BenchRecord, FileRecord, Provenance


@dataclass(frozen=True)
class SessionEnd:
    """The end of a session.

    Attributes
    ----------
    ended : datetime
        UTC.
    sha256 : str
        Of its journal.
    lost : dict of str to str
        Why sensors were given up, by serial number.
    link_statistics_by_serial : dict of str to mapping of str to int
        By serial number: what became of the data of a sensor that sends by itself.
    """

    ended: datetime
    sha256: str
    lost: dict[str, str]
    link_statistics_by_serial: dict[str, Mapping[str, int]]


def tilt_calibrations(
    plan: SessionPlan,
    sensors: Sequence[ConnectedSensor],
    accepted: Sequence[PositionResult],
    records: Mapping[str, RampRecord],
    unseen: Mapping[str, Sequence[str]],
    reopened: Collection[str],
) -> dict[str, CalibrationRecord]:
    """Return the calibration of each sensor by its serial number, without its provenance.

    Parameters
    ----------
    sensors : sequence of ConnectedSensor
        Those that were not given up.
    accepted : sequence of PositionResult
        Every position, in the procedure's order.
    records : mapping of str to RampRecord
        Of a ramp, the continuous record of each sensor.
    unseen : mapping of str to sequence of str
        By serial number, the channels that were tipped and did not follow.
    reopened : collection of str
        Sensors whose bus failed and was opened again, by serial number.

    EstimateError: the positions cannot determine the coefficients.
    """
    # The steps of the sensors' own thermometers count where those are the only ones.
    own_thermometers = plan.thermometer is None and not any(result.typed for result in accepted)
    found = calibrate(
        [
            MeasuredSensor(
                sensor.identity,
                [result.measurements[sensor.serial] for result in accepted],
                sensor.model,
                sensor.orientation.matrix,
                sensor.model.thermometer_rounding if own_thermometers else None,
                base.calibration if (base := plan.bases.get(sensor.serial)) else None,
                records.get(sensor.serial),
                sensor.serial in reopened,
            )
            for sensor in sensors
        ],
        plan.procedure,
        BenchUncertainty(plan.settings.jig, plan.settings.thermometer, plan.settings.table, plan.settings.heading),
        typical_temperature=plan.typical,
        settings={"samples": plan.settings.samples, "settle_seconds": plan.settings.settle},
    )
    calibrations = {}
    for sensor, record in zip(sensors, found, strict=True):
        notes = [f"{channel} {NOT_FOLLOWED}" for channel in unseen.get(sensor.serial, ())]
        calibrations[sensor.serial] = replace(record, fit=record.fit.replaced(notes=(*record.fit.notes, *notes)))
    return calibrations


def tilt_provenance(plan: SessionPlan, device: DeviceSetup, ending: SessionEnd) -> Provenance:
    """Return what a sensor's calibration file states of the session."""
    statistics = ending.link_statistics_by_serial.get(device.serial)
    return Provenance(
        **session_provenance(plan, ending),
        bench=BenchRecord(
            address=device.address,
            axes=() if device.orientation.straight else tuple(device.orientation.names),
            thermometer=None if plan.thermometer is None else plan.thermometer.address,
        ),
        base=base.origin if (base := plan.bases.get(device.serial)) else None,
        link_statistics=None if statistics is None else dict(statistics),
    )


def changes_in_words(calibration: CalibrationRecord) -> str:
    """Return how the readings of the last position differ from those of the first, where both are one position."""
    first, last = calibration.positions[0], calibration.positions[-1]
    coefficients, unit = calibration.coefficients, calibration.sensor.unit
    parts = []
    for channel in coefficients.channels:
        change = last.mean[channel] - first.mean[channel]
        u = hypot((first.u or {}).get(channel, 0.0), (last.u or {}).get(channel, 0.0))
        milligravity = 1000 * change / abs(coefficients.own_sensitivity(channel))
        parts.append(f"{channel} {plus_minus(change, 2 * u, signed=True)} {unit} ({milligravity:+.2g} mg)")
    return f"{calibration.sensor.serial}: back in {first.position} the readings have changed by {', '.join(parts)}"


def session_provenance(plan: SessionPlan, ending: SessionEnd) -> dict[str, Any]:
    """Return what every calibration file states of its session."""
    return {
        "made_by": VIRTUAL if plan.virtual else "measurement",
        "operator": plan.person or plan.operator,
        "software": plan.software,
        "started": stamp(plan.started),
        "ended": stamp(ending.ended),
        "journal": FileRecord(name=plan.journal, sha256=ending.sha256),
    }
