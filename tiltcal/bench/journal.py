"""A calibration as a function of a journal: its bytes decoded by the drivers, its accepted positions fitted.

``measure`` ends here, and so do ``replay`` and ``--resume``, so they agree by construction. Nothing of the settling is
judged a second time: an accepted position names the lines of its samples. In a journal of format 1 they are the last
ones before the review.

The drivers read as they read at the bench, and each of their requests is compared with the recorded one. A transaction
begins a sample, which is a reading of each device in their order. A driver may have got several readings with one
message: they follow without a transaction.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.bench.checks import PositionResult, ReadingSpans, at_rail, far_off, result_of
from tiltcal.bench.devices import BenchDevice
from tiltcal.bench.operators import Message, OperatorAnswer
from tiltcal.bench.sensors import THERMOMETER, named_error
from tiltcal.bench.setup import Setup
from tiltcal.core.model import Array
from tiltcal.core.samples import ReadingStep
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Reading, StreamingSensor
from tiltcal.errors import BusError, HardwareError, JournalError
from tiltcal.files.calibration import SensorIdentity, dump_calibration
from tiltcal.files.journal import (
    ANSWER,
    HARDWARE_ERROR,
    LIVE_READING,
    POSITION,
    RESUMED,
    AcceptedPosition,
    Event,
    Journal,
    accepted_position,
)
from tiltcal.files.moments import moment_after, stamp
from tiltcal.files.results import (
    VIRTUAL,
    BenchRecord,
    BenchSensorRecord,
    FileRecord,
    PairProvenance,
    Provenance,
    SamplesRecord,
)

if TYPE_CHECKING:
    from tiltcal.core.ramp.record import RampRecord
    from tiltcal.files.calibration import CalibrationRecord
    from tiltcal.files.pair import PairRecord

STREAMS = ("r", "e", "m")
"""The buses on which a transaction without bytes drops what has arrived."""

MARKS = (ANSWER, POSITION, LIVE_READING, RESUMED)
"""The events that are no transaction."""

DIGITS = 1e-9
"""Part of its size by which a mean may differ from the one that was accepted."""


@dataclass(frozen=True)
class RecordedSample:
    """A sample of a session, its readings by serial number; a sensor that was given up is left out.

    ``line`` is that of the last event before it ended, ``now_ns`` its time since the session began. It is ``fresh``
    where what the sensors had sent before was dropped, ``live`` where it was for the operator's eyes alone (format 1),
    and it ``counts`` where an accepted position names it.
    """

    line: int
    now_ns: int
    readings: Mapping[str, Reading]
    fresh: bool = False
    live: bool = False
    counts: bool = False


@dataclass
class PlayedLink:
    """A link that answers what the journal holds."""

    playback: Playback
    letter: str
    number: int

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Return the recorded answer; JournalError where the journal holds another request."""
        return self.playback.answer(self.letter, self.number, out)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class Playback:
    """The samples and the other events of a journal in their order.

    ``now_ns`` is the time of the last event, and ``breaks`` counts failures of a device and interruptions so far.
    By serial number ``failures`` are the last ones, and ``reopened`` are the sensors whose bus failed and was opened
    again; ``last_answers`` are those of each device by its number.
    """

    def __init__(self, journal: Journal) -> None:
        self.setup = Setup.of(journal)
        self.now_ns = 0
        self.failures: dict[str, str] = {}
        self.reopened: set[str] = set()
        self.last_answers: dict[int, bytes] = {}
        self.breaks = 0
        self._journal = journal
        self._clock = VirtualClock()
        self._events = iter(journal.events)
        self._line = 1
        self._event: Event | None = next(self._events, None)
        self._coming = deque(map(accepted_position, journal.accepted))
        self._interrupted = False
        self._given_up: set[str] = set()
        self._kept: set[str] | None = None
        self._statistics: dict[str, dict[str, int]] = {}
        self._names = [device.serial for device in self.setup.sensors]
        self._names += [] if self.setup.thermometer is None else [THERMOMETER]
        self._connect()

    def _connect(self) -> None:
        self._drivers = [
            device.wired.driver(PlayedLink(self, device.letter, number), self._clock)
            for number, device in enumerate(self.setup.devices)
        ]

    def link_statistics(self) -> dict[str, dict[str, int]]:
        """Return the link statistics of each device that counts them, by serial number, or model where it has none."""
        counted = {serial: dict(counts) for serial, counts in self._statistics.items()}
        for name, driver in zip(self._names, self._drivers, strict=True):
            if isinstance(driver, StreamingSensor) and name not in self._given_up:
                before = counted.get(name := name or self.setup.sensors[0].model, {})
                counted[name] = {what: before.get(what, 0) + n for what, n in driver.link_statistics().items()}
        return counted

    def __iter__(self) -> Iterator[RecordedSample | Event]:
        in_positions = self.setup.steps.rotation is None and self.setup.steps.ramp is None
        live, taken = False, None
        while (event := self._event) is not None:
            coming = self._coming[0] if self._coming and in_positions else None
            if coming and coming.lines and coming is not taken and event.line >= coming.lines[0]:
                taken = coming
                for _ in range(coming.n + len(coming.without)):
                    sample = self._sample(counts=True)
                    if sample is None:
                        raise self._error("a sample of an accepted position cannot be decoded from here on", event)
                    yield sample
            elif event.kind not in MARKS:
                discards = event.kind in STREAMS and event.payload[:2] == ("", "")
                sample = self._sample(fresh=discards, live=live)
                live = False
                if sample is not None:
                    yield sample
            else:
                yield from self._kept_by_drivers(event)
                self._take(event)
                live = event.kind == LIVE_READING
                if event.kind == POSITION:
                    self._kept = {*self._coming.popleft().by_serial(self._names)}
                if event.kind == RESUMED:
                    self._resume()
                yield event

    def _kept_by_drivers(self, event: Event) -> Iterator[RecordedSample]:
        """Yield the samples that need no further transaction, where the session took them before an event."""
        rotates = self.setup.steps.rotation is not None
        question = event.payload[0]["to"] if event.kind == ANSWER else ""
        most = 0
        if rotates and (event.kind in (POSITION, RESUMED) or question == "write"):
            most = len(self._journal.events)
        elif question in ("review", "tip") and self._journal.version == 1:
            most = self._coming[0].n if self._coming else self.setup.settings.samples
        for _ in range(most):
            if (sample := self._sample()) is None:
                break
            yield sample

    def _resume(self) -> None:
        """Begin anew with the drivers, as the session does; sensors given up since the last position count again."""
        self.breaks += 1
        if self._journal.version > 1:
            self._statistics = self.link_statistics()
            self._connect()
        self._given_up &= set() if self._kept is None else {*self._names} - self._kept

    def answer(self, letter: str, number: int, out: bytes) -> bytes:
        """Return what a device answered to ``out``.

        BusError: it failed when it was captured, or the session was interrupted here.
        JournalError: the journal has something else here.
        """
        event = self._event
        if event is None or event.kind in MARKS:
            self._interrupted = True
            if event is not None and event.kind == RESUMED and self._journal.version == 1:
                self._take(event)  # the driver went on with what it knew
                self.breaks += 1
            raise BusError("the session was interrupted here")
        sent, device = out.hex(), (number,) if number else ()
        if event.payload[0] != sent or event.payload[2:] != device or event.kind not in (letter, HARDWARE_ERROR):
            entry = " ".join(str(part) for part in (event.kind, *event.payload))
            raise self._error(
                f"the journal holds {entry!r} where the driver sends {letter} {sent or 'nothing'}: another version of "
                "tiltcal or of the procedure recorded it",
                event,
            )
        self._take(event)
        if event.kind == HARDWARE_ERROR:
            raise BusError(event.payload[1])
        answer = bytes.fromhex(event.payload[1])
        self.last_answers[number] = answer or self.last_answers.get(number, b"")
        return answer

    def _sample(self, *, fresh: bool = False, live: bool = False, counts: bool = False) -> RecordedSample | None:
        """Return a sample of all devices; None where one of them failed, or no further is there."""
        self._interrupted = False
        readings: dict[str, Reading] = {}
        name = ""
        try:
            for name, driver in zip(self._names, self._drivers, strict=True) if fresh else ():
                if name not in self._given_up:
                    driver.discard()
            for number, (name, driver) in enumerate(zip(self._names, self._drivers, strict=True)):
                if not self._gives_up(number):
                    readings[name] = driver.read()
        except HardwareError as error:
            if not self._interrupted:
                self.breaks += 1
                self.failures[name] = str(named_error(name, error, alone=len(self.setup.sensors) == 1))
                self.reopened |= {name} if isinstance(error, BusError) else set()
            return None
        if (thermometer := readings.pop(THERMOMETER, None)) is not None:
            temperature = thermometer.temperature
            readings = {serial: replace(reading, temperature=temperature) for serial, reading in readings.items()}
        return RecordedSample(self._line, self.now_ns, readings, fresh, live, counts)

    def _gives_up(self, number: int) -> bool:
        """Return whether a device that has failed is given up: where it would be read, another one is.

        One that streams may hold a reading without a transaction; it is given up where the next position lacks it.
        """
        name, event = self._names[number], self._event
        if name in self._given_up or name not in self.failures or name == THERMOMETER:
            return name in self._given_up
        lacking = not self._coming or name not in self._coming[0].by_serial(self._names)
        streams = self.setup.devices[number].letter in STREAMS
        another = event is not None and event.payload[2:] != ((number,) if number else ())
        if len(self._names) > 1 and another and (lacking or not streams):
            self._given_up.add(name)
        return name in self._given_up

    def _take(self, event: Event) -> None:
        """Pass the next event."""
        self._line = event.line
        self._event = next(self._events, None)
        self.now_ns += event.dt_ns
        self._clock.seek(self.now_ns)

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self._journal.path, line=event.line)


class RecordedSession:
    """What a journal holds of a session.

    ``accepted`` are the positions in order, ``leg`` the samples of a ramp since the last one, ``turned`` the end of a
    rotation. ``tipped`` is whether the operator was asked to tip the sensors, ``spans`` what their readings span.
    """

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.playback = Playback(journal)
        self.setup = self.playback.setup
        self.sensors = {sensor.serial: sensor for sensor in self.setup.sensors}
        self.accepted: list[PositionResult] = []
        self.leg: list[RecordedSample] = []
        self.turned: AcceptedPosition | None = None
        self.tipped = False
        self.spans = ReadingSpans(self.setup.sensors)
        self._channels = None if self.setup.steps.rotation is None else self.setup.stage_channels()
        self._rows = array("d")
        self._breaks = 0
        self._ramp: dict[str, list[tuple[float, ...]]] = {serial: [] for serial in self.sensors}
        self._steps = {serial: ReadingStep() for serial in self.sensors}
        # Of a position no more samples than twice those wanted are ever taken.
        self._samples: deque[RecordedSample] = deque(maxlen=2 * self.setup.settings.samples + 2)
        self._answer: OperatorAnswer | None = None
        self._sampling = False
        for item in self.playback:
            if isinstance(item, RecordedSample):
                self._take(item)
            elif item.kind == ANSWER:
                self._hear(item.payload[0]["to"], OperatorAnswer.from_record(item.payload[0]))
            elif item.kind == POSITION:
                self._accept(accepted_position(item), item)
            elif item.kind == RESUMED and journal.version > 1 and self._channels is None:
                self._sampling = False  # until the position is asked for again; a stage turns on

    @property
    def complete(self) -> bool:
        """Whether all positions are accepted, or the rotation has ended."""
        if self._channels is not None:
            return self.turned is not None or self.journal.end is not None
        return len(self.accepted) == len(self.setup.steps.positions)

    @property
    def turning(self) -> bool:
        """Whether the operator has let the stage turn."""
        return self._channels is not None and self._sampling

    @property
    def at_work(self) -> list[BenchDevice]:
        """The sensors that were not given up."""
        if not self.accepted:
            return list(self.sensors.values())
        return [self.sensors[serial] for serial in self.accepted[-1].measurements]

    @property
    def lost(self) -> dict[str, str]:
        """Why sensors were given up, by serial number."""
        kept = {sensor.serial for sensor in self.at_work}
        return {serial: self.playback.failures.get(serial, "") for serial in self.sensors if serial not in kept}

    def _take(self, sample: RecordedSample) -> None:
        self.spans.add(sample.readings)
        if sample.live or not self._sampling:
            return
        if self._channels is not None:
            row = self._channels.row(sample.now_ns, sample.readings)
            if self.playback.breaks > self._breaks and self._rows:
                self._rows.extend([nan] * len(row))
            self._breaks = self.playback.breaks
            self._rows.extend(row)
        elif self.setup.steps.ramp is not None:
            self.leg.append(sample)
        elif sample.fresh and self.journal.version == 1:
            self._samples.clear()  # the last reading before the samples
        elif sample.counts or self.journal.version == 1:
            self._samples.append(sample)

    def _hear(self, question: str, answer: OperatorAnswer) -> None:
        if answer.word == "back" and self.accepted:
            self.accepted.pop()
        if question in ("position", "rotation") and answer.word == "ready":
            self._answer, self._sampling = answer, True
            self._samples.clear()
        elif question == "tip":
            self.tipped, self._sampling = True, False

    def _accept(self, noted: AcceptedPosition, event: Event) -> None:
        """Take an accepted position; a JournalError where its samples do not give what was accepted."""
        if self._channels is not None:
            self.turned = noted
            return
        values = noted.by_serial(list(self.sensors))
        positions = self.setup.steps.positions
        asked = positions[len(self.accepted)] if len(self.accepted) < len(positions) else None
        if asked is None or asked.name != noted.position or self._answer is None:
            raise self._error(f"accepts {noted.position!r}, which the procedure does not ask for here", event)
        position, typed = self._answer.as_set(asked), self._answer.temperature
        if self.setup.steps.ramp is not None:
            position, typed = replace(position, temperature=asked.temperature), None
            samples = [one for one in self.leg if noted.lines is None or noted.lines[0] <= one.line <= noted.lines[1]]
            self.leg = []
            self._add_to_ramp(samples)
        else:
            samples = self._of_position(noted, list(values), typed)
        if not samples or any(serial not in sample.readings for sample in samples for serial in values):
            raise self._error(f"accepts {noted.position!r}, and does not hold its samples", event)
        result = result_of(
            [self.sensors[serial] for serial in values],
            position,
            asked,
            [sample.readings for sample in samples],
            stamp(moment_after(self.setup.began, samples[-1].now_ns)),
            typed=typed,
            left_out=noted.left_out,
            steps=self._steps if self.setup.steps.ramp is None else None,
        )
        self._require_same_means(result, values, event)
        self.accepted.append(result)

    def _of_position(
        self, noted: AcceptedPosition, serials: Sequence[str], typed: float | None
    ) -> list[RecordedSample]:
        """Return the samples of a position; in format 1 those far off are left out as they were."""
        samples = list(self._samples)
        if noted.lines is not None:
            return [sample for number, sample in enumerate(samples) if number not in noted.without]
        models = [self.sensors[serial].wired for serial in serials]
        counted: list[RecordedSample] = []
        for sample in samples[-noted.n - noted.left_out :]:
            counted.append(sample)
            if noted.left_out and len(counted) == noted.n:
                held = [(one.now_ns / 1e9, tuple(one.readings[serial] for serial in serials)) for one in counted]
                wrong = far_off(held, models, thermometers=typed is None)
                counted = [one for number, one in enumerate(counted) if number not in wrong]
        return counted

    def _add_to_ramp(self, samples: Sequence[RecordedSample]) -> None:
        """Add rows to each record: seconds, °C, readings; one with a reading at a rail has no temperature."""
        for sample in samples:
            for serial, reading in sample.readings.items():
                off = reading.temperature is None or at_rail(reading, self.sensors[serial].wired)
                temperature = nan if off or reading.temperature is None else reading.temperature
                self._ramp[serial].append((sample.now_ns / 1e9, temperature, *reading.values))

    def _require_same_means(self, result: PositionResult, values: Mapping[str, Message], event: Event) -> None:
        for serial, measurement in result.measurements.items():
            for channel, mean in values[serial].get("mean", {}).items():
                decoded = measurement.summaries[channel].mean
                if abs(decoded - mean) > DIGITS * max(abs(decoded), abs(mean)):
                    raise self._error(
                        f"accepts {result.position.name!r} with {mean:.9g} as {channel} of {serial}, and its samples "
                        f"give {decoded:.9g}: another version of tiltcal recorded it",
                        event,
                    )

    def results(self) -> list[PositionResult]:
        """Return the accepted positions with the steps that all their readings have shown."""
        return [result.with_steps(self._steps) for result in self.accepted]

    def rotation_rows(self) -> Array:
        """Return the samples of a turning stage: seconds, angle in degrees, readings; shape (n, 2 + channels).

        A row of NaN is a break, in which a device failed or the session was interrupted.
        """
        width = 0 if self._channels is None else 2 + len(self._channels.readings)
        return np.array(self._rows).reshape(-1, width)

    def ramp_records(self) -> dict[str, RampRecord]:
        """Return the record of a ramp of each sensor, by serial number; empty of other procedures."""
        if self.setup.steps.ramp is None:
            return {}
        from tiltcal.core.ramp.record import ramp_record

        records = {}
        for sensor in self.at_work:
            rows = np.array(self._ramp[sensor.serial]).reshape(-1, 2 + len(sensor.wired.channels))
            records[sensor.serial] = ramp_record(rows[:, 0], rows[:, 1], [*rows[:, 2:].T])
        return records

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self.journal.path, line=event.line)


@dataclass(frozen=True)
class SessionResult:
    """The result of a session: by serial number its calibrations, one of all pairs of a stage by its first device.

    ``lost`` says why sensors were given up, ``link_statistics`` what became of the data of those that send by
    themselves.
    """

    calibrations: dict[str, CalibrationRecord | PairRecord]
    lost: dict[str, str]
    link_statistics: Mapping[str, Mapping[str, int]]

    def texts(self) -> dict[str, str]:
        """Return the texts of the calibration files by serial number."""
        return {serial: _text(record) for serial, record in self.calibrations.items()}


def _text(record: CalibrationRecord | PairRecord) -> str:
    from tiltcal.files.calibration import CalibrationRecord

    if isinstance(record, CalibrationRecord):
        return dump_calibration(record)
    from tiltcal.files.pair import dump_pair

    return dump_pair(record)


def samples_of(journal: Journal) -> Iterator[RecordedSample]:
    """Iterate over every sample of a session, those of the settling and of refused positions too."""
    return (item for item in Playback(journal) if isinstance(item, RecordedSample))


def positions_of(journal: Journal) -> RecordedSession:
    """Return what a journal holds of its session: the accepted positions, and what a ramp or a rotation has so far.

    JournalError: a driver sends another request than the recorded one, or a position does not give its means.
    """
    return RecordedSession(journal)


def calibrations_of(journal: Journal) -> SessionResult:
    """Return the calibrations that a journal gives, be its session about to end; none of a verification.

    JournalError: as :func:`positions_of`, or the session is not complete.
    EstimateError: the positions cannot determine the coefficients.
    """
    session = positions_of(journal)
    setup = session.setup
    if not session.complete:
        raise JournalError(
            f"the session was interrupted; continue it with: {setup.resume_command(journal.path)}",
            file=journal.path,
            line=len(journal.events) + 2,
        )
    statistics = session.playback.link_statistics()
    provenance = {
        "made_by": VIRTUAL if setup.simulated else "measurement",
        "operator": setup.person or setup.operator,
        "software": setup.software,
        "started": stamp(setup.began),
        "ended": stamp(moment_after(setup.began, session.playback.now_ns)),
        "journal": FileRecord(name=setup.journal, sha256=journal.sha256),
        "references": setup.references,
    }
    calibrations: dict[str, CalibrationRecord | PairRecord] = {}
    if setup.steps.rotation is not None:
        calibrations[setup.sensors[0].serial] = _pair_calibration(session, provenance, statistics)
    elif not setup.verifies:
        calibrations |= _tilt_calibrations(session, provenance, statistics)
    return SessionResult(calibrations, session.lost, statistics)


def _tilt_calibrations(
    session: RecordedSession, provenance: Mapping[str, Any], statistics: Mapping[str, dict[str, int]]
) -> dict[str, CalibrationRecord]:
    """Return the calibration of each sensor that was not given up, by its serial number."""
    from tiltcal.calibration.calibrate import calibrate
    from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
    from tiltcal.calibration.wording import NOT_FOLLOWED

    setup, settings, accepted, ramps = session.setup, session.setup.settings, session.results(), session.ramp_records()
    # The steps of the sensors' own thermometers count where those are the only ones.
    own_thermometers = setup.thermometer is None and not any(result.typed for result in accepted)
    records = calibrate(
        [
            MeasuredSensor(
                SensorIdentity(sensor.model, sensor.serial, sensor.wired.unit, sensor.wired.channels),
                [result.measurements[sensor.serial] for result in accepted],
                sensor.wired,
                sensor.orientation.matrix,
                sensor.wired.thermometer_rounding if own_thermometers else None,
                base.calibration if (base := setup.known.get(sensor.serial)) else None,
                ramps.get(sensor.serial),
                sensor.serial in session.playback.reopened,
            )
            for sensor in session.at_work
        ],
        setup.steps,
        BenchUncertainty(settings.jig, settings.thermometer, settings.table, settings.heading),
        typical_temperature=setup.typical_temperature,
        settings={"samples": settings.samples, "settle_seconds": settings.settle},
    )
    calibrations = {}
    quiet = session.spans.quiet_channels(setup.steps.positions) if session.tipped else {}
    for sensor, record in zip(session.at_work, records, strict=True):
        notes = [*setup.overdue(), *(f"{channel} {NOT_FOLLOWED}" for channel in quiet.get(sensor.serial, ()))]
        bench = BenchRecord(
            address=sensor.address,
            axes=() if sensor.orientation.straight else tuple(sensor.orientation.names),
            thermometer=None if setup.thermometer is None else setup.thermometer.address,
        )
        base = setup.known.get(sensor.serial)
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
        spin=SpinRecord(turns=rotation.turns, frequency=rotation.frequency, phase=channels.phase.column),
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
