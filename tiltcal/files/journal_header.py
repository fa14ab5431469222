"""The header of a journal: the plan of its session, in the first line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

from msgspec import Meta

from tiltcal.files.base_calibration import BaseFile
from tiltcal.files.record import AboveZero, FromOne, FromZero, Number, Record, Text, about


class DeviceHeader(Record, kw_only=True):
    """A sensor or the thermometer in the header."""

    model: Annotated[Text, about("as `--sensor`")]
    serial: Annotated[str, about("serial number; empty of a thermometer")]
    address: Annotated[Text, about("as `--address`")]
    output: Annotated[str, about("calibration file, relative to the journal; empty where none is made")]
    axes: Annotated[
        Annotated[tuple[Text, ...], Meta(min_length=3, max_length=3)] | None,
        about("how it sits, where it does not sit straight"),
    ] = None


class SessionSettings(Record, kw_only=True):
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


class Header(Record, kw_only=True):
    """The plan of a session, the first line of its journal."""

    software: Annotated[Text, about("who wrote the journal")]
    journal: Annotated[Text, about("its file name")]
    started: Annotated[Text, about("when, UTC")]
    virtual: Annotated[bool, about("whether every device is a twin")]
    operator: Annotated[Text, about("who leads: `terminal`, `json`, `sim` or `python`")]
    person: Annotated[Text | None, about("the name in the bench file")] = None
    sensors: Annotated[Annotated[tuple[DeviceHeader, ...], Meta(min_length=1)], about("the sensors, in order")]
    thermometer: Annotated[DeviceHeader | None, about("of a bench that has one")] = None
    settings: Annotated[SessionSettings, about("how the session measures")]
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

    @property
    def verifies(self) -> bool:
        """Whether the session is a verification, which makes no calibration file."""
        return not any(sensor.output for sensor in self.sensors)

    def resume_command(self, journal: Path) -> str:
        """Return the command that continues the session; a journal does not name the calibration that is verified."""
        return f"tiltcal {'verify CAL' if self.verifies else 'measure'} --resume {quote(str(journal))}"

    @property
    def known(self) -> dict[str, BaseFile]:
        """The calibrations that sensors bring with them, by serial number."""
        return dict(self.bases) if self.base is None else {self.sensors[0].serial: BaseFile(self.base)}
