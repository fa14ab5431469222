"""What a journal holds of its session: the accepted positions, and what a ramp or a rotation has so far.

Nothing of the settling is judged a second time: an accepted position names the lines of its samples.
"""

from __future__ import annotations

from array import array
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import replace
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.samples import ReadingStep
from tiltcal.errors import InputError, JournalError
from tiltcal.files.moments import moment_after, stamp
from tiltcal.files.procedure import Position, Ramp, Rotation
from tiltcal.journal.header import BenchDevice
from tiltcal.journal.lines import ANSWER, POSITION, RESUMED, AcceptedPosition, Event, Journal, OperatorAnswer
from tiltcal.journal.playback import Playback, RecordedSample
from tiltcal.journal.positions import PositionResult, ReadingSpans, as_set, at_rail, result_of
from tiltcal.journal.reference import set_by

if TYPE_CHECKING:
    from tiltcal.core.ramp.record import RampRecord

BySerial = Mapping[str, Mapping[str, Any]]
DIGITS = 1e-9  # part of its size by which a mean may differ from the one that was accepted

FIRST = "this is the first position: there is none before it to go back to"


class RecordedSession:
    """What a journal holds of a session.

    ``accepted`` are the positions in the order of time, and ``last`` is the last of all, be it withdrawn; ``leg`` are
    the samples of a ramp since then, ``turned`` the end of a rotation. ``spans`` are what the readings span, ``steps``
    what they have shown of the steps that no model states.
    """

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.playback = Playback(journal)
        self.setup = self.playback.setup
        self.sensors = {sensor.serial: sensor for sensor in self.setup.sensors}
        self.accepted: list[PositionResult] = []
        self.last: PositionResult | None = None
        self._again: Counter[str] = Counter()
        self.leg: list[RecordedSample] = []
        self.turned: AcceptedPosition | None = None
        self.spans = ReadingSpans(self.setup.sensors)
        self._channels = self.setup.stage_channels() if isinstance(self.setup.steps, Rotation) else None
        self._ramps = isinstance(self.setup.steps, Ramp)
        self._rows = array("d")
        self._breaks = 0
        self._ramp: list[RecordedSample] = []
        self.steps = {serial: ReadingStep() for serial in self.sensors}
        # Of a position no more samples than twice those wanted are ever taken.
        self._samples: deque[RecordedSample] = deque(maxlen=2 * self.setup.settings.samples + 2)
        self._answer: OperatorAnswer | None = None
        self._sampling = False
        for item in self.playback:
            if isinstance(item, RecordedSample):
                self._take(item)
            elif item.kind == ANSWER:
                self._hear(item.content(OperatorAnswer))
            elif item.kind == POSITION:
                self._accept(item.content(AcceptedPosition), item)
            elif item.kind == RESUMED and self._channels is None:
                self._sampling = False  # until the position is asked for again; a stage turns on

    @property
    def complete(self) -> bool:
        """Whether all positions are accepted, or the rotation has ended."""
        if self._channels is not None:
            return self.turned is not None or self.journal.end is not None
        return not self.open

    @property
    def open(self) -> list[Position]:
        """The positions that are still to be taken, in the procedure's order."""
        done = {result.position.name for result in self.accepted}
        return [position for position in self.setup.steps.positions if position.name not in done]

    def takes(self, name: str) -> int:
        """Return how often a position was taken, be it one that is taken now."""
        return 1 + self._again[name]

    def accept(self, result: PositionResult) -> None:
        """Take an accepted position."""
        self.accepted.append(result)
        self.last = result

    @property
    def choosable(self) -> list[Position]:
        """The open positions that may be taken next: those of the first one's temperature, heading and stage."""
        alike = [(one.temperature, one.heading or 0.0, one.stage) for one in self.open]
        fixed = bool(self.setup.steps.once)
        return self.open[:1] if fixed else [p for p, one in zip(self.open, alike, strict=True) if one == alike[0]]

    def require_possible(self, answer: OperatorAnswer, asked: str) -> None:
        """Refuse, with an InputError, to go back, to take a position again or to choose one where that cannot be."""
        steps, names = self.setup.steps, [result.position.name for result in self.accepted]
        if answer.answer in ("again", "back") and self._ramps:
            raise InputError(steps.once)
        if answer.answer == "back" and not names:
            raise InputError(FIRST)
        chosen = answer.position
        if not chosen or chosen == asked or chosen in [one.name for one in self.choosable]:
            return
        if answer.answer == "again" and steps.once:
            raise InputError(steps.once)
        if answer.answer == "again" and chosen in names:
            return
        if chosen in [one.name for one in self.open]:
            raise InputError(
                f"{chosen} has another temperature, heading or stage angle: it comes in the procedure's order"
            )
        there = f"accepted are {', '.join(names)}" if names else "none is accepted yet"
        raise InputError(f"{chosen!r} is no position that could be taken now; {there}")

    def withdraw(self, answer: OperatorAnswer) -> None:
        """Withdraw the position that is taken ``again``, or of ``back`` the one that was accepted last in time."""
        if answer.answer == "again":
            kept = [result for result in self.accepted if result.position.name != answer.position]
            self._again[answer.position] += len(self.accepted) - len(kept)
            self.accepted[:] = kept
        # A session refuses to go back over the leg of a ramp, and before the first position.
        elif answer.answer == "back" and not self._ramps:
            del self.accepted[-1:]

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
        if not self._sampling:
            return
        if self._channels is not None:
            row = self._channels.row(sample.now_ns, sample.readings)
            if self.playback.breaks > self._breaks and self._rows:
                self._rows.extend([nan] * len(row))
            self._breaks = self.playback.breaks
            self._rows.extend(row)
        elif self._ramps:
            self.leg.append(sample)
        else:
            self._samples.append(sample)

    def _hear(self, answer: OperatorAnswer) -> None:
        self.withdraw(answer)
        if answer.to in ("position", "rotation") and answer.answer == "ready":
            self._answer, self._sampling = answer, True
            self._samples.clear()

    def _accept(self, noted: AcceptedPosition, event: Event) -> None:
        """Take an accepted position; a JournalError where its samples do not give what was accepted."""
        if self._channels is not None:
            self.turned = noted
            return
        values = noted.sensors
        asked = next((position for position in self.open if position.name == noted.position), None)
        if asked is None or self._answer is None or noted.lines is None:
            raise self._error(f"accepts {noted.position!r}, which the procedure does not ask for here", event)
        position, typed = as_set(asked, self._answer), self._answer.temperature
        if self._ramps:
            position, typed = replace(position, temperature=asked.temperature), None
            samples = [one for one in self.leg if one.line >= noted.lines[0]]
            self.leg = []
            self._ramp += samples
        else:
            samples = list(self._samples)[-noted.n - noted.left_out :]
            samples = [sample for number, sample in enumerate(samples) if number not in noted.without]
        if not samples or any(serial not in sample.readings for sample in samples for serial in values):
            raise self._error(f"accepts {noted.position!r}, and does not hold its samples", event)
        if self.setup.reference is not None:
            position = set_by(self.setup.reference, position, [sample.readings for sample in samples])
        result = result_of(
            [self.sensors[serial] for serial in values],
            position,
            asked,
            [sample.readings for sample in samples],
            stamp(moment_after(self.setup.began, samples[-1].now_ns)),
            typed=typed,
            left_out=noted.left_out,
            takes=self.takes(asked.name),
            steps=None if self._ramps else self.steps,
        )
        self._require_same_means(result, values, event)
        self.accept(result)
        self._sampling = False  # what is read until the next answer is for the operator's eyes

    def _require_same_means(
        self, result: PositionResult, values: Mapping[str, Mapping[str, Any]], event: Event
    ) -> None:
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
        """Return the accepted positions in the procedure's order, with the steps that all readings have shown."""
        names = [position.name for position in self.setup.steps.positions]
        ordered = sorted(self.accepted, key=lambda result: names.index(result.position.name))
        return [result.with_steps(self.steps) for result in ordered]

    def rotation_rows(self) -> Array:
        """Return the samples of a turning stage: seconds, angle in degrees, readings; shape (n, 2 + channels).

        A row of NaN is a break, in which a device failed or the session was interrupted.
        """
        width = 0 if self._channels is None else 2 + len(self._channels.columns)
        return np.array(self._rows).reshape(-1, width)

    def ramp_records(self) -> dict[str, RampRecord]:
        """Return the record of a ramp of each sensor, by serial number; empty of other procedures.

        A sample with a reading at a rail has no temperature.
        """
        if not self._ramps:
            return {}
        from tiltcal.core.ramp.record import ramp_record

        records = {}
        for sensor in self.at_work:
            timed = [(sample.now_ns / 1e9, sample.readings[sensor.serial]) for sample in self._ramp]
            rows = [
                (seconds, nan if at_rail(reading, sensor.wired) else reading.temperature, *reading.values)
                for seconds, reading in timed
            ]
            seconds, temperature, *readings = np.array(rows, dtype=float).T
            records[sensor.serial] = ramp_record(seconds, temperature, readings)
        return records

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self.journal.path, line=event.line)


def positions_of(journal: Journal) -> RecordedSession:
    """Return what a journal holds of its session: the accepted positions, and what a ramp or a rotation has so far.

    JournalError: a driver sends another request than the recorded one, or a position does not give its means.
    """
    return RecordedSession(journal)
