"""What a journal holds of its session: the accepted positions, and what a ramp or a rotation has so far.

Nothing of the settling is judged a second time: an accepted position names the lines of its samples.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.samples import ReadingStep
from tiltcal.errors import JournalError
from tiltcal.files.procedure import Rotation
from tiltcal.journal.header import BenchDevice, Setup
from tiltcal.journal.lines import ANSWER, POSITION, RESUMED, AcceptedPosition, Event, Journal, OperatorAnswer
from tiltcal.journal.playback import Playback, Sample
from tiltcal.journal.positions import PositionResult, ReadingSpans, as_set, at_rail, result_of
from tiltcal.journal.reference import set_by
from tiltcal.journal.taken_positions import TakenPositions

if TYPE_CHECKING:
    from tiltcal.core.ramp.record import RampRecord

DIGITS = 1e-9  # part of its size by which a mean may differ from the one that was accepted


class RecordedSession(TakenPositions):
    """What a journal holds of its session, in one reading of it.

    ``leg`` are the samples of a ramp since the last position, ``turned`` is the end of a rotation. ``spans`` are what
    the readings span, ``reading_steps`` the steps that they show where no model states one. ``look`` gets each sample.

    JournalError: a driver sends another request than the recorded one, or a position does not give its means.
    """

    def __init__(
        self, journal: Journal, setup: Setup | None = None, look: Callable[[Sample], object] = lambda sample: None
    ) -> None:
        setup = setup or Setup.of(journal)
        super().__init__(setup)
        self.journal = journal
        self.playback = Playback(setup, journal)
        self.sensors = {sensor.serial: sensor for sensor in setup.sensors}
        self.leg: list[Sample] = []
        self.turned: AcceptedPosition | None = None
        self.spans = ReadingSpans(self.setup.sensors)
        self._channels = setup.stage_channels() if isinstance(setup.steps, Rotation) else None
        self._rows = array("d")
        self._breaks = 0
        self._ramp: list[Sample] = []
        self.reading_steps = {serial: ReadingStep() for serial in self.sensors}
        # Of a position no more samples than twice those wanted are ever taken.
        self._samples: deque[Sample] = deque(maxlen=2 * setup.settings.samples + 2)
        self._answer: OperatorAnswer | None = None
        self._sampling = False
        for item in self.playback:
            if isinstance(item, Sample):
                look(item)
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
            return self.turned is not None or self.journal.ended
        return not self.open

    def interrupted(self) -> JournalError:
        """Return the error of a journal without its end, which says how to go on."""
        why = f"the session was interrupted; continue it with: {self.setup.resume_command(self.journal.path)}"
        return JournalError(why, file=self.journal.path, line=self.journal.written.events + 2)

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

    def _take(self, sample: Sample) -> None:
        self.spans.add(sample)
        if not self._sampling:
            return
        if self._channels is not None:
            row = self._channels.row(sample.now_ns, sample)
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
            samples = list(self._samples)[-noted.first.taken :]
            samples = [sample for number, sample in enumerate(samples) if number not in noted.without]
        if not samples or any(serial not in sample for sample in samples for serial in values):
            raise self._error(f"accepts {noted.position!r}, and does not hold its samples", event)
        if self.setup.reference is not None:
            position = set_by(self.setup.reference, position, samples)
        result = result_of(
            [self.sensors[serial] for serial in values],
            position,
            asked,
            samples,
            self.setup.stamp_after(samples[-1].now_ns),
            typed=typed,
            left_out=noted.first.left_out,
            takes=self.takes(asked.name),
            steps=None if self._ramps else self.reading_steps,
        )
        self._require_same_means(result, noted, event)
        self.accept(result)
        self._sampling = False  # what is read until the next answer is for the operator's eyes

    def _require_same_means(self, result: PositionResult, noted: AcceptedPosition, event: Event) -> None:
        for serial, measurement in result.measurements.items():
            for channel, mean in noted.sensors[serial].mean.items():
                decoded = measurement.summaries[channel].mean if channel in measurement.summaries else nan
                if not abs(decoded - mean) <= DIGITS * max(abs(decoded), abs(mean)):
                    raise self._error(
                        f"accepts {result.position.name!r} with {mean:.9g} as {channel} of {serial}, and its samples "
                        f"give {decoded:.9g}: another version of tiltcal recorded it",
                        event,
                    )

    def results(self) -> list[PositionResult]:
        """Return the accepted positions in the procedure's order, with the steps that all readings have shown."""
        names = [position.name for position in self.setup.steps.positions]
        ordered = sorted(self.accepted, key=lambda result: names.index(result.position.name))
        return [result.with_steps(self.reading_steps) for result in ordered]

    def rotation_rows(self) -> Array:
        """Return the samples of a turning stage: seconds, angle in degrees, readings; shape (n, 2 + channels).

        A row of NaN is a break, in which a device failed or the session was interrupted.
        """
        return np.array(self._rows).reshape(-1, 2 + len(self.setup.stage_channels().columns))

    def ramp_records(self) -> dict[str, RampRecord]:
        """Return the record of a ramp of each sensor, by serial number; empty of other procedures.

        A sample with a reading at a rail has no temperature.
        """
        if not self._ramps:
            return {}
        from tiltcal.core.ramp.record import ramp_record

        records = {}
        for sensor in self.at_work:
            timed = [(sample.seconds, sample[sensor.serial]) for sample in self._ramp]
            rows = [
                (seconds, nan if at_rail(reading, sensor.wired) else reading.temperature, *reading.values)
                for seconds, reading in timed
            ]
            seconds, temperature, *readings = np.array(rows, dtype=float).T
            records[sensor.serial] = ramp_record(seconds, temperature, readings)
        return records

    def _error(self, message: str, event: Event) -> JournalError:
        return JournalError(message, file=self.journal.path, line=event.line)
