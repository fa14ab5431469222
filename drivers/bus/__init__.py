"""Buses: addresses, and links that carry bytes."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.bus.modbus import ModbusLine

__all__ = ["BUSES", "Bus", "Device", "SpiPort", "link_letter", "open_link"]


class Bus(NamedTuple):
    """One kind of bus: its letter in a journal, which says what a transaction is, and what opens it.

    open: module and function, which returns the link: ``open(address, model)``; of another package ``open(address)``.
    """

    letter: str
    open: str | Callable[[Address], Link]


@dataclass(frozen=True, slots=True)
class SpiPort:
    """The SPI settings that a part accepts.

    modes: clock modes (CPOL and CPHA as bits 1 and 0) that the part works in, the preferred one first.
    fastest: highest clock, Hz; None where no source states it.
    speed: clock if the address states none, Hz; None is the fastest.
    slowest: lowest clock at which the part's words do not change while they are read, Hz.
    """

    modes: tuple[int, ...]
    fastest: int | None
    speed: int | None = None
    slowest: int = 1


class Device(Protocol):
    """What a bus has to know of a sensor model: see :class:`~tiltcal.drivers.model.Model`."""

    @property
    def name(self) -> str: ...
    @property
    def schemes(self) -> tuple[str, ...]: ...
    @property
    def addresses(self) -> tuple[str, ...]: ...
    @property
    def options(self) -> tuple[str, ...]: ...
    @property
    def spi(self) -> SpiPort | None: ...
    @property
    def bus(self) -> Bus | None: ...


BUSES = {
    "spi": Bus("s", "tiltcal.drivers.bus.spi:open_spi"),
    "i2c": Bus("i", "tiltcal.drivers.bus.i2c:open_i2c"),
    "serial": Bus("r", "tiltcal.drivers.bus.serial:open_serial"),
    "gpio": Bus("e", "tiltcal.drivers.bus.gpio:open_gpio"),
    "vcd": Bus("e", "tiltcal.drivers.bus.vcd:open_vcd"),
    "modbus": Bus("m", "tiltcal.drivers.bus.modbus:open_modbus"),
    "iio": Bus("n", "tiltcal.drivers.bus.attributes:open_iio"),
    "python": Bus("n", "tiltcal.drivers.bus.attributes:open_python"),
    "package": Bus("", "the bus of the package that adds the model"),
}
"""By the last part of a scheme; a converter may stand before it, as in ``ads1115+i2c``."""


def link_letter(address: Address, model: Device) -> str:
    """Return the letter of a device's bus in a journal; a virtual part has the first bus of its model."""
    scheme = model.schemes[0] if address.simulated else address.scheme
    return _bus_of(scheme, model).letter


def open_link(address: Address, model: Device, lines: MutableMapping[str, ModbusLine] | None = None) -> Link:
    """Open the bus of an address for one device, and import only that bus's library; ``sim:`` is none of them.

    lines: the Modbus lines that the caller has open already, by their port: devices on one of them share it.

    UsageError: the model does not have this scheme, or an option is wrong.
    HardwareError: the bus's library is not installed.
    BusError: no such device, or no permission.
    """
    if address.scheme not in model.schemes:
        ways = " or ".join(f"{scheme}:" for scheme in (*model.schemes, "sim"))
        address.refuse(f"{model.name} is reached by {ways} (such as {model.addresses[0]}), not by {address.scheme}:")
    bus = _bus_of(address.scheme, model)
    if not isinstance(bus.open, str):
        return bus.open(address)
    module, _, opener = bus.open.partition(":")
    open_bus = getattr(import_module(module), opener)
    link: Link = open_bus(address, model, lines) if bus is BUSES["modbus"] else open_bus(address, model)
    return link


def _bus_of(scheme: str, model: Device) -> Bus:
    return model.bus if scheme == "package" and model.bus else BUSES[scheme.rpartition("+")[2]]
