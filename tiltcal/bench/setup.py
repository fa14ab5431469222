"""The setup of a session: what is measured, with which devices and how.

It is declared once, and is the header of the session's journal, so a journal alone is enough to resume the session or
to make its calibration files again.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

import tiltcal
from tiltcal.bench.devices import REFERENCE, THERMOMETER, BenchDevice, ReferenceDevice, thermometer_of
from tiltcal.bench.reference import reference_of
from tiltcal.drivers.bus.clock import VIRTUAL_START
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import Argument, InputError, JournalError, UsageError
from tiltcal.files.atomic import check_writable
from tiltcal.files.bench import BenchFile, BenchSensor, bench_of, with_device_file
from tiltcal.files.calibration import BaseFile
from tiltcal.files.calibration_output import Sensors, require_replaceable, write_calibration
from tiltcal.files.device import DeviceFile
from tiltcal.files.document import Document, document_of
from tiltcal.files.journal import Journal
from tiltcal.files.machine import Machine
from tiltcal.files.moments import moment, stamp
from tiltcal.files.procedure import PositionProcedure, Positions, Procedure, Rotation, Verification, procedure_in
from tiltcal.files.record import AboveZero, FromOne, FromZero, Number, Record, Text, about, plain
from tiltcal.files.results import Reference, Standard
from tiltcal.stated_arguments import require_printable

if TYPE_CHECKING:
    from tiltcal.core.pair.model import Pair


TYPICAL = Argument("typical_temperature")


class Settings(Record, kw_only=True):
    """The settings of a session: how it measures."""

    always_written = ("samples", "settle", "soak", "jig", "thermometer", "angle")

    samples: Annotated[Annotated[int, Meta(ge=2)], about("samples a position")] = 100
    settle: Annotated[AboveZero, about("seconds over which the reading must hold still")] = 2.0
    soak: Annotated[AboveZero, about("seconds of the window at a new temperature")] = 20.0
    jig: Annotated[FromZero | None, about("standard uncertainty of a set angle, degrees")] = None
    thermometer: Annotated[FromZero | None, about("standard uncertainty of a temperature, °C")] = None
    table_lean: Annotated[FromZero | None, about("uncertainty of the table's lean, degrees")] = None
    heading: Annotated[FromZero | None, about("uncertainty of a heading, degrees")] = None
    angle: Annotated[Number | None, about("the angle that the procedure leaves free, degrees")] = None
    turns: Annotated[FromOne | None, about("the most turns of a rotation")] = None


class Setup(Record, kw_only=True, dict=True):
    """The setup of a session, the first line of its journal."""

    software: Annotated[Text, about("who wrote the journal")]
    journal: Annotated[Text, about("its file name")]
    started: Annotated[Text, about("when, UTC")]
    virtual: Annotated[bool, about("whether every device is a twin")]
    operator: Annotated[Text, about("who leads: `terminal`, `web`, `json`, `sim` or `python`")]
    person: Annotated[Text | None, about("the name in the bench file")] = None
    sensors: Annotated[Annotated[tuple[BenchDevice, ...], Meta(min_length=1)], about("the sensors, in order")]
    thermometer: Annotated[BenchDevice | None, about("of a bench that has one")] = None
    reference: Annotated[ReferenceDevice | None, about("of a bench that has a reference instrument")] = None
    table: Annotated[Machine | None, about("that moves by itself, as in the bench file")] = None
    chamber: Annotated[Machine | None, about("likewise")] = None
    references: Annotated[Mapping[Standard, Reference], about("as in the bench file")] = {}
    settings: Annotated[Settings, about("how the session measures")]
    procedure: Annotated[Mapping[str, Any], about("the procedure file in full")]
    bases: Annotated[
        Mapping[str, BaseFile],
        about("by serial number the calibration file that the sensor brings (`--base`): `name`, `text`"),
    ] = {}
    typical_temperature: Annotated[
        bool, about("`true` where the data sheet's mean temperature curves were asked for")
    ] = False

    @classmethod
    def begin(
        cls,
        procedure: Procedure,
        bench: BenchFile,
        outputs: Sequence[Path | None],
        journal: Path,
        *,
        operator: str,
        samples: int | None = None,
        settle: float | None = None,
        bases: Mapping[str, BaseFile] | None = None,
        typical: bool = False,
    ) -> Setup:
        """Return the setup of a new session.

        ``outputs`` are the calibration files, one per sensor; None where none is made. ``samples`` and ``settle`` take
        the place of the procedure's; the soaking window is scaled with ``settle``.

        UsageError: an unknown model, a bad address, or an angle that the model cannot read.
        """
        for path in filter(None, (journal, *outputs)):
            require_printable(str(path), "the name of a file")
        sensors = tuple(
            BenchDevice(
                model=sensor.model,
                serial=sensor.serial,
                address=sensor.address,
                axes=sensor.orientation.names,
                device=sensor.device,
                output="" if output is None else os.path.relpath(output, journal.parent),
            )
            for sensor, output in zip(bench.sensors, outputs, strict=True)
        )
        thermometer = thermometer_of(bench)
        reference = reference_of(bench)
        virtual = all(device.simulated for device in (*sensors, *filter(None, (thermometer, reference))))
        setup = cls(
            software=f"tiltcal {tiltcal.__version__}",
            journal=journal.name,
            started=stamp(VIRTUAL_START if virtual else datetime.now(UTC)),
            virtual=virtual,
            operator=operator,
            person=bench.operator,
            sensors=sensors,
            thermometer=thermometer,
            reference=reference,
            table=bench.table,
            chamber=bench.chamber,
            references=bench.references,
            settings=Settings(
                jig=bench.jig,
                thermometer=None if bench.thermometer is None else bench.thermometer.uncertainty,
                table_lean=bench.table_lean,
                heading=bench.heading,
                **_sampling(procedure, samples, settle),
            ),
            procedure=dict(procedure.record),
            bases=bases or {},
            typical_temperature=typical,
        )
        setup._require_suitable()
        return setup

    @classmethod
    def of(cls, journal: Journal) -> Setup:
        """Read the setup of a captured session; a JournalError where the header lacks something."""
        try:
            document = document_of(journal.header, str(journal.path), 1)
            setup = document.read(cls)
            document.require_moments(setup, "started")
            for name, reference in setup.references.items():
                document.at("references", name).require_moments(reference, "due")
        except InputError as error:
            raise JournalError(
                f"the header cannot be used: {error.message}", file=journal.path, line=1, key=error.key
            ) from None
        try:
            missing = [sensor.serial for sensor in setup.sensors if sensor.serial not in setup.bases]
            if setup.steps.needs_base and missing:
                raise UsageError(
                    f"{setup.steps.name} completes the calibration that a sensor has, and none of "
                    f"{', '.join(missing)} is in the journal: measure anew"
                )
            for device in setup.devices:
                _ = device.wired, device.orientation
        except (ValueError, InputError, UsageError) as error:
            raise JournalError(f"the header cannot be used: {error}", file=journal.path, line=1) from None
        return setup

    @cached_property
    def steps(self) -> Procedure:
        """The procedure."""
        procedure = procedure_in(document_of(self.procedure), self.settings.angle).with_turns(self.settings.turns)
        return procedure.in_positions().verifying() if self.verifies else procedure

    @property
    def began(self) -> datetime:
        """When the session began, UTC."""
        return datetime.fromisoformat(self.started)

    @property
    def devices(self) -> tuple[BenchDevice, ...]:
        """The sensors, and the others behind them; a journal numbers them in this order."""
        return (*self.sensors, *self.beside.values())

    @property
    def beside(self) -> dict[str, BenchDevice]:
        """The thermometer and the reference, by their names among serial numbers."""
        both = {THERMOMETER: self.thermometer, REFERENCE: self.reference}
        return {name: device for name, device in both.items() if device is not None}

    @property
    def simulated(self) -> bool:
        """Whether every device is a virtual twin; the clock is virtual then too."""
        return all(device.simulated for device in self.devices)

    @property
    def machines(self) -> dict[str, Machine]:
        """What moves by itself, and has something to do in the procedure."""
        warm = any(position.temperature is not None for position in self.steps.positions)
        machines = {"table": self.table, "chamber": self.chamber if warm else None}
        return {name: machine for name, machine in machines.items() if machine is not None}

    @property
    def verifies(self) -> bool:
        """Whether the session is a verification, which makes no calibration file."""
        return not any(sensor.output for sensor in self.sensors)

    def overdue(self) -> list[str]:
        """Return which references were to be calibrated again before the day on which the session began."""
        began = self.began.date()
        return [
            f"the {name} {one.id} was due for calibration on {one.due}, before this session on {began}"
            for name, one in self.references.items()
            if one.due is not None and moment(one.due).date() < began
        ]

    def stage_channels(self) -> StageChannels:
        """Return which readings of the sensors are the channels of a turning stage, as :func:`stage_channels`."""
        if not isinstance(self.steps, Rotation):
            raise UsageError(f"{self.steps.name} lets no stage turn")
        return stage_channels(self.steps, [(device.serial, device.wired) for device in self.sensors])

    def header(self) -> dict[str, Any]:
        """Return the header of the session's journal as plain data."""
        return plain(self)  # type: ignore[no-any-return]

    def resume_command(self, journal: Path) -> str:
        """Return the command that continues the session; a journal does not name the calibration that is verified."""
        return f"tiltcal {'verify CAL' if self.verifies else 'measure'} --resume {quote(str(journal))}"

    def _require_suitable(self) -> None:
        """Refuse a procedure that the devices cannot carry out, and curves that have no source or are measured."""
        steps = self.steps
        sets = isinstance(steps, Positions | Verification)
        if isinstance(steps, Positions) and steps.compares and self.reference is None:
            raise UsageError(f"{steps.name} states no angles: the bench file needs a reference, which reads them")
        if self.reference is not None and not sets:
            raise UsageError(f"{steps.name} sets no angles that a reference could read: take it out of the bench file")
        if isinstance(steps, Rotation):
            self.stage_channels()
        else:
            from tiltcal.calibration.measurement import require_suitable

            if any(self.machines.values()):
                from tiltcal.bench.machines import require_reachable

                require_reachable(self.machines, steps.positions)
            for device in self.sensors:
                require_suitable(steps.in_positions(), device.wired, device.orientation)
        if not self.typical_temperature:
            return
        if isinstance(steps, Rotation):
            raise UsageError((f"{steps.name} needs no ", TYPICAL, ": a pair has no temperature terms"))
        if steps.in_positions().thermal or steps.needs_base:
            raise UsageError((f"{steps.name} needs no ", TYPICAL, ": it has no temperature terms, or measures them"))
        for device in self.sensors:
            if device.wired.population is None:
                raise UsageError(
                    f"no source states how a {device.model} behaves over temperature on average: measure it"
                )


def _sampling(procedure: Procedure, samples: int | None, settle: float | None) -> dict[str, Any]:
    """Return the settings of a procedure, with samples and seconds that are stated in place of its own."""
    match procedure:
        case Rotation():
            return {"turns": procedure.turns}
        case PositionProcedure():
            held = settle or procedure.settle
            soak = procedure.soak.seconds * (held / procedure.settle)
            return {"samples": samples or procedure.samples, "settle": held, "soak": soak, "angle": procedure.angle}
    raise NotImplementedError


def column_name(serial: str, channel: str, *, alone: bool) -> str:
    """Return the column of a channel: its name alone, or of several devices behind the serial number."""
    return channel if alone else f"{serial}_{channel}"


@dataclass(frozen=True)
class StageChannels:
    """The column of the stage angle, those of all pairs, the pairs by their columns, and why others are not matched.

    ``places`` are where angle and readings stand: serial number of the device, and number of its channel.
    """

    phase: str
    columns: list[str]
    pairs: tuple[Pair, ...]
    left_out: tuple[str, ...]
    places: tuple[tuple[str, int], ...]

    def row(self, now_ns: int, readings: Mapping[str, Reading]) -> tuple[float, ...]:
        """Return a sample as seconds, angle in degrees, and readings."""
        return (now_ns / 1e9, *(readings[serial].values[place] for serial, place in self.places))


def stage_channels(rotation: Rotation, devices: Sequence[tuple[str, Model]]) -> StageChannels:
    """Find the channels of a rotation among devices: serial number, and model as it is wired.

    A channel is called as `tiltcal record` names its column; where only one device has a channel of the name, the name
    alone will do. So a pair file fits the logs of the same bench.

    UsageError: there is no stage angle, or not one pair has its channels.
    """
    from tiltcal.core.pair.model import Pair

    there = {
        column_name(serial, channel, alone=len(devices) == 1): (channel, (serial, place))
        for serial, model in devices
        for place, channel in enumerate(model.channels)
    }
    names = ", ".join(there) or "no readings"

    def column_of(name: str) -> str | None:
        chosen = [name] if name in there else [column for column, (channel, _) in there.items() if channel == name]
        if len(chosen) > 1:
            raise UsageError(
                f"{len(chosen)} devices have a channel {name!r}: name one in the procedure: {' or '.join(chosen)}"
            )
        return chosen[0] if chosen else None

    phase = column_of(rotation.phase)
    if phase is None:
        raise UsageError(
            f"no device has the stage angle {rotation.phase!r} (there are {names}): where a device prints it, name it "
            f"in the address, such as columns={rotation.phase},...; of a stage without an encoder record the turning "
            "with `tiltcal record`, and match the log with `tiltcal match` without --phase, which estimates the spin"
        )
    pairs, left_out = [], []
    for pair in rotation.pairs:
        columns = {name: column_of(name) for name in pair.channels}
        if missing := [name for name, column in columns.items() if column is None]:
            left_out.append(f"{pair.first} and {pair.second} are not matched: there is no {' and no '.join(missing)}")
        else:
            pairs.append(Pair(*filter(None, columns.values())))
    if not pairs:
        raise UsageError(
            f"no pair has its channels: {'; '.join(left_out)} (there are {names}): name them in the address, or copy "
            "the procedure and name your own pairs"
        )
    used = list(dict.fromkeys(column for pair in pairs for column in pair.channels))
    return StageChannels(phase, used, tuple(pairs), tuple(left_out), tuple(there[one][1] for one in (phase, *used)))


class SessionFiles:
    """The files of a session: its journal, and where its calibrations go.

    ``output`` takes the place of what the setup says: a file, or of several sensors the folder.

    UsageError: the session has several sensors, and the output is no folder.
    """

    def __init__(self, setup: Setup, journal: Path, output: Path | None = None) -> None:
        self.journal = journal
        self._identities = [(device.model, device.serial) for device in setup.sensors]
        self._turning = isinstance(setup.steps, Rotation)
        self._named = output
        planned = {
            device.serial: Path(os.path.normpath(journal.parent / device.output))
            for device in setup.sensors
            if device.output
        }
        in_folder = output is not None and os.path.isdir(output)
        if output is not None and len(planned) > 1 and not in_folder:
            raise UsageError(f"the session has {len(planned)} sensors: name a folder instead of {output}")
        self.outputs = {
            serial: path if output is None else output / path.name if in_folder else output
            for serial, path in planned.items()
        }
        folder = os.path.realpath(journal.parent)
        self._outside = [
            path for path in self.outputs.values() if os.path.commonpath((folder, os.path.realpath(path))) != folder
        ]

    def go_on(self, command: str) -> str:
        """Return how to go on after an interruption; ``command`` is the one that resumes, before ``--resume``."""
        named, paths = self._named, list(self.outputs.values())
        if named is None and self._outside:
            named = paths[0] if len(paths) == 1 else paths[0].parent
        where = "" if named is None else f" -o {quote(str(named))}"
        return (
            f"everything measured is kept; continue with: tiltcal {command} --resume {quote(str(self.journal))}{where}"
        )

    def require_writable(self, captured: Journal | None) -> None:
        """Check before the operator starts that the files can be written; a journal that has its end is not.

        UsageError: a path that cannot be written, where a file is that is no calibration of the same sensor, or that a
            captured journal, which may be somebody else's, names outside its own folder.
        """
        if captured is not None and self._named is None and self._outside:
            raise UsageError(
                f"the journal names {self._outside[0]}, outside its own folder",
                advice=("say with ", Argument("output"), " where the calibration goes"),
            )
        for serial, path in self.outputs.items():
            require_replaceable(path, self.sensors_of(serial), self.journal)
        if captured is None or captured.end is None:
            check_writable(self.journal)

    def sensors_of(self, serial: str) -> Sensors:
        """Return what the calibration in the output of a serial number is of."""
        if self._turning:
            return ("pair", *self._identities)
        return ("tilt", next(one for one in self._identities if one[1] == serial))

    def write(self, texts: Mapping[str, str], remark: Callable[[str], None] | None = None) -> list[Path]:
        """Write the calibration files, by serial number, and return their paths."""
        for serial, text in texts.items():
            write_calibration(self.outputs[serial], text, self.sensors_of(serial), remark)
        return [self.outputs[serial] for serial in texts]


def require_trusted(content: object, file: str | Path, trusted: str | None) -> None:
    """Refuse a file that would import modules of Python which nobody named.

    ``trusted`` has their names, with commas between them.

    UsageError: the addresses of a bench file or a journal name others.
    """
    named = set(re.findall(r'(?i)"address":"\s*python:([^:"]*)', json.dumps(plain(content), separators=(",", ":"))))
    if strange := named - set((trusted or "").split(",")):
        names = ", ".join(sorted(strange))
        raise UsageError(
            f"{file} names {names}, a module of Python that would be imported here and then does what it likes",
            advice=("if you trust it, say ", Argument("python", ",".join(sorted(named)))),
        )


def known_bench(document: Document) -> BenchFile:
    """Return the bench of a document, whose models are known and addresses right; an InputError where one is not."""
    bench = bench_of(document)
    for number, sensor in enumerate(bench.sensors):
        with document.locating("sensors", number):
            _ = sensor.wired
    with document.locating("thermometer"):
        thermometer_of(bench)
    for name, machine in (("table", bench.table), ("chamber", bench.chamber)):
        if machine is not None:
            from tiltcal.bench.drives import check_addresses

            with document.locating(name):
                check_addresses(machine)
    return bench


def single(
    model: str, serial: str, address: str, jig: float | None = None, device: DeviceFile | None = None
) -> BenchFile:
    """Return a bench of one sensor, which needs no file but that of a text device."""
    require_printable(serial, "the serial number")
    return BenchFile((with_device_file(BenchSensor(serial, model, address, device=device)),), jig=jig)


def free_journal(output: Path, remark: Callable[[str], None]) -> Path:
    """Return a journal's name beside the calibration file; an earlier session's journal is never touched."""
    path = output.with_name(f"{output.stem}.journal.jsonl")
    number = 2
    while os.path.exists(path):
        path = output.with_name(f"{output.stem}.{number}.journal.jsonl")
        number += 1
    if number > 2:
        remark(f"an earlier journal is kept; this session is recorded in {path}")
    return path
