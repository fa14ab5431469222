"""One session at the bench: a plan carried out, captured, and turned into calibration files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import BinaryIO, TypeVar

from tiltcal.bench.channel_map import map_channels
from tiltcal.bench.connection import connected, open_device
from tiltcal.bench.event_log import EventLog, RecordedClock
from tiltcal.bench.operators.operator import Operator
from tiltcal.bench.position_runner import PositionRunner
from tiltcal.bench.recorded_operator import RecordedOperator
from tiltcal.bench.recording import sample_rows
from tiltcal.bench.rotation_runner import RotationResult, RotationRunner
from tiltcal.bench.sensor_set import SensorSet
from tiltcal.bench.session_calibration import (
    MeasuredPositions,
    SessionEnd,
    pair_calibration,
    tilt_calibrations,
    tilt_provenance,
)
from tiltcal.bench.session_plan import DeviceSetup, SessionPlan
from tiltcal.bench.virtual import VirtualBench
from tiltcal.drivers.bus.clock import Clock, SystemClock, VirtualClock
from tiltcal.drivers.device import Model, StreamingSensor
from tiltcal.errors import HardwareError
from tiltcal.files.calibration import CalibrationRecord, dump_calibration
from tiltcal.files.journal import Journal, JournalWriter
from tiltcal.files.pair import dump_pair
from tiltcal.files.rotation import Rotation
from tiltcal.files.whole import check_writable, write_whole

T = TypeVar("T")


@dataclass(frozen=True)
class SessionResult:
    """What a session gave.

    Attributes
    ----------
    texts : dict of Path to str
        The calibration files, by where they go.
    lost : dict of str to str
        Why sensors were given up, by serial number.
    link_statistics_by_serial : dict of str to mapping of str to int
        By serial number: what became of what a sensor said that talks by itself.
    """

    texts: dict[Path, str]
    lost: dict[str, str]
    link_statistics_by_serial: dict[str, Mapping[str, int]]


class Session:
    """A plan being carried out, live, resumed or replayed.

    Parameters
    ----------
    plan : SessionPlan
    path : Path
        The journal.
    journal : Journal, optional
        What was captured before.

    Attributes
    ----------
    finished : bool
        Whether the journal has its end, so that there is nothing to resume.
    """

    def __init__(self, plan: SessionPlan, path: Path, journal: Journal | None = None) -> None:
        self.plan = plan
        self.path = path
        self.finished = False
        self._journal = journal
        self._samples: BinaryIO | None = None
        self._clock: Clock = VirtualClock() if plan.virtual else SystemClock(int(plan.started.timestamp() * 1e9))
        self._virtual = VirtualBench(self._clock, plan.devices)

    @property
    def outputs(self) -> list[Path]:
        """Where the calibration files go, one per sensor."""
        return [self._output(place) for place in self.plan.places if place.output]

    @property
    def models(self) -> dict[str, Model]:
        """The model of each sensor, by serial number."""
        return {place.serial: place.fitted for place in self.plan.places}

    def preflight(self) -> None:
        """Before the operator starts: the files can be written, and every device answers.

        Raises
        ------
        UsageError
            A path that cannot be written.
        HardwareError
            A device that does not answer.
        """
        for path in (*self.outputs, self.path):
            check_writable(path)
        for place in self.plan.devices:
            with closing(open_device(place, self._virtual)) as link:
                place.fitted.driver(link, self._clock).probe()
        self._clock.seek(0)

    def measure(self, operator: Operator) -> SessionResult:
        """Carry the session out, or go on with it, and write the calibration files.

        Raises
        ------
        HardwareError
            Sensors were given up; the files of the others are written.
        TiltcalError
            What stopped it; everything that was measured is in the journal.
        """
        result = self._concluded(operator, self._live_writer())
        for path, text in result.texts.items():
            write_whole(path, text)
        operator.done(list(result.texts), self.path)
        if result.lost:
            raise HardwareError("no calibration file for " + "; ".join(result.lost.values()))
        return result

    def replay(self, operator: Operator, samples: BinaryIO | None = None) -> SessionResult:
        """Run a captured session again without hardware.

        Parameters
        ----------
        operator : Operator
        samples : BinaryIO, optional
            Has every sample of the session as the rows of a log.

        Raises
        ------
        JournalError
            The journal does not fit, or ends before the session did.
        """
        self._samples = samples
        return self._concluded(operator, None)

    def walk(self, operator: Operator, conclude: Callable[[MeasuredPositions], T]) -> tuple[T, SessionEnd]:
        """Take the positions, or go on with them, and draw a conclusion from them that is no calibration file.

        Parameters
        ----------
        operator : Operator
        conclude : callable
            Told what was measured, before the journal ends; its errors leave the session to be resumed.

        Returns
        -------
        conclusion
            What ``conclude`` returned.
        ending : SessionEnd
        """
        return self._walk(operator, self._live_writer(), lambda walked, runner: conclude(walked))

    def _live_writer(self) -> JournalWriter | None:
        """Where live events go; None for a journal that has its end."""
        if self._journal is None:
            return JournalWriter.create(self.path, self.plan.header())
        return JournalWriter.resume(self._journal) if self._journal.end is None else None

    def _concluded(self, operator: Operator, writer: JournalWriter | None) -> SessionResult:
        """Carry the procedure out and make the calibration files' texts."""
        if self.plan.procedure.rotation is not None:
            return self._matched(operator, writer, self.plan.procedure.rotation)

        def conclude(walked: MeasuredPositions, runner: PositionRunner) -> dict[DeviceSetup, CalibrationRecord]:
            found = tilt_calibrations(self.plan, walked)
            kept = {place: found[place.serial] for place in self.plan.places if place.serial in found}
            runner.confirm_write(lambda: operator.write([self._output(place) for place in kept]))
            return kept

        calibrations, ending = self._walk(operator, writer, conclude)
        texts = {
            self._output(place): dump_calibration(replace(one, provenance=tilt_provenance(self.plan, place, ending)))
            for place, one in calibrations.items()
        }
        return SessionResult(texts, ending.lost, ending.link_statistics_by_serial)

    def _matched(self, operator: Operator, writer: JournalWriter | None, rotation: Rotation) -> SessionResult:
        """Let the stage turn, and make the text of the pair file."""
        plan = self.plan
        hookup = map_channels(rotation, [(place.serial, place.fitted) for place in plan.places])
        (output,) = self.outputs

        def turn(rack: SensorSet, tape: EventLog, clock: RecordedClock) -> RotationResult:
            desk = RecordedOperator(tape)
            turned = RotationRunner(rotation, hookup, rack, operator, desk, tape, clock).run(plan.procedure.title)
            desk.ask("write", lambda: operator.write([output]))
            return turned

        turned, ending = self._on_tape(writer, turn)
        text = dump_pair(pair_calibration(plan, hookup, turned, ending))
        return SessionResult({output: text}, ending.lost, ending.link_statistics_by_serial)

    def _walk(
        self,
        operator: Operator,
        writer: JournalWriter | None,
        conclude: Callable[[MeasuredPositions, PositionRunner], T],
    ) -> tuple[T, SessionEnd]:
        """Take every position of the procedure, and draw a conclusion before the journal ends."""
        plan = self.plan
        fixture = self._virtual.fixture if plan.virtual and writer is not None else None

        def walk(rack: SensorSet, tape: EventLog, clock: RecordedClock) -> T:
            runner = PositionRunner(plan.procedure, rack, operator, tape, clock, plan.settings, fixture)
            taken = runner.run()
            return conclude(MeasuredPositions(rack.bays, tuple(taken)), runner)

        return self._on_tape(writer, walk)

    def _on_tape(
        self, writer: JournalWriter | None, work: Callable[[SensorSet, EventLog, RecordedClock], T]
    ) -> tuple[T, SessionEnd]:
        """Do something with the rack whose every byte and answer is on the tape, and end the tape."""
        tape = EventLog(self._clock, self._journal, writer)
        clock = RecordedClock(tape, self._clock)
        plan = self.plan
        try:
            with connected(plan.places, plan.thermometer, tape, clock, self._virtual) as rack:
                if self._samples is not None:
                    rack.tell(sample_rows(self._samples, rack.bays, plan.started, tape, plan.thermometer is not None))
                conclusion = work(rack, tape, clock)
                ended = plan.started + timedelta(microseconds=tape.now_ns() / 1000)
                sha256 = tape.finish()
                self.finished = True
        finally:
            if writer is not None:
                writer.close()
        link_statistics_by_serial = {
            bay.serial: bay.sensor.link_statistics() for bay in rack.bays if isinstance(bay.sensor, StreamingSensor)
        }
        return conclusion, SessionEnd(ended, sha256, rack.lost, link_statistics_by_serial)

    def _output(self, place: DeviceSetup) -> Path:
        return Path(os.path.normpath(self.path.parent / place.output))
