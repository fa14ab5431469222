"""The header of a journal: the plan of its session, in the first line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from tiltcal.files.base_calibration import BaseFile
from tiltcal.files.declaration import Anything, ByName, ListOf, Section, entry
from tiltcal.files.scalars import FROM_ZERO, Flag, Integer, Number, Text


@dataclass(frozen=True, kw_only=True)
class DeviceHeader:
    """A sensor or the thermometer in the header."""

    model: str = entry(Text(), "as `--sensor`")
    serial: str = entry(Text(blank=True), "serial number; empty of a thermometer")
    address: str = entry(Text(), "as `--address`")
    output: str = entry(Text(blank=True), "calibration file, relative to the journal; empty where none is made")
    axes: tuple[str, ...] | None = entry(
        ListOf(Text(), 3, 3), "how it sits, where it does not sit straight", default=None
    )


@dataclass(frozen=True, kw_only=True)
class SettingsHeader:
    """The settings of a session: how it measures."""

    samples: int = entry(Integer(minimum=2), "samples a position")
    settle: float = entry(Number(above=0.0), "seconds over which the reading must hold still")
    soak: float = entry(Number(above=0.0), "seconds of the window at a new temperature")
    jig: float | None = entry(FROM_ZERO, "standard uncertainty of a set angle, degrees", default=None, kept=True)
    thermometer: float | None = entry(FROM_ZERO, "standard uncertainty of a temperature, °C", default=None, kept=True)
    table: float | None = entry(FROM_ZERO, "uncertainty of the table's lean, degrees", default=None)
    heading: float | None = entry(FROM_ZERO, "uncertainty of a heading, degrees", default=None)
    angle: float | None = entry(Number(), "the angle that the procedure leaves free, degrees", default=None, kept=True)
    turns: int | None = entry(Integer(minimum=1), "the most turns of a rotation", default=None)


@dataclass(frozen=True, kw_only=True)
class Header:
    """The plan of a session, the first line of its journal."""

    software: str = entry(Text(), "who wrote the journal")
    journal: str = entry(Text(), "its file name")
    started: str = entry(Text(), "when, UTC")
    virtual: bool = entry(Flag(), "whether every device is a twin")
    operator: str = entry(Text(), "who leads: `terminal`, `json`, `sim` or `python`")
    person: str | None = entry(Text(), "the name in the bench file", default=None)
    sensors: tuple[DeviceHeader, ...] = entry(
        ListOf(Section(DeviceHeader), 1, says="a session has at least one sensor"), "the sensors, in order"
    )
    thermometer: DeviceHeader | None = entry(Section(DeviceHeader), "of a bench that has one", default=None)
    settings: SettingsHeader = entry(Section(SettingsHeader), "how the session measures")
    procedure: Mapping[str, Any] = entry(Anything(), "the procedure file in full")
    base: str | None = entry(
        Text(), "in older journals, the text of the calibration file that a mounting completes", default=None
    )
    bases: Mapping[str, BaseFile] = entry(
        ByName(Section(BaseFile)),
        "by serial number the calibration file that the sensor brings (`--base`): `name`, `text`",
        default={},
    )
    typical_temperature: bool = entry(
        Flag(), "`true` where the data sheet's mean temperature curves were asked for", default=False
    )

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


HEADER = Section(Header)
"""The header of a journal, without the version and the check."""
