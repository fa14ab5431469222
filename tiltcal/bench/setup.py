"""The setup of a session: what is measured, with which devices and how.

It is declared once, and is the header of the session's journal, so a journal alone is enough to resume the session or
to make its calibration files again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

import tiltcal
from tiltcal.core.attitude import STRAIGHT, Orientation, orientation
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VIRTUAL_START
from tiltcal.drivers.model import Model
from tiltcal.errors import InputError, JournalError, UsageError
from tiltcal.files.atomic import check_writable
from tiltcal.files.base_calibration import BaseFile
from tiltcal.files.bench import BenchFile, BenchSensor, bench_of
from tiltcal.files.calibration import tilt_record
from tiltcal.files.document import Document, document_of, read_document
from tiltcal.files.journal import Journal
from tiltcal.files.moments import stamp
from tiltcal.files.procedure import Procedure, procedure_from_record
from tiltcal.files.record import AboveZero, FromOne, FromZero, Number, Record, Text, about, plain
from tiltcal.stated_arguments import require_printable

if TYPE_CHECKING:
    from tiltcal.bench.stage import ChannelMap


class BenchDevice(Record, kw_only=True):
    """A sensor or the thermometer of a session."""

    always_written = ("output",)

    model: Annotated[Text, about("as `--sensor`")]
    serial: Annotated[str, about("serial number; empty of a thermometer")]
    address: Annotated[Text, about("as `--address`")]
    output: Annotated[str, about("calibration file, relative to the journal; empty where none is made")] = ""
    axes: Annotated[
        Annotated[tuple[Text, ...], Meta(min_length=3, max_length=3)] | None,
        about("how it sits, where it does not sit straight"),
    ] = None

    @property
    def wired(self) -> Model:
        """The model as it is wired at the address."""
        return _wired(self.model, self.address)

    @property
    def orientation(self) -> Orientation:
        """How it sits on the fixture."""
        return STRAIGHT if self.axes is None else orientation(self.axes)

    @property
    def simulated(self) -> bool:
        """Whether it is a virtual twin."""
        return parse_address(self.address).simulated


@lru_cache(maxsize=64)
def _wired(model: str, address: str) -> Model:
    return find_model(model).at(parse_address(address))


class Settings(Record, kw_only=True):
    """The settings of a session: how it measures."""

    always_written = ("jig", "thermometer", "angle")

    samples: Annotated[Annotated[int, Meta(ge=2)], about("samples a position")]
    settle: Annotated[AboveZero, about("seconds over which the reading must hold still")]
    soak: Annotated[AboveZero, about("seconds of the window at a new temperature")]
    jig: Annotated[FromZero | None, about("standard uncertainty of a set angle, degrees")] = None
    thermometer: Annotated[FromZero | None, about("standard uncertainty of a temperature, °C")] = None
    table: Annotated[FromZero | None, about("uncertainty of the table's lean, degrees")] = None
    heading: Annotated[FromZero | None, about("uncertainty of a heading, degrees")] = None
    angle: Annotated[Number | None, about("the angle that the procedure leaves free, degrees")] = None
    turns: Annotated[FromOne | None, about("the most turns of a rotation")] = None


class Setup(Record, kw_only=True, dict=True):
    """The setup of a session, the first line of its journal."""

    software: Annotated[Text, about("who wrote the journal")]
    journal: Annotated[Text, about("its file name")]
    started: Annotated[Text, about("when, UTC")]
    virtual: Annotated[bool, about("whether every device is a twin")]
    operator: Annotated[Text, about("who leads: `terminal`, `json`, `sim` or `python`")]
    person: Annotated[Text | None, about("the name in the bench file")] = None
    sensors: Annotated[Annotated[tuple[BenchDevice, ...], Meta(min_length=1)], about("the sensors, in order")]
    thermometer: Annotated[BenchDevice | None, about("of a bench that has one")] = None
    settings: Annotated[Settings, about("how the session measures")]
    procedure: Annotated[Mapping[str, Any], about("the procedure file in full")]
    base: Annotated[
        Text | None, about("in older journals, the text of the calibration file that a mounting completes")
    ] = None
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
        scale = 1.0 if settle is None else settle / procedure.settle
        for path in filter(None, (journal, *outputs)):
            require_printable(str(path), "the name of a file")
        sensors, thermometer = devices_of(bench)
        sensors = tuple(
            sensor.replaced(output="" if output is None else os.path.relpath(output, journal.parent))
            for sensor, output in zip(sensors, outputs, strict=True)
        )
        virtual = all(device.simulated for device in (*sensors, *filter(None, (thermometer,))))
        setup = cls(
            software=f"tiltcal {tiltcal.__version__}",
            journal=journal.name,
            started=stamp(VIRTUAL_START if virtual else datetime.now(UTC)),
            virtual=virtual,
            operator=operator,
            person=bench.operator,
            sensors=sensors,
            thermometer=thermometer,
            settings=Settings(
                samples=samples or procedure.samples,
                settle=settle or procedure.settle,
                soak=procedure.soak.seconds * scale,
                jig=bench.jig,
                thermometer=None if bench.thermometer is None else bench.thermometer.uncertainty,
                table=bench.table,
                heading=bench.heading,
                angle=procedure.angle,
                turns=None if procedure.rotation is None else procedure.rotation.turns,
            ),
            procedure=dict(procedure.record),
            bases=bases or {},
            typical_temperature=typical,
        )
        setup.require_suitable()
        return setup

    @classmethod
    def of(cls, journal: Journal) -> Setup:
        """Read the setup of a captured session; a JournalError where the header lacks something."""
        try:
            document = document_of(journal.header, str(journal.path), 1)
            setup = document.read(cls)
            document.require_moments(setup, "started")
        except InputError as error:
            raise JournalError(
                f"the header cannot be used: {error.message}", file=journal.path, line=1, key=error.key
            ) from None
        try:
            missing = [sensor.serial for sensor in setup.sensors if sensor.serial not in setup.known]
            if setup.steps.determines.completes and missing:
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
        procedure = procedure_from_record(self.procedure, self.settings.angle)
        return procedure.with_turns(self.settings.turns)

    @property
    def began(self) -> datetime:
        """When the session began, UTC."""
        return datetime.fromisoformat(self.started)

    @property
    def devices(self) -> tuple[BenchDevice, ...]:
        """The sensors, and the thermometer behind them; a journal numbers them in this order."""
        return self.sensors if self.thermometer is None else (*self.sensors, self.thermometer)

    @property
    def simulated(self) -> bool:
        """Whether every device is a virtual twin; the clock is virtual then too."""
        return all(device.simulated for device in self.devices)

    @property
    def known(self) -> dict[str, BaseFile]:
        """The calibrations that sensors bring with them, by serial number."""
        return dict(self.bases) if self.base is None else {self.sensors[0].serial: BaseFile(self.base)}

    @property
    def verifies(self) -> bool:
        """Whether the session is a verification, which makes no calibration file."""
        return not any(sensor.output for sensor in self.sensors)

    def channel_map(self) -> ChannelMap:
        """Return which readings of the sensors are the channels of a turning stage.

        UsageError: there is no stage angle, or not one pair has its channels.
        """
        from tiltcal.bench.stage import map_channels

        if self.steps.rotation is None:
            raise UsageError(f"{self.steps.name} lets no stage turn")
        return map_channels(self.steps.rotation, [(device.serial, device.wired) for device in self.sensors])

    def header(self) -> dict[str, Any]:
        """Return the header of the session's journal as plain data."""
        return plain(self)  # type: ignore[no-any-return]

    def resume_command(self, journal: Path) -> str:
        """Return the command that continues the session; a journal does not name the calibration that is verified."""
        return f"tiltcal {'verify CAL' if self.verifies else 'measure'} --resume {quote(str(journal))}"

    def require_suitable(self) -> None:
        """Refuse a procedure that the devices cannot carry out."""
        procedure = self.steps
        if procedure.rotation is not None:
            self.channel_map()
        else:
            from tiltcal.calibration.checks import require_suitable

            for device in self.sensors:
                require_suitable(procedure, device.wired, device.orientation, based=device.serial in self.bases)
        if self.typical_temperature:
            self._require_population()

    def _require_population(self) -> None:
        """Refuse mean temperature curves that have no source, or that the procedure measures itself."""
        procedure = self.steps
        determines = procedure.determines
        if procedure.rotation is not None:
            raise UsageError(f"{procedure.name} needs no --typical-temperature: a pair has no temperature terms")
        if determines.drift or determines.gain or determines.completes:
            raise UsageError(
                f"{procedure.name} needs no --typical-temperature: it has no temperature terms, or measures them"
            )
        for device in self.sensors:
            if device.wired.population is None:
                raise UsageError(
                    f"no source states how a {device.model} behaves over temperature on average: measure it"
                )


class SessionFiles:
    """The files of a session: its journal, and where its calibrations go.

    Parameters
    ----------
    output : Path, optional
        Where the calibration files go, in place of what the setup says: a file, or of several sensors the folder.

    UsageError: the session has several sensors, and the output is no folder.
    """

    def __init__(self, setup: Setup, journal: Path, output: Path | None = None) -> None:
        self.journal = journal
        self._setup = setup
        self._named = output
        self.outputs = {device.serial: self._output(device) for device in setup.sensors if device.output}
        if output is not None and len(self.outputs) > 1 and not os.path.isdir(output):
            raise UsageError(f"the session has {len(self.outputs)} sensors: name a folder instead of {output}")

    def _output(self, device: BenchDevice) -> Path:
        planned = Path(os.path.normpath(self.journal.parent / device.output))
        if self._named is None:
            return planned
        return self._named / planned.name if os.path.isdir(self._named) else self._named

    @property
    def _outside(self) -> list[Path]:
        """The calibration files that lie outside the journal's folder."""
        folder = os.path.realpath(self.journal.parent)
        paths = self.outputs.values()
        return [path for path in paths if os.path.commonpath((folder, os.path.realpath(path))) != folder]

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

        UsageError: a path that cannot be written, or where a captured journal, which may be somebody else's, would
            replace a file that is no calibration of its sensor, or that it names outside its own folder.
        """
        if captured is not None and self._named is None and self._outside:
            raise UsageError(
                f"the journal names {self._outside[0]}, outside its own folder: say with -o where the calibration goes"
            )
        for path in self.outputs.values():
            check_writable(path, self.journal)
            if captured is not None and os.path.isfile(path) and os.path.getsize(path):
                self._require_calibration(path)
        if captured is None or captured.end is None:
            check_writable(self.journal)

    def _require_calibration(self, path: Path) -> None:
        """Refuse to replace a file that is no calibration of a sensor of the session."""
        identities = [(device.model, device.serial) for device in self._setup.sensors]
        try:
            there = _identities_in(read_document(path))
        except InputError:
            there = []
        if not (there == identities or (len(there) == 1 and there[0] in identities)):
            serials = ", ".join(serial for _, serial in identities)
            raise UsageError(
                f"cannot write {path}: the file there is no calibration of {serials}; move it away, or name another "
                "file with -o"
            )


def _identities_in(document: Document) -> list[tuple[str, str]]:
    """Return model and serial number of each sensor of a calibration file."""
    if document.kind == "pair":
        from tiltcal.files.pair import pair_record

        bench = pair_record(document).provenance.bench
        return [] if bench is None else [(one.model or "", one.serial or "") for one in bench.sensors]
    sensor = tilt_record(document).sensor
    return [(sensor.model, sensor.serial)]


def known_bench(document: Document) -> BenchFile:
    """Return the bench of a document, whose models are known and addresses right; an InputError where one is not."""
    bench = bench_of(document)
    for number, sensor in enumerate(bench.sensors):
        with document.locating("sensors", number):
            _wired(sensor.model, sensor.address)
    if bench.thermometer is not None:
        with document.locating("thermometer"):
            devices_of(bench)
    return bench


def devices_of(bench: BenchFile) -> tuple[tuple[BenchDevice, ...], BenchDevice | None]:
    """Return the devices of a bench: its sensors, and its thermometer."""
    sensors = tuple(
        BenchDevice(
            model=sensor.model,
            serial=sensor.serial,
            address=sensor.address,
            axes=None if sensor.orientation.straight else sensor.orientation.names,
        )
        for sensor in bench.sensors
    )
    if bench.thermometer is None:
        return sensors, None
    thermometer = BenchDevice(model=bench.thermometer.model, serial="thermometer", address=bench.thermometer.address)
    if not thermometer.wired.thermometer:
        raise UsageError(f"{thermometer.model} reports no temperature: it cannot be the bench's thermometer")
    return sensors, thermometer


def single(model: str, serial: str, address: str, jig: float | None = None) -> BenchFile:
    """Return a bench of one sensor, which needs no file."""
    require_printable(serial, "the serial number")
    return BenchFile((BenchSensor(serial, model, address),), jig=jig)


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
