"""What is concluded from a session: calibrations from positions or turns, and what their files tell of the session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from tiltcal.bench.channel_map import ChannelMap
from tiltcal.bench.position_runner import PositionResult
from tiltcal.bench.rotation_runner import RotationResult
from tiltcal.bench.sensor_set import ConnectedSensor
from tiltcal.bench.session_plan import DeviceSetup, SessionPlan, stamp
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement, Nominal
from tiltcal.files.calibration import CalibrationRecord, calibration_of
from tiltcal.files.document import checked_kind, parse_document
from tiltcal.files.pair import PairRecord
from tiltcal.files.records import (
    VIRTUAL,
    BenchRecord,
    BenchSensorRecord,
    FileRecord,
    PairProvenance,
    Provenance,
    SamplesRecord,
)


@dataclass(frozen=True)
class MeasuredPositions:
    """What was measured.

    Attributes
    ----------
    bays : tuple of ConnectedSensor
        The sensors that held out.
    taken : tuple of PositionResult
        Every position, in the procedure's order.
    """

    bays: tuple[ConnectedSensor, ...]
    taken: tuple[PositionResult, ...]


@dataclass(frozen=True)
class SessionEnd:
    """How a session ended.

    Attributes
    ----------
    ended : datetime
        UTC.
    sha256 : str
        Of its journal.
    lost : dict of str to str
        Why sensors were given up, by serial number.
    link_statistics_by_serial : dict of str to mapping of str to int
        By serial number: what became of what a sensor said that talks by itself.
    """

    ended: datetime
    sha256: str
    lost: dict[str, str]
    link_statistics_by_serial: dict[str, Mapping[str, int]]


def tilt_calibrations(plan: SessionPlan, walked: MeasuredPositions) -> dict[str, CalibrationRecord]:
    """The calibration of each sensor by its serial number, without its provenance.

    Raises
    ------
    EstimateError
        The positions cannot determine the coefficients.
    """
    thermometer = plan.thermometer is not None or any(one.typed for one in walked.taken)
    found = calibrate(
        [_measured(plan, bay, walked.taken, own_thermometer=not thermometer) for bay in walked.bays],
        plan.procedure,
        BenchUncertainty(plan.jig, plan.thermometer_uncertainty),
        base=_base(plan),
        typical_temperature=plan.typical,
        settings={"samples": plan.settings.samples, "settle_seconds": plan.settings.settle},
    )
    return {bay.serial: one for bay, one in zip(walked.bays, found, strict=True)}


def pair_calibration(plan: SessionPlan, hookup: ChannelMap, turned: RotationResult, ending: SessionEnd) -> PairRecord:
    """What a rotation found, with its provenance."""
    sensors = tuple(BenchSensorRecord(serial=one.serial, model=one.model, address=one.address) for one in plan.places)
    provenance = PairProvenance(
        **_session(plan, ending),
        bench=BenchRecord(sensors=sensors),
        link_statistics={serial: dict(one) for serial, one in ending.link_statistics_by_serial.items()},
        procedure=plan.procedure.name,
        samples=SamplesRecord(used=turned.samples, left_out=turned.left_out),
        stopped=turned.ended,
        not_matched=(*hookup.left_out, *turned.unmatched),
    )
    return PairRecord(turned.matchings, hookup.phase.column, turned.turns, turned.frequency, provenance=provenance)


def tilt_provenance(plan: SessionPlan, place: DeviceSetup, ending: SessionEnd) -> Provenance:
    """What a sensor's calibration file tells of the session."""
    statistics = ending.link_statistics_by_serial.get(place.serial)
    return Provenance(
        **_session(plan, ending),
        bench=BenchRecord(
            address=place.address,
            axes=() if place.orientation.straight else tuple(place.orientation.names),
            thermometer=None if plan.thermometer is None else plan.thermometer.address,
        ),
        link_statistics=None if statistics is None else dict(statistics),
    )


def _base(plan: SessionPlan) -> CalibrationRecord | None:
    if plan.base is None:
        return None
    return calibration_of(checked_kind(parse_document(plan.base, "the base calibration"), "tilt"))


def _measured(
    plan: SessionPlan, bay: ConnectedSensor, taken: Sequence[PositionResult], *, own_thermometer: bool
) -> MeasuredSensor:
    """What was measured of one sensor."""
    measurements = [
        Measurement(
            one.position.name,
            bay.orientation.seen(one.position.gravity),
            one.position.tilt if bay.orientation.straight else None,
            one.temperatures[bay.serial],
            one.summaries[bay.serial],
            {"time": stamp(plan.started + timedelta(microseconds=one.time_ns / 1000))},
            heading=one.position.heading,
        )
        for one in taken
    ]
    thermometer = bay.model.thermometer_rounding if own_thermometer else None
    return MeasuredSensor(bay.identity, measurements, Nominal.of(bay.model), bay.orientation.matrix, thermometer)


def _session(plan: SessionPlan, ending: SessionEnd) -> dict[str, Any]:
    """What every file tells of its session."""
    return {
        "made_by": VIRTUAL if plan.virtual else "measurement",
        "operator": plan.person or plan.lead,
        "software": plan.software,
        "started": stamp(plan.started),
        "ended": stamp(ending.ended),
        "journal": FileRecord(name=plan.journal, sha256=ending.sha256),
    }
