"""One session at the bench: a plan carried out, captured, and turned into calibration files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, BinaryIO, cast

from tiltcal.bench.device_setup import DeviceSetup
from tiltcal.bench.event_log import EventLog, RecordedClock
from tiltcal.bench.operators.operator import PositionOperator, RotationOperator
from tiltcal.bench.operators.sim import SimOperator, SimRotationOperator
from tiltcal.bench.position_runner import PositionRunner
from tiltcal.bench.recording import sample_rows
from tiltcal.bench.sample_checks import ReadingSpans
from tiltcal.bench.sensor_set import SensorSet, connected, probe_devices
from tiltcal.bench.session_calibration import SessionEnd, tilt_calibrations, tilt_provenance
from tiltcal.bench.session_plan import SessionPlan
from tiltcal.bench.virtual_bench import VirtualBench
from tiltcal.calibration.record import record_in
from tiltcal.calibration.verification import Verification, verify_positions
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.model import Reading
from tiltcal.errors import HardwareError, InputError, Stopped, TiltcalError, UsageError
from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.calibration import CalibrationRecord, dump_calibration
from tiltcal.files.document import read_document
from tiltcal.files.journal import Journal, JournalWriter, read_journal
from tiltcal.files.moments import moment_after
from tiltcal.files.record import plain

if TYPE_CHECKING:
    from tiltcal.files.pair import PairRecord
    from tiltcal.files.rotation import Rotation


@dataclass(frozen=True)
class SessionResult:
    """The result of a session.

    Attributes
    ----------
    calibrations : dict of Path to CalibrationRecord or PairRecord
        By the file that each goes to.
    """

    calibrations: dict[Path, CalibrationRecord | PairRecord]
    ending: SessionEnd

    @property
    def texts(self) -> dict[Path, str]:
        """The calibration files' texts, by where they go."""
        return {path: _text(record) for path, record in self.calibrations.items()}

    def write(self) -> None:
        """Write the calibration files."""
        for path, text in self.texts.items():
            write_whole(path, text)

    def require_all(self) -> None:
        """Refuse a session in which sensors were given up.

        HardwareError: with the reasons.
        """
        if self.ending.lost:
            raise HardwareError("no calibration file for " + "; ".join(self.ending.lost.values()))


@dataclass(frozen=True)
class _OpenSession:
    """The open devices of a session; every byte passes through its event log."""

    sensors: SensorSet
    log: EventLog
    clock: RecordedClock
    live: bool


class Session:
    """A plan being carried out, live, resumed or replayed.

    Parameters
    ----------
    path : Path
        The journal.
    journal : Journal, optional
        What was captured before.
    output : Path, optional
        Where the calibration files go, in place of what the plan says: a file, or of several sensors the folder.
    """

    def __init__(
        self, plan: SessionPlan, path: Path, journal: Journal | None = None, output: Path | None = None
    ) -> None:
        self.plan = plan
        self.path = path
        self.journal = journal
        self._named = output
        self._captured = journal is not None
        self._finished = False
        self._clock = session_clock(plan.started, virtual=plan.virtual)
        self._virtual = VirtualBench(self._clock, plan.devices)
        self._probed: dict[str, Reading] = {}

    @classmethod
    def of_journal(
        cls, path: Path, remark: Callable[[str], None] = lambda line: None, output: Path | None = None
    ) -> Session:
        """Return the session of a journal, to be resumed or replayed; a torn last line is a remark.

        JournalError: the journal cannot be read or used.
        UsageError: the session has several sensors, and the output is no folder.
        """
        journal = read_journal(path)
        if journal.torn:
            remark(f"{path}: the last line was torn off and is dropped")
        session = cls(SessionPlan.from_journal(journal), path, journal, output)
        if output is not None and len(session.outputs) > 1 and not os.path.isdir(output):
            raise UsageError(f"the session has {len(session.outputs)} sensors: name a folder instead of {output}")
        return session

    @contextmanager
    def resumable(self, command: str, remark: Callable[[str], None]) -> Iterator[None]:
        """Say how to go on, where an error ends the block and the journal has a begin and no end.

        Parameters
        ----------
        command : str
            The command that resumes, with its arguments before ``--resume``.
        remark : callable
            Gets the line where the error's own message is about something else.
        """
        named = self._named
        if named is None and self._outside:
            named = self.outputs[0] if len(self.outputs) == 1 else self.outputs[0].parent
        where = "" if named is None else f" -o {quote(str(named))}"
        go_on = f"everything measured is kept; continue with: tiltcal {command} --resume {quote(str(self.path))}{where}"
        try:
            yield
        except (KeyboardInterrupt, TiltcalError) as error:
            if not self._captured:
                raise
            if isinstance(error, KeyboardInterrupt):
                raise Stopped(f"interrupted; {go_on}") from None
            if isinstance(error, Stopped):
                raise Stopped(f"{error}; {go_on}") from None
            if not isinstance(error, HardwareError):
                remark(go_on)
            elif not self._finished:
                raise HardwareError(f"{error}; {go_on}") from None
            raise

    @property
    def outputs(self) -> list[Path]:
        """The calibration files, one per sensor, or one for all pairs of a stage."""
        return [self._output(device) for device in self.plan.sensors if device.output]

    @property
    def _ended(self) -> bool:
        """Whether the journal that is gone on with has its end."""
        return self.journal is not None and self.journal.end is not None

    @property
    def _outside(self) -> list[Path]:
        """The calibration files that lie outside the journal's folder."""
        folder = os.path.realpath(self.path.parent)
        return [path for path in self.outputs if os.path.commonpath((folder, os.path.realpath(path))) != folder]

    def require_writable(self) -> None:
        """Check before the operator starts that the files can be written; a journal that has its end is not.

        UsageError: a path that cannot be written, or where a journal would replace a file that is no calibration of its
            sensor, or that it names outside its own folder.
        """
        if self.journal is not None and self._named is None and self._outside:
            # The journal may be somebody else's.
            raise UsageError(
                f"the journal names {self._outside[0]}, outside its own folder: say with -o where the calibration goes"
            )
        for path in self.outputs:
            check_writable(path, self.path)
            if self.journal is not None and os.path.isfile(path) and os.path.getsize(path):
                self._require_calibration_of_plan(path)
        if not self._ended:
            check_writable(self.path)

    def _require_calibration_of_plan(self, path: Path) -> None:
        """Refuse a file that is no calibration of a sensor of the plan: the journal may be somebody else's."""
        identities = [(device.model_name, device.serial) for device in self.plan.sensors]
        try:
            there = record_in(read_document(path))
        except InputError:
            there = None
        if isinstance(there, CalibrationRecord):
            replaceable = (there.sensor.model, there.sensor.serial) in identities
        else:
            bench = None if there is None else there.provenance.bench
            replaceable = bench is not None and [(one.model, one.serial) for one in bench.sensors] == identities
        if not replaceable:
            serials = ", ".join(serial for _, serial in identities)
            raise UsageError(
                f"cannot write {path}: the file there is no calibration of {serials}; move it away, or name another "
                "file with -o"
            )

    def probe(self) -> None:
        """Check before the operator starts that every device answers; a journal that has its end needs none.

        HardwareError: a device that does not answer.
        """
        probed = probe_devices(() if self._ended else self.plan.devices, self._virtual, self._clock, read=True)
        self._probed = {device.serial: reading for device, reading in zip(self.plan.sensors, probed, strict=False)}
        self._clock.seek(0)

    def run(
        self, operator: PositionOperator | RotationOperator | None, samples: BinaryIO | None = None
    ) -> SessionResult:
        """Carry the session out, go on with it, or replay it.

        Parameters
        ----------
        operator : PositionOperator, RotationOperator or None
            Of the kind that the procedure needs; None replays the journal without hardware.
        samples : BinaryIO, optional
            Gets every sample of the session as the rows of a log.

        JournalError: the journal does not fit, or a replay ends before the session did.
        TiltcalError: what stopped it; everything that was measured is in the journal.
        """
        with self._open(live=operator is not None, samples=samples) as opened:
            rotation = self.plan.procedure.rotation
            if rotation is not None:
                return self._match(rotation, opened, cast(RotationOperator, operator or SimRotationOperator()))
            positions = cast(PositionOperator, operator or SimOperator())
            runner = self._position_runner(opened, positions)
            accepted = runner.run()
            if not self.outputs:  # a verification
                return SessionResult({}, self._finish(opened))
            found = tilt_calibrations(
                self.plan, opened.sensors.sensors, accepted, runner.records, runner.unseen, opened.sensors.reopened
            )
            files = {self._output(device): device for device in self.plan.sensors if device.serial in found}
            opened.log.ask("write", positions.confirm_write, list(files))
            end = self._finish(opened)
            calibrations: dict[Path, CalibrationRecord | PairRecord] = {
                path: replace(found[device.serial], provenance=tilt_provenance(self.plan, device, end))
                for path, device in files.items()
            }
            return SessionResult(calibrations, end)

    def replay(self, samples: BinaryIO | None = None) -> SessionResult:
        """Run a captured session again without hardware, as :meth:`run` without an operator."""
        return self.run(None, samples)

    def verify(self, operator: PositionOperator, calibration: CalibrationRecord, limit: float) -> Verification:
        """Take the positions, or go on with them, and judge a calibration of the sensor by a limit in degrees.

        TiltcalError: what stopped it; everything that was measured is in the journal.
        """
        with self._open(live=True) as opened:
            accepted = self._position_runner(opened, operator).run()
            (sensor,), jig = self.plan.sensors, self.plan.settings.jig
            measurements = [result.measurements[sensor.serial] for result in accepted]
            found = verify_positions(calibration, measurements, jig)
            self._finish(opened)
            return Verification(calibration.sensor, found, limit, jig)

    def _position_runner(self, opened: _OpenSession, operator: PositionOperator) -> PositionRunner:
        fixture = self._virtual.fixture if self.plan.virtual and opened.live else None
        spans = ReadingSpans(opened.sensors.sensors)
        spans.add(self._probed)
        if self.plan.procedure.ramp is not None:
            from tiltcal.bench.ramp_runner import RampRunner

            ramp = self.plan.procedure.ramp
            return RampRunner(ramp, self.plan, opened.sensors, operator, opened.log, opened.clock, spans, fixture)
        return PositionRunner(self.plan, opened.sensors, operator, opened.log, opened.clock, spans, fixture)

    def _match(self, rotation: Rotation, opened: _OpenSession, operator: RotationOperator) -> SessionResult:
        """Let the stage turn, and match its pairs."""
        from tiltcal.bench.rotation_runner import RotationRunner, pair_calibration

        plan = self.plan
        channels = plan.channel_map(rotation)
        runner = RotationRunner(rotation, channels, opened.sensors, operator, opened.log, opened.clock)
        turned = runner.run(plan.procedure.title)
        opened.log.ask("write", operator.confirm_write, self.outputs)
        end = self._finish(opened)
        return SessionResult({self.outputs[0]: pair_calibration(plan, channels, turned, end)}, end)

    @contextmanager
    def _open(self, *, live: bool, samples: BinaryIO | None = None) -> Iterator[_OpenSession]:
        """Connect the devices to an event log for the time of the block."""
        plan = self.plan
        with self._writer(live) as writer:
            log = EventLog(self._clock, self.journal, writer)
            clock = RecordedClock(log, self._clock)
            with connected(plan.sensors, plan.thermometer, log, clock, self._virtual) as sensors:
                if samples is not None:
                    sensors.listen(sample_rows(samples, sensors, plan.started, log))
                yield _OpenSession(sensors, log, clock, writer is not None)

    @contextmanager
    def _writer(self, live: bool) -> Iterator[JournalWriter | None]:
        """Open the journal for live events; None in a replay, and for a journal that has its end."""
        if not live or self._ended:
            yield None
            return
        if self.journal is None:
            writer = JournalWriter.create(self.path, plain(self.plan.header()))
            self._captured = True
        else:
            writer = JournalWriter.resume(self.journal)
        try:
            yield writer
        finally:
            writer.close()

    def _finish(self, opened: _OpenSession) -> SessionEnd:
        """End the journal; there is nothing to resume then."""
        ended = moment_after(self.plan.started, opened.log.now_ns())
        sha256 = opened.log.finish()
        self._finished = True
        return SessionEnd(ended, sha256, opened.sensors.lost, opened.sensors.link_statistics())

    def _output(self, device: DeviceSetup) -> Path:
        planned = Path(os.path.normpath(self.path.parent / device.output))
        if self._named is None:
            return planned
        return self._named / planned.name if os.path.isdir(self._named) else self._named


def _text(record: CalibrationRecord | PairRecord) -> str:
    """Return the text of a calibration file."""
    if isinstance(record, CalibrationRecord):
        return dump_calibration(record)
    from tiltcal.files.pair import dump_pair

    return dump_pair(record)
