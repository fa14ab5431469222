"""Analog-to-digital converters, and the supply of the sensors behind them.

A converter measures voltages; most analog sensors are ratiometric: their output is a share of their supply. A
:class:`Supply` is measured with each sample or stated, and gives the readings as shares of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from math import inf
from typing import TYPE_CHECKING, Protocol

from tiltcal.errors import DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.device import SpiPort
    from tiltcal.drivers.twin.analog import Wiring

SCHEMES = ("ads1115+i2c", "mcp3208+spi")
"""Address schemes of the converters: module and bus of each. The first one is the default of a virtual sensor."""

NOMINAL = 5.0
"""Nominal supply of analog sensors, V."""

_MODULES = tuple(scheme.partition("+")[0] for scheme in SCHEMES)


class Converter(Protocol):
    """The driver of a converter."""

    def volts(self, number: int) -> float:
        """Measure one input against ground, V.

        BusError: the transaction failed.
        DeviceFault: the input is beyond the converter's range, or the converter misbehaves.
        """
        ...


@dataclass(frozen=True)
class FrontEnd:
    """A converter with the settings of an address.

    Attributes
    ----------
    name : str
        The part of the scheme before ``+``.
    description : str
        The converter and its settings, for the operator.
    inputs : int
        Number of inputs.
    full_scale : float
        V; a larger voltage reads as full scale.
    step : float
        Of a reading, V.
    reference : float or None
        Voltage at its reference pin, V, if it has one; a sensor with the same supply is then ratiometric.
    options : tuple of str
        Options of the address that belong to it.
    driver : callable
        ``driver(link, clock)`` returns the :class:`Converter`.
    twin : callable
        ``twin(wiring, clock)`` returns a link that answers as the converter does for these input voltages.
    """

    name: str
    description: str
    inputs: int
    full_scale: float
    step: float
    reference: float | None
    options: tuple[str, ...]
    spi: SpiPort | None
    driver: Callable[[Link, Clock], Converter]
    twin: Callable[[Wiring, Clock], Link]

    @property
    def schemes(self) -> tuple[str, ...]:
        """All schemes of converters, this one's first."""
        return tuple(sorted(SCHEMES, key=lambda scheme: not scheme.startswith(f"{self.name}+")))


def find_front_end(address: Address) -> FrontEnd:
    """Return the converter of an address; ``sim:`` selects one with ``adc=``.

    UsageError: an unknown converter, or a setting that it does not have.
    """
    name = address.text("adc", _MODULES[0]) if address.simulated else address.scheme.partition("+")[0]
    if name not in _MODULES:
        known = " or ".join(f"{scheme}:" for scheme in SCHEMES)
        address.refuse(f"{name!r} is not a known converter (analog sensors are connected by {known})")
    front_end: FrontEnd = import_module(f"tiltcal.drivers.{name}").front_end(address)
    return replace(front_end, options=(*front_end.options, "adc")) if address.simulated else front_end


def take_input(address: Address, option: str, front_end: FrontEnd, default: int) -> int:
    """Return the converter input of an option; only a virtual sensor has a default.

    UsageError: it is missing, or the converter has no such input.
    """
    return address.integer(option, default if address.simulated else None, low=0, high=front_end.inputs - 1)


@dataclass(frozen=True, slots=True)
class Supply:
    """The supply of a ratiometric sensor.

    Attributes
    ----------
    number : int or None
        The input that measures it; None if it is stated.
    volts : float
        As stated; if it is measured, the nominal value.
    low, high : float
        Within these limits the sensor is ratiometric, V.
    full_scale : float
        Of the converter, V.
    reference : float or None
        Voltage at the converter's reference pin, V; None if that pin is tied to this supply or does not exist.
    """

    number: int | None
    volts: float
    low: float
    high: float
    full_scale: float = inf
    reference: float | None = None

    def shares(self, converter: Converter, numbers: Sequence[int]) -> tuple[tuple[float, ...], float]:
        """Measure inputs as shares of the supply.

        The conversions follow each other, so a change of the supply between them would look like tilt. A measured
        supply is therefore read before and after the others and interpolated: drift cancels, and only ripple faster
        than one sample remains.

        Parameters
        ----------
        numbers : sequence of int
            The inputs, in the order in which they are measured.

        Returns
        -------
        shares : tuple of float
            One per input.
        supply : float
            Mean of the measured values, or the stated value, V.

        BusError: the transaction failed.
        DeviceFault: the supply is outside the range of the sensor.
        """
        if self.number is None:
            return tuple(converter.volts(number) / self.volts for number in numbers), self.volts
        before = self._checked(converter.volts(self.number))
        volts = [converter.volts(number) for number in numbers]
        after = self._checked(converter.volts(self.number))
        slope = (after - before) / (len(numbers) + 1)
        shares = tuple(volt / (before + slope * place) for place, volt in enumerate(volts, start=1))
        return shares, (before + after) / 2.0

    def said(self, volts: float) -> str:
        """Return the supply as text, with its voltage and its source."""
        return f"{volts:.4f} V, {'stated' if self.number is None else f'measured at input {self.number}'}"

    def _checked(self, volts: float) -> float:
        # The largest code also means every larger voltage.
        if volts > 0.9995 * self.full_scale:
            raise DeviceFault(
                f"the supply at input {self.number} reads {volts:.3f} V, the full scale of this converter: state "
                "it with vdd=VOLTS, or give the converter a higher full scale"
            )
        # 1 % allows for the error of the converter, which cancels in the ratio.
        if not 0.99 * self.low <= volts <= 1.01 * self.high:
            raise DeviceFault(
                f"the supply at input {self.number} reads {volts:.3f} V, where the sensor needs {self.low:g} to "
                f"{self.high:g} V: is it switched on, and wired to this input?"
            )
        return volts


def take_supply(address: Address, front_end: FrontEnd, low: float, high: float) -> Supply:
    """Return the supply of an address: ``supply=N`` if it is measured, ``vdd=VOLTS`` if it is stated.

    A converter whose reference pin is the sensor's supply needs neither.

    Parameters
    ----------
    low, high : float
        Allowed supply of the sensor, V.

    UsageError: it is neither measured nor stated, or both, or outside the range of the converter.
    """
    if "supply" in address.options and "vdd" in address.options:
        address.refuse("options 'supply' and 'vdd' exclude each other: the supply is either measured or stated")
    supply = partial(Supply, low=low, high=high, full_scale=front_end.full_scale)
    if "vdd" in address.options:
        return supply(None, address.number("vdd", low=low, high=high), reference=front_end.reference)
    if "supply" in address.options or (front_end.reference is None and address.simulated):
        number = take_input(address, "supply", front_end, 2)
        if front_end.full_scale <= low:
            address.refuse(f"{front_end.description} cannot measure a supply of {low:g} V or more")
        return supply(number, min(NOMINAL, high), reference=front_end.reference)
    if front_end.reference is None:
        address.refuse(
            "the supply of the sensor is unknown: wire it to an input and add supply=N, or state it with vdd=VOLTS"
        )
    if not low <= front_end.reference <= high:
        address.refuse(
            f"the sensor needs a supply of {low:g} to {high:g} V, so the reference of {front_end.reference:g} V is "
            "not its supply: wire that to an input and add supply=N, or state it with vdd=VOLTS"
        )
    return supply(None, front_end.reference)


def require_apart(address: Address, wiring: dict[str, int | None]) -> None:
    """Refuse two signals on one input.

    UsageError: two options name the same input.
    """
    seen: dict[int, str] = {}
    for option, number in wiring.items():
        if number is None:
            continue
        if number in seen:
            address.refuse(f"options {seen[number]!r} and {option!r} name the same input {number}")
        seen[number] = option
