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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from math import hypot, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.bench.checks import PositionResult, ReadingSpans, at_rail, far_off, measurement_of
from tiltcal.bench.operators import Message, OperatorAnswer
from tiltcal.bench.sensors import ConnectedSensor, SensorSet, letter_of, named_error
from tiltcal.bench.setup import BenchDevice, Setup
from tiltcal.core.model import Array
from tiltcal.core.quantisation import ReadingStep
from tiltcal.core.rounding import plus_minus
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Reading, StreamingSensor
from tiltcal.errors import BusError, HardwareError, JournalError
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
from tiltcal.files.procedure import Position
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

DIGITS = 1e-9
"""Part of its size by which a mean may differ from the one that was accepted."""


@dataclass(frozen=True)
class RecordedSample:
    """A sample of a session.

    Attributes
    ----------
    line : int
        Of the last event before it ended.
    now_ns : int
        Since the session began, ns.
    readings : mapping of str to Reading
        By serial number; a sensor that was given up is left out.
    fresh : bool
        Whether what the sensors had sent before was dropped first.
    live : bool
        Whether it was for the operator's eyes alone, in a journal of format 1.
    counts : bool
        Whether an accepted position names it.
    """

    line: int
    now_ns: int
    readings: Mapping[str, Reading]
    fresh: bool = False
    live: bool = False
    counts: bool = False


class PlayedLink:
    """A link that answers what the journal holds."""

    def __init__(self, playback: Playback, letter: str, number: int) -> None:
        self.letter = letter
        self._playback = playback
        self._number = number

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Return the recorded answer; JournalError where the journal holds another request."""
        return self._playback.answer(self.letter, self._number, out)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class Playback:
    """The samples and the other events of a journal in their order.

    Attributes
    ----------
    now_ns : int
        The time of the last event, ns since the session began.
    failures : dict of str to str
        The last failure of each device that failed, by serial number.
    reopened : set of str
        Sensors whose bus failed and was opened again, by serial number.
    last_answers : dict of int to bytes
        The last answer of each device, by its number.
    breaks : int
        How often a device failed or the session was interrupted so far.
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
        self._next = 0
        self._events = iter(journal.events)
        self._event: Event | None = None
        self._accepted = 0
        self._interrupted = False
        self._given_up: set[str] = set()
        self._statistics: dict[str, dict[str, int]] = {}
        self._connect()

    def _connect(self) -> None:
        devices = self.setup.devices
        self._drivers = [
            device.wired.driver(PlayedLink(self, letter_of(device), number), self._clock)
            for number, device in enumerate(devices)
        ]
        thermometer = [] if self.setup.thermometer is None else [SensorSet.THERMOMETER]
        self._names = [sensor.serial for sensor in self.setup.sensors] + thermometer

    def sensors(self) -> list[ConnectedSensor]:
        """Return the sensors, those that were given up too."""
        stated = zip(self.setup.sensors, self._drivers, strict=False)
        return [ConnectedSensor(device.wired, device.serial, driver, device.orientation) for device, driver in stated]

    def link_statistics(self) -> dict[str, dict[str, int]]:
        """Return the link statistics of each device that counts them, by serial number, or model where it has none."""
        counted = {serial: dict(counts) for serial, counts in self._statistics.items()}
        for name, driver in zip(self._names, self._drivers, strict=True):
            if isinstance(driver, StreamingSensor) and name not in self._given_up:
                before = counted.get(name := name or self.setup.sensors[0].model, {})
                counted[name] = {what: before.get(what, 0) + n for what, n in driver.link_statistics().items()}
        return counted

    @property
    def next_accepted(self) -> AcceptedPosition | None:
        """The position that is accepted next; None where none is any more."""
        accepted = self._journal.accepted
        return accepted_position(accepted[self._accepted]) if self._accepted < len(accepted) else None

    def __iter__(self) -> Iterator[RecordedSample | Event]:
        in_positions = self.setup.steps.rotation is None and self.setup.steps.ramp is None
        live, taken = False, 0
        while (event := self._peek()) is not None:
            coming = self.next_accepted
            lines = None if coming is None or not in_positions else coming.lines
            if coming is not None and lines is not None and taken <= self._accepted and event.line >= lines[0]:
                taken = self._accepted + 1
                for _ in range(coming.n + len(coming.without)):
                    yield self._sample(counts=True) or self._undecodable(event)
            elif event.kind not in (ANSWER, POSITION, LIVE_READING, RESUMED):
                sample = self._sample(fresh=_discards(event), live=live)
                live = False
                if sample is not None:
                    yield sample
            else:
                yield from self._kept_by_drivers(event)
                self._take()
                live = event.kind == LIVE_READING
                self._accepted += event.kind == POSITION
                if event.kind == RESUMED:
                    self._resume()
                yield event

    def _kept_by_drivers(self, event: Event) -> Iterator[RecordedSample]:
        """Yield the samples that need no further transaction, where the session took them before an event."""
        rotation = self.setup.steps.rotation is not None
        question = event.payload[0]["to"] if event.kind == ANSWER else ""
        if rotation and (event.kind in (POSITION, RESUMED) or question == "write"):
            while (sample := self._sample()) is not None:
                yield sample
        elif question in ("review", "tip") and self._journal.version == 1:
            wanted = self.next_accepted.n if self.next_accepted else self.setup.settings.samples
            for _ in range(wanted):
                if (sample := self._sample()) is None:
                    break
                yield sample

    def _resume(self) -> None:
        """Begin anew with the drivers, as the session does; sensors given up since the last position count again."""
        self.breaks += 1
        if self._journal.version > 1:
            self._statistics = self.link_statistics()
            self._connect()
        before = self._journal.accepted[self._accepted - 1] if self._accepted else None
        kept = set(self._names) if before is None else {*accepted_position(before).by_serial(self._names)}
        self._given_up &= set(self._names) - kept

    def answer(self, letter: str, number: int, out: bytes) -> bytes:
        """Return what a device answered to ``out``.

        BusError: it failed when it was captured, or the session was interrupted here.
        JournalError: the journal has something else here.
        """
        event = self._peek()
        if event is None or event.kind in (ANSWER, POSITION, LIVE_READING, RESUMED):
            self._interrupted = True
            if event is not None and event.kind == RESUMED and self._journal.version == 1:
                self._take()  # the driver went on with what it knew
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
        self._take()
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
                if isinstance(error, BusError):
                    self.reopened.add(name)
            return None
        if (thermometer := readings.pop(SensorSet.THERMOMETER, None)) is not None:
            readings = {
                serial: replace(reading, temperature=thermometer.temperature) for serial, reading in readings.items()
            }
        return RecordedSample(self._next + 1, self.now_ns, readings, fresh, live, counts)

    def _gives_up(self, number: int) -> bool:
        """Return whether a device that has failed is given up: where it would be read, another one is.

        One that streams may hold a reading without a transaction; it is given up where the next position lacks it.
        """
        name, event = self._names[number], self._peek()
        if name in self._given_up or name not in self.failures or name == SensorSet.THERMOMETER:
            return name in self._given_up
        coming = self.next_accepted
        lacking = coming is None or name not in coming.by_serial(self._names)
        streams = letter_of(self.setup.devices[number]) in STREAMS
        another = event is not None and event.payload[2:] != ((number,) if number else ())
        if len(self._names) > 1 and another and (lacking or not streams):
            self._given_up.add(name)
        return name in self._given_up

    def _peek(self) -> Event | None:
        """Return the next event; None at the end."""
        if self._event is None:
            self._event = next(self._events, None)
        return self._event

    def _take(self) -> None:
        """Pass the next event."""
        event, self._event = self._peek(), None
        self._next += 1
        self.now_ns += 0 if event is None else event.dt_ns
        self._clock.seek(self.now_ns)

    def _undecodable(self, event: Event) -> RecordedSample:
        raise self._error("a sample of an accepted position cannot be decoded from here on", event)

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self._journal.path, line=event.line)


def _discards(event: Event) -> bool:
    """Return whether a transaction dropped what had arrived."""
    return event.kind in STREAMS and event.payload[:2] == ("", "")


class RecordedSession:
    """What a journal holds of a session.

    Attributes
    ----------
    accepted : list of PositionResult
        The positions that were accepted, in order.
    leg : list of RecordedSample
        The samples of a ramp since the last position.
    turned : AcceptedPosition or None
        The end of a rotation.
    stopped_at : int
        The samples before the operator last asked the stage to stop.
    """

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.playback = Playback(journal)
        self.setup = self.playback.setup
        self.sensors = {sensor.serial: sensor for sensor in self.playback.sensors()}
        self.accepted: list[PositionResult] = []
        self.leg: list[RecordedSample] = []
        self._rows = array("d")
        self._breaks = 0
        self.turned: AcceptedPosition | None = None
        self.stopped_at = 0
        self.tipped = False
        self._ramp: dict[str, list[tuple[float, ...]]] = {serial: [] for serial in self.sensors}
        self.spans = ReadingSpans(list(self.sensors.values()))
        self._steps = {serial: ReadingStep() for serial in self.sensors}
        # Of a position no more samples than twice those wanted are ever taken.
        self._samples: deque[RecordedSample] = deque(maxlen=2 * self.setup.settings.samples + 2)
        self._answer: OperatorAnswer | None = None
        self._sampling = False
        channels = None if self.setup.steps.rotation is None else self.setup.channel_map()
        self._channels = () if channels is None else (channels.phase, *channels.readings)

    def read(self) -> Iterator[RecordedSample]:
        """Take everything in the journal; yield each sample."""
        for item in self.playback:
            if isinstance(item, RecordedSample):
                self._take(item)
                yield item
            elif item.kind == ANSWER:
                self._hear(item.payload[0]["to"], OperatorAnswer.from_record(item.payload[0]))
            elif item.kind == POSITION:
                self._accept(accepted_position(item), item)
            elif item.kind == RESUMED and self.journal.version > 1 and not self._channels:
                self._sampling = False  # until the position is asked for again; a stage turns on

    @property
    def complete(self) -> bool:
        """Whether all positions are accepted, or the rotation has ended."""
        if self.setup.steps.rotation is not None:
            return self.turned is not None or self.journal.end is not None
        return len(self.accepted) == len(self.setup.steps.positions)

    @property
    def turning(self) -> bool:
        """Whether the operator has let the stage turn."""
        return bool(self._channels) and self._sampling

    @property
    def at_work(self) -> list[ConnectedSensor]:
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
        if self._channels:
            if self.playback.breaks > self._breaks and self._rows:
                self._rows.extend([nan] * (1 + len(self._channels)))
            self._breaks = self.playback.breaks
            self._rows.append(sample.now_ns / 1e9)
            self._rows.extend(channel.value(sample.readings) for channel in self._channels)
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
        elif answer.word == "stop":
            self.stopped_at = len(self.rotation_rows())

    def _accept(self, noted: AcceptedPosition, event: Event) -> None:
        """Take an accepted position; a JournalError where its samples do not give what was accepted."""
        if self._channels:
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
        result = self._result(position, values, samples, typed, asked, noted.left_out)
        self._require_same_means(result, values, event)
        self.accepted.append(result)

    def _of_position(
        self, noted: AcceptedPosition, serials: Sequence[str], typed: float | None
    ) -> list[RecordedSample]:
        """Return the samples of a position; in format 1 those far off are left out as they were."""
        samples = list(self._samples)
        if noted.lines is not None:
            return [sample for number, sample in enumerate(samples) if number not in noted.without]
        models = [self.sensors[serial].model for serial in serials]
        counted: list[RecordedSample] = []
        for sample in samples[-noted.n - noted.left_out :]:
            counted.append(sample)
            if noted.left_out and len(counted) == noted.n:
                held = [(one.now_ns / 1e9, tuple(one.readings[serial] for serial in serials)) for one in counted]
                wrong = far_off(held, models, thermometers=typed is None)
                counted = [one for number, one in enumerate(counted) if number not in wrong]
        return counted

    def _result(
        self,
        position: Position,
        serials: Iterable[str],
        samples: Sequence[RecordedSample],
        typed: float | None,
        asked: Position,
        left_out: int,
    ) -> PositionResult:
        when: dict[str, Any] = {"time": stamp(moment_after(self.setup.began, samples[-1].now_ns))}
        if left_out:
            when["left_out"] = left_out
        measurements = {}
        for serial in serials:
            sensor = self.sensors[serial]
            readings = [sample.readings[serial] for sample in samples]
            if self.setup.steps.ramp is not None:
                readings = [reading for reading in readings if not at_rail(reading, sensor.model)]
            elif not sensor.model.resolution:
                values = np.array([reading.values for reading in readings]).T
                self._steps[serial].add(values, min(reading.step for reading in readings))
            measurements[serial] = measurement_of(sensor, position, readings, when, typed)
        return PositionResult(position, measurements, typed is not None, left_out, asked.temperature)

    def _add_to_ramp(self, samples: Sequence[RecordedSample]) -> None:
        """Add rows to each record: seconds, °C, readings; one with a reading at a rail has no temperature."""
        for sample in samples:
            for serial, reading in sample.readings.items():
                off = reading.temperature is None or at_rail(reading, self.sensors[serial].model)
                seen = nan if off or reading.temperature is None else reading.temperature
                self._ramp[serial].append((sample.now_ns / 1e9, seen, *reading.values))

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
        return np.array(self._rows).reshape(-1, 1 + len(self._channels))

    def ramp_records(self) -> dict[str, RampRecord]:
        """Return the record of a ramp of each sensor, by serial number; empty of other procedures."""
        if self.setup.steps.ramp is None:
            return {}
        from tiltcal.core.ramp.record import ramp_record

        records = {}
        for sensor in self.at_work:
            rows = np.array(self._ramp[sensor.serial]).reshape(-1, 2 + len(sensor.model.channels))
            records[sensor.serial] = ramp_record(rows[:, 0], rows[:, 1], [*rows[:, 2:].T])
        return records

    def quiet(self) -> dict[str, list[str]]:
        """Return the channels that were tipped and did not follow, by serial number."""
        return self.spans.quiet_channels(self.setup.steps.positions) if self.tipped else {}

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self.journal.path, line=event.line)


@dataclass(frozen=True)
class SessionResult:
    """The result of a session.

    Attributes
    ----------
    calibrations : dict of str to CalibrationRecord or PairRecord
        By serial number; one of all pairs of a stage, by that of its first device.
    lost : dict of str to str
        Why sensors were given up, by serial number.
    link_statistics : dict of str to mapping of str to int
        By serial number: what became of the data of a sensor that sends by itself.
    """

    calibrations: dict[str, CalibrationRecord | PairRecord]
    lost: dict[str, str]
    link_statistics: Mapping[str, Mapping[str, int]]

    def texts(self) -> dict[str, str]:
        """Return the texts of the calibration files by serial number."""
        return {serial: _text(record) for serial, record in self.calibrations.items()}

    def ended(self, journal: str, ended: datetime, sha256: str) -> SessionResult:
        """Return this result with the end of its session, and the SHA-256 of its journal."""
        end = {"ended": stamp(ended), "journal": FileRecord(name=journal, sha256=sha256)}
        calibrations: dict[str, CalibrationRecord | PairRecord] = {}
        for serial, record in self.calibrations.items():
            provenance: Any = record.provenance.replaced(**end)
            calibrations[serial] = replace(record, provenance=provenance)
        return replace(self, calibrations=calibrations)

    def require_all(self) -> None:
        """Refuse a session in which sensors were given up; HardwareError: with the reasons."""
        if self.lost:
            raise HardwareError("no calibration file for " + "; ".join(self.lost.values()))


def samples_of(journal: Journal) -> Iterator[RecordedSample]:
    """Iterate over every sample of a session, those of the settling and of refused positions too."""
    return RecordedSession(journal).read()


def positions_of(journal: Journal) -> RecordedSession:
    """Return what a journal holds of its session: the accepted positions, and what a ramp or a rotation has so far.

    JournalError: a driver sends another request than the recorded one, or a position does not give its means.
    """
    session = RecordedSession(journal)
    for _ in session.read():
        pass
    return session


def calibrations_of(journal: Journal) -> SessionResult:
    """Return the calibrations that a journal gives; none of a verification.

    JournalError: as :func:`positions_of`, or the session is not complete.
    EstimateError: the positions cannot determine the coefficients.
    """
    session = positions_of(journal)
    if not session.complete:
        raise JournalError(
            f"the session was interrupted; continue it with: {session.setup.resume_command(journal.path)}",
            file=journal.path,
            line=len(journal.events) + 2,
        )
    statistics = session.playback.link_statistics()
    if session.setup.verifies:
        return SessionResult({}, session.lost, statistics)
    if session.setup.steps.rotation is not None:
        records: dict[str, CalibrationRecord | PairRecord] = {
            session.setup.sensors[0].serial: _pair_calibration(session, statistics)
        }
    else:
        records = {**_tilt_calibrations(session, statistics)}
    ended = moment_after(session.setup.began, session.playback.now_ns)
    sha256 = journal.sha256 if journal.end is not None else ""
    return SessionResult(records, session.lost, statistics).ended(session.setup.journal, ended, sha256)


def _tilt_calibrations(
    session: RecordedSession, statistics: Mapping[str, Mapping[str, int]]
) -> dict[str, CalibrationRecord]:
    """Return the calibration of each sensor that was not given up, by its serial number."""
    from tiltcal.calibration.calibrate import calibrate
    from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
    from tiltcal.calibration.summary import NOT_FOLLOWED

    setup, accepted, ramps = session.setup, session.results(), session.ramp_records()
    # The steps of the sensors' own thermometers count where those are the only ones.
    own_thermometers = setup.thermometer is None and not any(result.typed for result in accepted)
    settings = setup.settings
    found = calibrate(
        [
            MeasuredSensor(
                sensor.identity,
                [result.measurements[sensor.serial] for result in accepted],
                sensor.model,
                sensor.orientation.matrix,
                sensor.model.thermometer_rounding if own_thermometers else None,
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
    calibrations, quiet = {}, session.quiet()
    devices = {device.serial: device for device in setup.sensors}
    for sensor, record in zip(session.at_work, found, strict=True):
        notes = [f"{channel} {NOT_FOLLOWED}" for channel in quiet.get(sensor.serial, ())]
        calibrations[sensor.serial] = replace(
            record,
            fit=record.fit.replaced(notes=(*record.fit.notes, *notes)),
            provenance=_provenance(setup, devices[sensor.serial], statistics.get(sensor.serial)),
        )
    return calibrations


def _provenance(setup: Setup, device: BenchDevice, statistics: Mapping[str, int] | None) -> Provenance:
    """Return what a sensor's calibration file states of the session, without its end."""
    return Provenance(
        **_session_provenance(setup),
        bench=BenchRecord(
            address=device.address,
            axes=() if device.orientation.straight else tuple(device.orientation.names),
            thermometer=None if setup.thermometer is None else setup.thermometer.address,
        ),
        base=base.origin if (base := setup.known.get(device.serial)) else None,
        link_statistics=None if statistics is None else dict(statistics),
    )


def _session_provenance(setup: Setup) -> dict[str, Any]:
    """Return what every calibration file states of its session, without its end."""
    return {
        "made_by": VIRTUAL if setup.simulated else "measurement",
        "operator": setup.person or setup.operator,
        "software": setup.software,
        "started": stamp(setup.began),
    }


def _pair_calibration(session: RecordedSession, statistics: Mapping[str, Mapping[str, int]]) -> PairRecord:
    """Return the pairs that a journal gives, with their provenance but for the end of the session."""
    from tiltcal.bench.stage import unused, whole_rotation
    from tiltcal.files.pair import PairRecord, SpinRecord

    setup = session.setup
    channels = setup.channel_map()
    whole = whole_rotation([channel.column for channel in channels.readings], session.rotation_rows())
    matchings, unmatched = whole.matched(channels.pairs)
    sensors = tuple(
        BenchSensorRecord(serial=sensor.serial, model=sensor.model, address=sensor.address) for sensor in setup.sensors
    )
    provenance = PairProvenance(
        **_session_provenance(setup),
        bench=BenchRecord(sensors=sensors),
        link_statistics={serial: dict(counts) for serial, counts in statistics.items()},
        procedure=setup.steps.name,
        samples=SamplesRecord(used=whole.samples, left_out=whole.left_out + sum(map(unused, statistics.values()))),
        stopped=_ended(session, whole.turns),
        not_matched=(*channels.left_out, *unmatched),
    )
    frequency = whole.turns / whole.seconds if whole.seconds > 0.0 else None
    spin = SpinRecord(turns=whole.turns, frequency=frequency, phase=channels.phase.column)
    return PairRecord(spin=spin, matchings=matchings, provenance=provenance)


def _ended(session: RecordedSession, turns: float) -> str:
    """Return why a rotation ended; a journal of format 1 does not say it."""
    from tiltcal.bench.stage import ALL_TURNS, CONVERGED, STOPPED
    from tiltcal.core.pair.model import FEWEST_TURNS
    from tiltcal.core.pair.stage import follow

    if session.turned is not None:
        return session.turned.ended
    theta = session.rotation_rows()[: session.stopped_at, 1]
    angle = follow(theta[np.isfinite(theta)])
    if len(angle) and np.ptp(angle) >= FEWEST_TURNS:  # a stop that came too early was refused
        return STOPPED
    rotation = session.setup.steps.rotation
    return CONVERGED if rotation is not None and turns < rotation.turns - 1 else ALL_TURNS


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


def _text(record: CalibrationRecord | PairRecord) -> str:
    """Return the text of a calibration file."""
    from tiltcal.files.calibration import CalibrationRecord, dump_calibration

    if isinstance(record, CalibrationRecord):
        return dump_calibration(record)
    from tiltcal.files.pair import dump_pair

    return dump_pair(record)
