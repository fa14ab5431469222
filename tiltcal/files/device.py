"""The device file, ``kind: device``: a device that prints its readings, as its manual describes it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from tiltcal.column_names import AXES, TEMPERATURE
from tiltcal.drivers import find_model
from tiltcal.drivers.columns import RAIL, Scale
from tiltcal.drivers.model import Model
from tiltcal.drivers.text_device import CHECKED, CHECKSUM, DECIMALS, TextDevice, answer_with
from tiltcal.errors import UsageError
from tiltcal.files.document import Document, read_document
from tiltcal.files.record import FromZero, Identifier, Number, Record, Text, about, one_of
from tiltcal.units import CONVENTIONS

Sent = Annotated[str, Meta(min_length=1)]


class DeviceFile(Record, kw_only=True):
    """The content of a device file."""

    name: Annotated[Identifier, about("of the model, as calibrations have it")]
    title: Annotated[Text, about("maker and device")]
    unit: Annotated[Text, about("of the readings, such as `deg`, `mrad`, `mm/m`, `g`")]
    baudrate: Annotated[Annotated[int, Meta(ge=50, le=20_000_000)], about("as `baudrate=` of an address")] = 9600
    parity: Annotated[str, one_of("N", "E", "O", "M", "S"), about("none, even, odd, mark or space", usual="`N`")] = "N"
    bits: Annotated[Annotated[int, Meta(ge=7, le=8)], about("data bits")] = 8
    ask: Annotated[
        Sent,
        about('what is sent before each reading, line end and all, such as `"#DATA\\r\\n"`; none: it speaks by itself'),
    ] = ""
    answer: Annotated[
        Text,
        about(
            "a regular expression with groups such as `X=(?P<x>[-+0-9.]+)\\s+Y=(?P<y>[-+0-9.]+)`, and `temperature`; "
            "it may reach over several lines, and no number stands beside it"
        ),
    ]
    ends: Annotated[Sent, about("what ends an answer: `lf`, `cr`, `crlf`, or its characters", usual="any line end")] = (
        ""
    )
    decimal: Annotated[str, one_of(*DECIMALS), about("`point` or `comma`", usual="`point`")] = "point"
    checksum: Annotated[
        str,
        one_of("xor", "sum", "none"),
        about(
            "`xor` or `sum` of the bytes of the group `checked`; the group `checksum` has it, hexadecimal or a byte",
            usual="`none`",
        ),
    ] = "none"
    timeout: Annotated[Annotated[float, Meta(ge=0.05, le=3600.0)], about("seconds in which an answer comes")] = 2.0
    interval: Annotated[FromZero, about("shortest time between two new readings, s")] = 0.0
    angles: Annotated[
        Annotated[str, one_of(*CONVENTIONS)] | None,
        about("each axis by itself, or pitch and roll"),
    ] = None
    offset: Annotated[Number | None, about("nominal, of a level device, unit")] = None
    sensitivity: Annotated[Number | None, about("nominal, unit/g; the units g, mg and m/s2 imply it")] = None
    low: Annotated[Number | None, about("a reading at or below it is none")] = None
    high: Annotated[Number | None, about("a reading at or above it is none")] = None

    @property
    def model(self) -> Model:
        """The sensor model that it describes."""
        return _model_of(self)

    @property
    def device(self) -> TextDevice:
        """What its driver and its virtual part are made of."""
        low, high = -RAIL if self.low is None else self.low, RAIL if self.high is None else self.high
        same = ("name", "title", "ask", "answer", "ends", "decimal", "timeout", "interval")
        return TextDevice(
            **{key: getattr(self, key) for key in same},
            scale=Scale(self.unit, self.offset, self.sensitivity, low, high, self.angles),
            checksum="" if self.checksum == "none" else self.checksum,
            line={key: str(getattr(self, key)) for key in ("baudrate", "parity", "bits", "timeout")},
        )


@lru_cache
def _model_of(file: DeviceFile) -> Model:
    try:
        return file.device.model()
    except (re.error, ValueError) as error:
        raise UsageError(f"the device {file.name} cannot be used: {error}") from None


def require_pattern(place: Document, key: str, pattern: str | None, groups: Sequence[str] = ()) -> None:
    """Refuse a text that is no regular expression, or lacks one of the groups; an InputError names the key."""
    try:
        found = re.compile(pattern or "").groupindex
    except re.error as error:
        raise place.error(f"this is no regular expression: {error}", key) from None
    if lost := [name for name in groups if name not in found]:
        raise place.error(f"nothing reads {lost[0]}: the pattern needs the group (?P<{lost[0]}>...)", key)


def device_of(document: Document) -> DeviceFile:
    """Return the content of a device file, checked; an InputError names file, line and key."""
    body = document.body("device")
    file = body.read(DeviceFile)
    require_pattern(body, "answer", file.answer, () if file.checksum == "none" else (CHECKED, CHECKSUM))
    device = file.device
    if unknown := [name for name in device.names if name not in (*AXES, TEMPERATURE)]:
        raise body.error(f"the group {unknown[0]!r} is no reading: x, y, z or temperature", "answer")
    if not device.names:
        raise body.error("nothing reads x, y or z: the pattern needs a group such as (?P<x>...)", "answer")
    if why := device.scale.objection():
        raise body.error(why, why.partition("=")[0])
    for key in ("ask", "ends"):
        text = getattr(file, key)
        if "\\" in text or max(text, default="") > "\xff":
            raise body.error(f'{text!r} is no bytes: write it in double quotes, such as "\\x02R\\r"', key)
    try:
        answer_with(device, dict.fromkeys(device.names, 1.0))
    except ValueError as error:
        raise body.error(str(error), "answer") from None
    return file


def shipped_devices() -> dict[str, Path]:
    """Return the device files that come with tiltcal, by name."""
    folder = Path(str(files("tiltcal.drivers"))) / "text_devices"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def device_named(name: str, beside: str | None = None) -> DeviceFile | None:
    """Return the device file of a path, or a shipped one by its name; None where the name is a model's.

    ``beside`` is the file whose folder a relative path counts from.
    """
    shipped = shipped_devices()
    if name in shipped:
        return device_of(read_document(shipped[name]))
    if not name.endswith((".yaml", ".yml")):
        return None
    return device_of(read_document(name if beside is None else os.path.join(os.path.dirname(beside), name)))


def model_named(name: str) -> Model:
    """Return a sensor model by its name, or that of a device file; errors are those of both."""
    file = device_named(name)
    return find_model(name) if file is None else file.model
