"""The setup of a session: what is measured, with which devices and how.

It is declared once, and is the header of the session's journal, so a journal alone is enough to resume the session or
to make its calibration files again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from tiltcal.drivers.bus.clock import SECOND
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import Argument, InputError, JournalError, UsageError
from tiltcal.files.bench import BenchFile, BenchSensor
from tiltcal.files.calibration import BaseFile
from tiltcal.files.document import document_of
from tiltcal.files.machine import Machine
from tiltcal.files.moments import moment, moment_after, stamp
from tiltcal.files.procedure import Procedure, Rotation, procedure_in
from tiltcal.files.record import AboveZero, FromOne, FromZero, Number, Record, Text, about, one_of
from tiltcal.files.results import Reference, Standard
from tiltcal.journal.lines import Journal
from tiltcal.stated_arguments import MOST
from tiltcal.units import CONVENTIONS

if TYPE_CHECKING:
    from tiltcal.core.pair.model import Pair


TYPICAL = Argument("typical_temperature")


class Settings(Record, kw_only=True):
    """The settings of a session: how it measures."""

    always_written = ("samples", "settle", "soak", "jig", "thermometer", "angle")

    samples: Annotated[Annotated[int, Meta(ge=2, le=int(MOST))], about("samples a position")] = 100
    settle: Annotated[AboveZero, about("seconds over which the reading must hold still")] = 2.0
    soak: Annotated[AboveZero, about("seconds of the window at a new temperature")] = 20.0
    jig: Annotated[FromZero | None, about("standard uncertainty of a set angle, degrees")] = None
    thermometer: Annotated[FromZero | None, about("standard uncertainty of a temperature, °C")] = None
    table_lean: Annotated[FromZero | None, about("uncertainty of the table's lean, degrees")] = None
    heading: Annotated[FromZero | None, about("uncertainty of a heading, degrees")] = None
    angle: Annotated[Number | None, about("the angle that the procedure leaves free, degrees")] = None
    angles: Annotated[
        Annotated[str, one_of(*CONVENTIONS)] | None, about("the convention of sensors that print angles")
    ] = None
    turns: Annotated[FromOne | None, about("the most turns of a rotation")] = None


class Setup(Record, kw_only=True, dict=True):
    """The setup of a session, the first line of its journal."""

    software: Annotated[Text, about("who wrote the journal")]
    journal: Annotated[Text, about("its file name")]
    started: Annotated[Text, about("when, UTC")]
    virtual: Annotated[bool, about("whether every device is a twin")]
    operator: Annotated[Text, about("who leads: `terminal`, `web`, `sim`, or `json` for a program or an object")]
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

    def stamp_after(self, now_ns: int) -> str:
        """Return the time so many nanoseconds after the begin as a stamp."""
        return stamp(moment_after(self.began, now_ns))

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
        positions = self.steps.positions
        warm = any(position.temperature is not None for position in positions)
        machines = {"table": self.table if positions else None, "chamber": self.chamber if warm else None}
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
        return stage_channels(self.steps.in_turns(), [(device.serial, device.wired) for device in self.sensors])

    def resume_command(self, journal: Path) -> str:
        """Return the command that continues the session; a journal does not name the calibration that is verified."""
        return f"tiltcal {'verify CAL' if self.verifies else 'measure'} --resume {quote(str(journal))}"


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
        return (now_ns / SECOND, *(readings[serial].values[place] for serial, place in self.places))


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


THERMOMETER = "(thermometer)"  # that of the bench, among serial numbers: none has parentheses
REFERENCE = "(reference)"  # likewise
OF_THE_BENCH = (THERMOMETER, REFERENCE)  # without which no sensor is measured


class BenchDevice(BenchSensor, kw_only=True):
    """A sensor or the thermometer of a session."""

    always_written = ("output",)

    serial: Annotated[str, about("serial number; empty of a thermometer")]
    output: Annotated[str, about("calibration file, relative to the journal; empty where none is made")] = ""


def thermometer_of(bench: BenchFile) -> BenchDevice | None:
    """Return the thermometer of a bench; a UsageError where it reports no temperature."""
    if bench.thermometer is None:
        return None
    named = bench.thermometer
    thermometer = BenchDevice(model=named.model, serial="thermometer", address=named.address, device=named.device)
    if not thermometer.wired.thermometer:
        raise UsageError(f"{thermometer.model} reports no temperature: it cannot be the bench's thermometer")
    return thermometer


class ReferenceDevice(BenchDevice, kw_only=True):
    """The reference instrument of a session."""

    zero: Annotated[FromZero, about("standard uncertainty of its zero, degrees")]
    scale: Annotated[FromZero, about("of its scale, as a share")]
    repeatability: Annotated[FromZero, about("of each of its tilts beside, degrees")]
    alignment: Annotated[FromZero, about("of its turn about the vertical, degrees")]
