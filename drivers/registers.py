"""Parts with byte registers and readings in counts: transactions, checks, and options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, TypeVar

from tiltcal.drivers.bus.link import require_length
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.link import Link

Register = Callable[[int], int]
"""Converts a register to its byte on a bus."""

R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class RegisterPort:
    """Registers of one byte, read in bursts and written one by one, on SPI or I2C.

    Attributes
    ----------
    link : Link
        Its letter is the bus.
    read_command, write_command : callable
        The first byte of an SPI frame, by register.
    pointer : callable
        The first byte of an I2C transaction, by register.
    """

    link: Link
    read_command: Register
    write_command: Register
    pointer: Register = int

    def read(self, first: int, count: int) -> bytes:
        """Return ``count`` registers of one transaction, from ``first`` on in the order of the part.

        Raises
        ------
        BusError
            The transaction failed.
        """
        if self.link.letter == "i":
            return require_length(self.link.exchange(bytes([self.pointer(first)]), count), count)
        return require_length(self.link.exchange(bytes([self.read_command(first), *bytes(count)])), 1 + count)[1:]

    def write(self, register: int, value: int) -> None:
        """Set one register.

        BusError: the transaction failed.
        """
        command = self.pointer if self.link.letter == "i" else self.write_command
        self.link.exchange(bytes([command(register), value]))


def check_data_line(answers: bytes) -> None:
    """Raise an error for a sample with equal bits: at rest at least one channel measures gravity.

    BusError: every byte is 0xFF, or every byte is 0.
    """
    if set(answers) == {0xFF}:
        raise BusError(
            "the data line is stuck high (every bit of the sample is 1): check the data line (MISO or SDA), "
            "chip select and the sensor's supply"
        )
    if set(answers) == {0x00}:
        raise BusError(
            "the data line is stuck low (every bit of the sample is 0): check the data line (MISO or SDA), "
            "ground and the sensor's supply"
        )


def in_counts(values: Iterable[float]) -> dict[str, str]:
    """Return the readings of x, y and z, as far as there are any, as text."""
    return {channel: f"{value:.0f} count" for channel, value in zip("xyz", values, strict=False)}


def choose_range(address: Address, ranges: Mapping[str, R], default: R) -> R:
    """Return the value of the option ``range``: one of the words, or the number of one that ends in g."""
    if f"{address.options.get('range', '')}g" in ranges:
        return ranges[f"{address.options['range']}g"]
    return address.choice("range", ranges, default)


def slowest_clock(count: int, rate: float) -> int:
    """Return the lowest SPI clock at which a burst of ``count`` registers ends before the next word is due, Hz."""
    return ceil(8 * (1 + count) * rate)
