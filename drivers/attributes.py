"""Accelerometers whose values are asked for by name: any that Linux has a driver for, and any object of Python.

``iio:device0?sensitivity=16384`` reads the ``raw`` values of an IIO device. Its name, scale, offset, mount matrix
and rate are read with each 25th sample; a device that changes one of them is refused, because a calibration holds for
the setting that it was measured in.

``python:MODULE:FACTORY`` reads an object that ``FACTORY()`` makes: its ``acceleration`` in m/s², as the drivers of
CircuitPython have it, or the numbers that it returns when it is called.

Source: Documentation/ABI/testing/sysfs-bus-iio of Linux.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from tiltcal.column_names import AXES, TEMPERATURE
from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.attributes import ACCELERATION, LETTER, as_text
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.columns import ColumnLayout, columns_of, model_of_numbers, scale_at
from tiltcal.drivers.model import OF_G, Model, Reading, Sensor, in_words
from tiltcal.drivers.virtual import HeldPose, Truth, VirtualPart
from tiltcal.errors import BusError, DeviceFault

SCALE = 16384  # of the virtual device, count/g
SETTINGS = {
    "name": ("name",),
    "scale": ("in_accel_scale", "in_accel_x_scale"),
    "offset": ("in_accel_offset", "in_accel_x_offset"),
    "mount matrix": ("in_accel_mount_matrix", "in_mount_matrix", "mount_matrix"),
    "rate": ("in_accel_sampling_frequency", "sampling_frequency"),
}
"""The attributes that a setting may have, the first one that is there; of one that has none, nothing is said."""


COMPARED_EVERY = 25  # the settings are compared with each of so many samples, the first one too


class IioSensor(Sensor):
    """The driver of an accelerometer of Linux."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._settings: dict[str, str] = {}
        self._samples = 0

    def probe(self) -> Mapping[str, str]:
        """Return the settings of the device and a reading as text."""
        self._samples = 0
        reading = self.read()
        said = dict(self._settings)
        if "scale" in said and (per_count := float(said["scale"])):
            said["scale"] += f" m/s² a count, sensitivity={OF_G['m/s2'] / per_count:.6g}"
        return said | in_words(reading, AXES, "{:g}", trimmed=True)

    def read(self) -> Reading:
        """Return the raw values.

        BusError: the device is gone, or a value is no number.
        DeviceFault: its settings have changed.
        """
        if self._samples % COMPARED_EVERY == 0:
            self._compare()
        self._samples += 1
        words = [self._text(f"in_accel_{axis}_raw") for axis in AXES]
        try:
            return Reading(tuple(float(int(word)) for word in words))
        except ValueError as cause:
            raise BusError(f"the device answers {words}, which are no counts") from cause

    def _compare(self) -> None:
        """Compare the settings with those of the first sample."""
        settings = {}
        for name, attributes in SETTINGS.items():
            texts = (self._text(attribute) for attribute in attributes)
            if text := next(filter(None, texts), ""):
                settings[name] = text
        if not settings.get("name", "").isprintable() or "name" not in settings:
            raise BusError(f"the device names itself {settings.get('name', '')!r}: is it one of Linux?")
        for name, first in self._settings.items():
            if settings.get(name) != first:
                raise DeviceFault(
                    f"the {name} of the device was {first} and is {settings.get(name)}: set it back, or calibrate anew"
                )
        self._settings = settings

    def _text(self, attribute: str) -> str:
        return whole_text(self._link.exchange(attribute.encode()))


class PythonSensor(Sensor):
    """The driver of an object of Python."""

    def __init__(self, columns: ColumnLayout, link: Link, clock: Clock) -> None:
        self._columns, self.channels = columns, columns.channels
        self._link = link

    def read(self) -> Reading:
        """Return the numbers of the object.

        BusError: it fails, or has others than the address names.
        """
        text = whole_text(self._link.exchange(ACCELERATION.encode()))
        reading = self._columns.reading(text.encode())
        if reading is None:
            wanted = ",".join(self._columns.names)
            raise BusError(f"the object gives {text!r}, not the numbers {wanted} (columns=)")
        return reading


def whole_text(answer: bytes) -> str:
    """Return a value without its line end; empty where there is none.

    BusError: the line end is missing.
    """
    if answer and not answer.endswith(b"\n"):
        raise BusError(f"the answer {answer!r} is cut off: is the device still there?")
    return answer[:-1].decode("latin-1")


class VirtualAttributes(VirtualPart):
    """A device of Linux or, where it has columns, an object of Python."""

    letter = LETTER

    def __init__(self, columns: ColumnLayout | None, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, fixture, clock)
        self._columns = columns

    def _answered(self, out: bytes, count: int) -> bytes:
        """Return the text of a value; see :class:`~tiltcal.drivers.bus.attributes.AttributeLink`."""
        name = out.decode()
        if self._columns is not None:
            return self._columns.line(self._numbers(self._columns)).strip() + b"\n"
        settings = {"name": "virtual", "in_accel_scale": as_text(OF_G["m/s2"] / SCALE), "sampling_frequency": "100"}
        if name in settings:
            return f"{settings[name]}\n".encode()
        if not name.endswith("_raw"):
            return b""
        return b"%d\n" % self._word(name.split("_")[2], 100.0, -(2**31), 2**31 - 1)

    def _numbers(self, columns: ColumnLayout) -> dict[str, float]:
        number = self._clock.now_ns() // 10_000_000
        numbers = {name: self._truth.sample(name, self._fixture, self._clock, number) for name in columns.channels}
        return {**numbers, TEMPERATURE: self._celsius()}


def _stated(address: Address, unit: str, **of_the_virtual: str) -> Address:
    """Return the address with the unit that it means, and of a virtual device with what it leaves out."""
    defaults = {"unit": unit, **(of_the_virtual if address.simulated else {})}
    return replace(address, options={**defaults, **address.options})


_NUMBERS = ("unit", "offset", "sensitivity", "low", "high")


def iio_at(address: Address) -> Model:
    """Return the accelerometer of Linux at an address."""
    return model_of_numbers(
        scale_at(_stated(address, unit="count", sensitivity=str(SCALE)), AXES),
        AXES,
        thermometer=False,
        name="iio",
        title="any accelerometer that Linux has a driver for (raw values)",
        addresses=("iio:device0?sensitivity=16384", "iio:ip:192.168.1.7/device0?sensitivity=16384"),
        resolution=1.0,
        interval=0.01,
        driver=IioSensor,
        twin=partial(VirtualAttributes, None),
        not_modelled=("other attributes than name, scale, rate and raw values",),
        options=_NUMBERS[1:],
        configure=iio_at,
    )


def python_at(address: Address) -> Model:
    """Return the object of Python at an address."""
    columns = columns_of(address, "x,y,z")
    return model_of_numbers(
        scale_at(_stated(address, unit="m/s2"), columns.channels),
        columns.channels,
        TEMPERATURE in columns.names,
        name="python",
        title="any object of Python that returns numbers, or has an acceleration",
        addresses=("python:imu:open_sensor",),
        interval=0.01,
        driver=partial(PythonSensor, columns),
        twin=partial(VirtualAttributes, columns),
        options=("columns", *_NUMBERS),
        configure=python_at,
    )


MODELS = {model.name: model for model in (at(parse_address("sim:")) for at in (iio_at, python_at))}
