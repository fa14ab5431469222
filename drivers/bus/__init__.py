"""Buses: what connects a device, and links that carry its bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple, Protocol

from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.modbus import ModbusLine


class CaptureEnded(BusError):
    """A capture has no further edges; its link stays open, because opened anew it would start at the first edge."""


class Link(Protocol):
    """One opened connection to one device.

    Every bus fits one method, so recording and replaying a session takes one class and not one per bus.
    """

    letter: str
    """The bus in a journal line: ``s`` SPI, ``i`` I2C, ``r`` serial, ``e`` edges, ``m`` Modbus, ``n`` a value by
    its name."""

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one bus transaction; one that failed is a BusError with the cause and what to try.

        out: SPI: the frame shifted out while chip select is low. I2C: the bytes written, may be empty. Serial: the
            bytes sent, may be empty.
        count: I2C: bytes to read after a repeated start. Serial and edges: the largest number of bytes to take, waiting
            for the first; with 0 and nothing to send, what has arrived is discarded, and with bytes to send and a count
            what arrived before is no part of the answer. SPI: unused, a frame reads as many
            bytes as it writes.

        Returns the answer; of serial lines and edges at least one byte or record where ``count`` is not 0.
        """
        ...

    def close(self) -> None:
        """Release the bus; closing twice is allowed."""
        ...


def require_length(answer: bytes, length: int, what: str = "transaction") -> bytes:
    """Return an answer that is as long as its transaction; another length is a BusError."""
    if len(answer) != length:
        raise BusError(f"a {what} of {length} bytes was answered with {len(answer)}: the adapter is at fault")
    return answer


def check_data_line(answers: bytes, what: str = "sample") -> None:
    """Raise a BusError for a sample with equal bits: at rest at least one channel measures gravity."""
    for level, place, byte in (("high", "chip select", 0xFF), ("low", "ground", 0x00)):
        if set(answers) == {byte}:
            raise BusError(
                f"the data line is stuck {level} (every bit of the {what} is {byte & 1}): check the data line (MISO or "
                f"SDA), {place} and the sensor's supply"
            )


class Bus(NamedTuple):
    """One kind of bus: its letter in a journal, which says what a transaction is, and what opens it.

    open: module and function, ``open(address)`` of another package; options: those of its addresses.
    """

    letter: str
    open: str | Callable[[Address], Link]
    options: tuple[str, ...] = ()


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


@dataclass(frozen=True, kw_only=True)
class Device:
    """What a bus has to know of a device.

    name: what the user types, such as ``sca100t-d02``.
    addresses: an example for each way to connect it, the preferred one first.
    options: those of an address that belong to the device and not to its bus, such as the input of x.
    spi: None where the part has no SPI.
    line: options of its serial line that an address need not state.
    bus: what opens its ``package:`` addresses: the bus of a package that adds the model, where tiltcal has none.
    """

    name: str
    addresses: tuple[str, ...]
    options: tuple[str, ...] = ()
    spi: SpiPort | None = None
    line: Mapping[str, str] = field(default_factory=dict)
    bus: Bus | None = None

    @property
    def schemes(self) -> tuple[str, ...]:
        """The address schemes that it can be connected by."""
        return tuple(dict.fromkeys(address.partition(":")[0] for address in self.addresses))


LINE = ("baudrate", "parity", "bits", "stopbits")  # options of a serial line
BUSES = {
    "spi": Bus("s", "tiltcal.drivers.bus.spi:open_spi", ("mode", "speed")),
    "i2c": Bus("i", "tiltcal.drivers.bus.i2c:open_i2c", ("address",)),
    "serial": Bus("r", "tiltcal.drivers.bus.serial:open_serial", (*LINE, "timeout")),
    "gpio": Bus("e", "tiltcal.drivers.bus.gpio:open_gpio", ("x", "y", "timeout")),
    "vcd": Bus("e", "tiltcal.drivers.bus.vcd:open_vcd", ("x", "y")),
    "modbus": Bus("m", "tiltcal.drivers.bus.modbus:open_modbus", ("unit", "timeout", *LINE)),
    "iio": Bus("n", "tiltcal.drivers.bus.attributes:open_iio"),
    "python": Bus("n", "tiltcal.drivers.bus.attributes:open_python"),
    "package": Bus("", "the bus of the package that adds the model"),
}
"""By the last part of a scheme; a converter may stand before it, as in ``ads1115+i2c``."""


def link_letter(address: Address, device: Device) -> str:
    """Return the letter of a device's bus in a journal; a virtual part has the first bus of its model."""
    scheme = device.schemes[0] if address.simulated else address.scheme
    return _bus_of(scheme, device).letter


def open_link(address: Address, device: Device, lines: MutableMapping[str, ModbusLine] | None = None) -> Link:
    """Open the bus of an address for one device, and import only that bus's library; ``sim:`` is none of them.

    lines: the Modbus lines that the caller has open already, by their port: devices on one of them share it.

    UsageError: the device does not have this scheme, or an option is wrong.
    HardwareError: the bus's library is not installed.
    BusError: no such device, or no permission.
    """
    if address.scheme not in device.schemes:
        ways = " or ".join(f"{scheme}:" for scheme in (*device.schemes, "sim"))
        address.refuse(f"{device.name} is reached by {ways} (such as {device.addresses[0]}), not by {address.scheme}:")
    bus = _bus_of(address.scheme, device)
    if not isinstance(bus.open, str):
        return bus.open(address)
    address.allow(*dict.fromkeys((*bus.options, *device.options)))
    address = replace(address, options={**device.line, **address.options})
    module, _, opener = bus.open.partition(":")
    further = (device,) if bus is BUSES["spi"] else (lines,) if bus is BUSES["modbus"] else ()
    link: Link = getattr(import_module(module), opener)(address, *further)
    return link


def _bus_of(scheme: str, device: Device) -> Bus:
    return device.bus if scheme == "package" and device.bus else BUSES[scheme.rpartition("+")[2]]
