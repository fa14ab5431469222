"""The samples of a journal, in which the drivers decode the bytes that were recorded.

They read as they read at the bench, and each of their requests is compared with the recorded one. A transaction begins
a sample, which is a reading of each device in their order. A driver may have got several readings with one message:
they follow without a transaction.

Between the answer ``ready`` and the acceptance stand the transactions of settling and of sampling, without a mark; the
accepted position names the line at which its samples begin.
:mod:`tiltcal.journal.lines` shows the lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf

from tiltcal.drivers.bus.clock import SECOND, VirtualClock
from tiltcal.drivers.model import Reading
from tiltcal.errors import BusError, HardwareError, JournalError, SensorError
from tiltcal.journal.header import OF_THE_BENCH, Setup
from tiltcal.journal.lines import (
    ANSWER,
    HARDWARE_ERROR,
    POSITION,
    RESUMED,
    AcceptedPosition,
    Event,
    Journal,
    OperatorAnswer,
)

STREAMS = ("r", "e", "m")  # the buses on which a transaction without bytes drops what has arrived
MARKS = (ANSWER, POSITION, RESUMED)  # the events that are no transaction


class Sample(dict[str, Reading]):
    """One reading of each sensor of a bench, by serial number, and that of a reference on the plate, where one is.

    ``now_ns`` is its time since the session began; in a journal ``line`` is that of the last event before it ended.
    """

    reference: Reading | None = None
    now_ns = line = 0

    @property
    def seconds(self) -> float:
        """Its time, seconds."""
        return self.now_ns / SECOND


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
    ``failures`` are the last ones by serial number.
    """

    def __init__(self, setup: Setup, journal: Journal) -> None:
        self.setup = setup
        self.now_ns = self.breaks = 0
        self.failures: dict[str, str] = {}
        self._journal = journal
        self._clock = VirtualClock()
        self._events = iter(journal)
        self._line = 1
        self._event: Event | None = next(self._events, None)
        self._interrupted = False
        self._since = 0  # samples of the next position
        self._given_up: set[str] = set()
        self._lacking: set[str] = set()  # the sensors that the last accepted position lacks
        self._statistics: dict[str, dict[str, int]] = {}
        self._names = [device.serial for device in self.setup.sensors]
        self._names += [*self.setup.beside]
        self._connect()

    def _connect(self) -> None:
        devices = zip(self._names, self.setup.devices, strict=True)
        self._drivers = {
            name: device.wired.driver(PlayedLink(self, device.letter, number), self._clock)
            for number, (name, device) in enumerate(devices)
        }

    def link_statistics(self) -> dict[str, dict[str, int]]:
        """Return the link statistics of each device that counts them, by serial number."""
        counted = {serial: dict(counts) for serial, counts in self._statistics.items()}
        for name, driver in self._drivers.items():
            if name not in self._given_up and (counts := driver.link_statistics()):
                before = counted.get(name, {})
                counted[name] = {what: before.get(what, 0) + n for what, n in counts.items()}
        return counted

    def __iter__(self) -> Iterator[Sample | Event]:
        begun = None
        while (event := self._event) is not None:
            if event.kind not in MARKS:
                lines = None if self._journal.coming is None else self._journal.coming.lines
                if lines is not None and lines is not begun and event.line >= lines[0]:
                    begun, self._since = lines, 0
                if (sample := self._sample(fresh=self._drops(event))) is not None:
                    self._since += 1
                    yield sample
                continue
            yield from self._kept_by_drivers(event)
            self._take(event)
            if event.kind == POSITION:
                self._lacking = {*self._names} - {*event.content(AcceptedPosition).sensors}
            elif event.kind == RESUMED:
                self._resume()
            yield event

    def _kept_by_drivers(self, event: Event) -> Iterator[Sample]:
        """Yield the samples that need no further transaction, where the session took them before an event."""
        question, wanted = event.content(OperatorAnswer).to if event.kind == ANSWER else "", 0.0
        if not self.setup.steps.positions and (event.kind in (POSITION, RESUMED) or question == "write"):
            wanted = inf
        elif question == "review":
            coming = self._journal.coming
            wanted = self.setup.settings.samples if coming is None else coming.first.taken
        while self._since < wanted and (sample := self._sample()) is not None:
            self._since += 1
            yield sample

    def _resume(self) -> None:
        """Begin anew with the drivers, as the session does; sensors given up since the last position count again."""
        self.breaks += 1
        self._statistics = self.link_statistics()
        self._connect()
        self._given_up &= self._lacking

    def answer(self, letter: str, number: int, out: bytes) -> bytes:
        """Return what a device answered to ``out``.

        BusError: it failed when it was captured, or the session was interrupted here.
        JournalError: the journal has something else here.
        """
        event = self._event
        if event is None or event.kind in MARKS:
            self._interrupted = True
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
        return bytes.fromhex(event.payload[1])

    def _sample(self, *, fresh: bool = False) -> Sample | None:
        """Return a sample of all devices; None where one of them failed, or no further is there."""
        self._interrupted = False
        readings: dict[str, Reading] = {}
        name = ""
        try:
            for number, name in enumerate(self._names) if fresh else ():
                if not self._gives_up(number):
                    self._drivers[name].discard()
            for number, (name, driver) in enumerate(self._drivers.items()):
                if not self._gives_up(number):
                    readings[name] = driver.read()
        except HardwareError as error:
            if not self._interrupted:
                self.breaks += 1
                self.failures[name] = str(named_error(name, error, alone=len(self.setup.sensors) == 1))
            return None
        sample = at_one_temperature(readings)
        sample.now_ns, sample.line = self.now_ns, self._line
        return sample

    def _drops(self, event: Event) -> bool:
        """Return whether a sample begins with a drop of what arrived; it may fail on the first device that streams."""
        if event.kind != HARDWARE_ERROR:
            return event.kind in STREAMS and event.payload[:2] == ("", "")
        number = event.payload[2] if len(event.payload) > 2 else 0
        devices = zip(self._names, self.setup.devices, strict=True)
        streaming = (n for n, (name, one) in enumerate(devices) if one.letter in STREAMS and name not in self._given_up)
        return number == next(streaming, None)

    def _gives_up(self, number: int) -> bool:
        """Return whether a device that has failed is given up: where it would be read, another one is.

        One that streams may hold a reading without a transaction; it is given up where the next position lacks it.
        """
        name, event = self._names[number], self._event
        if name not in self._given_up and name in self.failures and name not in OF_THE_BENCH and len(self._names) > 1:
            lacking = self._journal.coming is None or name not in self._journal.coming.sensors
            streams = self.setup.devices[number].letter in STREAMS
            another = event is not None and event.payload[2:] != ((number,) if number else ())
            self._given_up |= {name} if another and (lacking or not streams) else set()
        return name in self._given_up

    def _take(self, event: Event) -> None:
        """Pass the next event."""
        self._line = event.line
        self._event = next(self._events, None)
        self.now_ns += event.dt_ns
        self._clock.seek(self.now_ns)

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self._journal.path, line=event.line)


def at_one_temperature(readings: dict[str, Reading]) -> Sample:
    """Return readings by serial number with the temperature of the bench's thermometer, where it is among them."""
    thermometer, reference = (readings.pop(name, None) for name in OF_THE_BENCH)
    if thermometer is not None:
        readings = {serial: replace(one, temperature=thermometer.temperature) for serial, one in readings.items()}
    sample = Sample(readings)
    sample.reference = reference
    return sample


def named_error(name: str, error: HardwareError, *, alone: bool) -> SensorError:
    """Return an error with the name of its device, unless that is the only sensor."""
    where = () if alone and name not in OF_THE_BENCH else (f"{name.strip('()')}: ",)
    return SensorError(name, (*where, *error.words))
