"""Values that are asked for by name: attributes of an accelerometer of Linux (``iio:``), or of an object of Python.

A transaction sends the name of a value and gets its text and a line end, or nothing where there is none of this name.
So a journal of them can be read by a person, and replayed without the device.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import import_library
from tiltcal.errors import BusError, HardwareError

LETTER = "n"
SYSFS = Path("/sys/bus/iio/devices")
ACCELERATION = "acceleration"


class AttributeLink:
    """A link whose transactions are names and texts; ``read(name)`` returns a text, empty where there is none."""

    letter = LETTER

    def __init__(self, place: str, read: Callable[[str], str]) -> None:
        self._place = place
        self._read = read

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Return the text of the value with this name.

        BusError: it cannot be read; all that a foreign object raises becomes one.
        """
        name = out.decode()
        try:
            text = self._read(name).strip()
        except Exception as cause:  # a foreign object may raise anything
            raise BusError(
                f"{self._place}: reading {name} failed ({type(cause).__name__}: {cause}): is the device still there?"
            ) from cause
        return f"{text}\n".encode() if text else b""

    def close(self) -> None:
        """Do nothing: each value is read by itself."""


def open_iio(address: Address) -> AttributeLink:
    """Open ``iio:device0`` of this machine, or ``iio:ip:HOST/device0`` of another one.

    UsageError: the address is neither.
    BusError: there is no such device.
    HardwareError: another machine needs libiio with its Python package.
    """
    host, _, device = address.path.rpartition("/")
    if not device.startswith("device") or not device[6:].isdigit() or (host and not host.startswith("ip:")):
        address.refuse("name a device of Linux, such as iio:device0, or of another machine, iio:ip:HOST/device0")
    if host:
        return AttributeLink(address.written, _remote(host, f"iio:{device}"))
    folder = SYSFS / f"iio:{device}"
    if not folder.exists():
        there = ", ".join(sorted(path.name.removeprefix("iio:") for path in SYSFS.glob("iio:device*"))) or "none"
        raise BusError(f"there is no {folder} (devices there: {there}): is the kernel's driver of the part loaded?")

    def read(name: str) -> str:
        path = folder / name
        return path.read_text(encoding="ascii") if path.exists() or name == "name" else ""

    return AttributeLink(address.written, read)


def _remote(host: str, device: str) -> Callable[[str], str]:
    iio = import_library("iio", "another machine's accelerometer needs libiio and its Python package", "pylibiio")
    try:
        there: Any = iio.Context(host).find_device(device)
    except OSError as cause:
        raise BusError(f"no iiod answers at {host} ({cause}): is it running, and the address right?") from cause
    if there is None:
        raise BusError(f"{host} has no {device}: 'iio_info -u {host}' lists what it has")

    def read(name: str) -> str:
        channels = [there.find_channel(f"accel_{axis}") for axis in "xyz"]
        attributes = [*there.attrs.values(), *(one for channel in channels for one in channel.attrs.values())]
        values = (str(one.value) for one in attributes if one.filename == name)
        return str(there.name) if name == "name" else next(values, "")

    return read


def open_python(address: Address) -> AttributeLink:
    """Import a module, also of the present folder, and call its factory: ``python:MODULE:FACTORY``.

    UsageError: the address names no module and factory, or the module has none of this name.
    HardwareError: the module cannot be imported, or the factory fails.
    """
    make, made = made_by(address)
    if hasattr(made, ACCELERATION):
        return AttributeLink(address.written, lambda _: as_text(made.acceleration))
    if callable(made):
        return AttributeLink(address.written, lambda _: as_text(made()))
    return AttributeLink(address.written, lambda _: as_text(make()))


def made_by(address: Address) -> tuple[Callable[[], Any], Any]:
    """Return the factory that an address names, and what it makes; the errors are those of :func:`open_python`."""
    name, _, factory = address.path.partition(":")
    if not name or not factory:
        address.refuse("name a module and what it calls to make the sensor, such as python:imu:open_sensor")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        make = getattr(import_module(name), factory, None)
    except (ImportError, SyntaxError) as cause:
        raise HardwareError(f"{address.written}: module {name} cannot be imported ({cause})") from cause
    if make is None:
        address.refuse(f"module {name} has no {factory}")
    try:
        return make, make()
    except Exception as cause:  # a foreign factory may raise anything
        raise HardwareError(f"{address.written}: {factory} failed ({type(cause).__name__}: {cause})") from cause


def as_text(numbers: Iterable[float] | float) -> str:
    """Return one number or several as text, each with all its digits."""
    several = (numbers,) if isinstance(numbers, float | int) else numbers
    return ",".join(repr(float(number)) for number in several)
