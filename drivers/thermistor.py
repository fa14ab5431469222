"""A thermistor in a divider at a converter's input: a thermometer for sensors without one.

::

    ads1115+i2c:///dev/i2c-1?address=0x48&channel=3&supply=2&beta=3950&r0=10000&t0=25&fixed=10000
    mcp3208+spi:///dev/spidev0.1?channel=3&vref=5.0&a=1.129e-3&b=2.341e-4&c=8.775e-8&fixed=10000&to=supply

``channel`` is its input, ``fixed`` the divider's other resistor in Ω, and ``to`` the potential at its other end:
``ground`` (the default) or ``supply``. The output is a share of the supply, which the address states as for the analog
sensors: see :mod:`tiltcal.drivers.analog`. Its curve is that of Steinhart and Hart, temperature in K, resistance in Ω::

    1/T = a + b ln R + c (ln R)³

or that of a ``beta`` in K, with ``r0`` Ω at ``t0`` °C (default 25 °C)::

    1/T = 1/T0 + ln(R / R0) / beta

which is the same curve with c = 0.

Source: Steinhart and Hart, Calibration curves for thermistors, Deep-Sea Research 15 (1968).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import cbrt, exp, inf, log, sqrt
from typing import TYPE_CHECKING

from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.converter import FrontEnd, Supply, find_front_end, require_apart, take_input, take_supply
from tiltcal.drivers.device import Model, Reading, from_twin
from tiltcal.errors import DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

ZERO_CELSIUS = 273.15
"""K."""

OPTIONS = ("channel", "beta", "r0", "t0", "a", "b", "c", "fixed", "to", "supply", "vdd")
"""Of an address, without those of the converter."""

SUPPLY = (1.0, 5.5)
"""Limits of the converters, V; a divider works with any supply."""

SHORTED, OPEN = 0.005, 0.995
"""Shares of the supply that only a broken divider reaches."""


@dataclass(frozen=True, slots=True)
class Curve:
    """The curve of Steinhart and Hart, 1/T = a + b ln R + c (ln R)³ in K and Ω.

    Attributes
    ----------
    a, b, c : float
        1/K. ``b`` is positive and ``c`` is not negative, so the temperature falls as the resistance rises.
    """

    a: float
    b: float
    c: float

    @classmethod
    def from_beta(cls, beta: float, r0: float, t0: float) -> Curve:
        """Return the curve of a beta in K through r0 in Ω at t0 in °C."""
        return cls(1.0 / (t0 + ZERO_CELSIUS) - log(r0) / beta, 1.0 / beta, 0.0)

    def celsius(self, ohms: float) -> float:
        """Return the temperature at a resistance, °C.

        DeviceFault: the curve has no temperature there.
        """
        x = log(ohms)
        inverse = self.a + self.b * x + self.c * x**3
        if inverse <= 0.0:
            raise DeviceFault(
                f"the thermistor's curve has no temperature at {ohms:.4g} Ω: check its coefficients, their units "
                "(1/K, Ω) and the fixed resistor"
            )
        return 1.0 / inverse - ZERO_CELSIUS

    def ohms(self, celsius: float) -> float:
        """Return the resistance at a temperature, Ω: the real root of the cubic, by Cardano's formula."""
        rest = self.a - 1.0 / (celsius + ZERO_CELSIUS)
        if self.c == 0.0:
            return exp(-rest / self.b)
        p, q = self.b / self.c, rest / self.c
        # The product of the two cube roots is -p/3.
        first = cbrt(sqrt((p / 3.0) ** 3 + (q / 2.0) ** 2) - q / 2.0)
        return exp(first - p / (3.0 * first))


@dataclass(frozen=True)
class Divider:
    """A thermistor and a fixed resistor across a supply.

    Attributes
    ----------
    fixed : float
        Ω.
    grounded : bool
        Whether the thermistor is tied to ground and not to the supply.
    """

    curve: Curve
    fixed: float
    grounded: bool

    def share(self, celsius: float) -> float:
        """Return the output at a temperature, as a share of the supply."""
        ohms = self.curve.ohms(celsius)
        return (ohms if self.grounded else self.fixed) / (ohms + self.fixed)

    def celsius(self, share: float) -> float:
        """Return the temperature for an output as a share of the supply, °C.

        DeviceFault: the thermistor or its wire is open or shorted.
        """
        if not SHORTED < share < OPEN:
            found = "shorted" if (share <= SHORTED) == self.grounded else "open, or not connected"
            raise DeviceFault(
                f"the divider output is {100 * share:.1f} % of its supply, so the thermistor is {found}: check it, "
                "its wires and the fixed resistor"
            )
        ratio = share / (1.0 - share)
        return self.curve.celsius(self.fixed * (ratio if self.grounded else 1.0 / ratio))


@dataclass(frozen=True)
class WiredThermistor:
    """The wiring of a thermistor to a converter.

    Attributes
    ----------
    number : int
        Its input.
    """

    front_end: FrontEnd
    number: int
    divider: Divider
    supply: Supply


class Thermistor:
    """The driver of a thermistor behind any converter."""

    def __init__(self, wired: WiredThermistor, link: Link, clock: Clock) -> None:
        self._wired = wired
        self._converter = wired.front_end.driver(link, clock)

    def probe(self) -> Mapping[str, str]:
        """Return temperature, supply and converter as text; the errors are those of :meth:`read`."""
        celsius, supply = self._sample()
        return {
            "temperature": f"{celsius:.2f} °C",
            "supply": self._wired.supply.said(supply),
            "converter": self._wired.front_end.description,
        }

    def read(self) -> Reading:
        """Take one sample: only the temperature, no values.

        Raises
        ------
        BusError
            The converter does not answer.
        DeviceFault
            An open or shorted thermistor, or no supply.
        """
        return Reading((), self._sample()[0])

    def discard(self) -> None:
        """Do nothing: every read is a new conversion."""

    def _sample(self) -> tuple[float, float]:
        """Return the temperature in °C and the supply in V."""
        (share,), supply = self._wired.supply.shares(self._converter, (self._wired.number,))
        return self._wired.divider.celsius(share), supply


def _curve(address: Address) -> Curve:
    """Return the curve of an address; only a virtual thermistor has a default."""
    hart = [name for name in ("a", "b", "c") if name in address.options]
    if hart:
        if "beta" in address.options:
            address.refuse("options 'beta' and 'a', 'b', 'c' exclude each other: give one curve")
        a, b, c = (address.number(name) for name in ("a", "b", "c"))
        if b <= 0.0 or c < 0.0:
            address.refuse("a thermistor's Steinhart-Hart coefficients have b above 0 and c not below 0 (in 1/K, Ω)")
        return Curve(a, b, c)
    if "beta" not in address.options and not address.simulated:
        address.refuse("the thermistor's curve is missing (add beta=...&r0=..., or a=...&b=...&c=...)")
    beta = address.number("beta", 3950.0, low=100.0, high=20_000.0)
    r0 = address.number("r0", 10_000.0 if address.simulated else None, low=1.0)
    return Curve.from_beta(beta, r0, address.number("t0", 25.0, low=-100.0, high=300.0))


def _wire(address: Address) -> WiredThermistor:
    """Return the wiring of an address."""
    front_end = find_front_end(address)
    tied = address.text("to", "ground")
    if tied not in ("ground", "supply"):
        address.refuse(f"option to={tied} is neither ground nor supply")
    fixed = address.number("fixed", 10_000.0 if address.simulated else None, low=1.0)
    number = take_input(address, "channel", front_end, 3)
    supply = take_supply(address, front_end, *SUPPLY)
    require_apart(address, {"channel": number, "supply": supply.number})
    return WiredThermistor(front_end, number, Divider(_curve(address), fixed, tied == "ground"), supply)


def _model(address: Address) -> Model:
    """Return the thermistor as it is connected at an address."""
    wired = _wire(address)
    front_end = wired.front_end
    return Model(
        name="thermistor",
        title="NTC thermistor in a divider behind a converter, temperature only",
        channels=(),
        unit="°C",
        schemes=front_end.schemes,
        addresses=(
            "ads1115+i2c:///dev/i2c-1?address=0x48&channel=3&supply=2&beta=3950&r0=10000&t0=25&fixed=10000",
            "mcp3208+spi:///dev/spidev0.1?channel=3&vref=5.0&beta=3950&r0=10000&t0=25&fixed=10000",
        ),
        # It has no channel, so these values have no effect.
        offset=0.0,
        sensitivity=1.0,
        offset_spread=0.0,
        sensitivity_spread=0.0,
        rails=(-inf, inf),
        resolution=0.0,
        interval=0.01,
        thermometer=True,
        driver=partial(Thermistor, wired),
        twin=from_twin("analog", "thermistor_twin", wired),
        not_modelled=(
            "lag behind the chamber, self-heating, noise",
            "the memory fault (parity) of other parts",
            "tolerance of the curve and of the fixed resistor, resistance of the wires",
            "supply: ripple, drift",
            "converter: offset, gain error, nonlinearity, noise, charge taken from the divider",
        ),
        default_truth=from_twin("analog", "ideal_thermistor"),
        spi=front_end.spi,
        options=(*OPTIONS, *front_end.options),
        configure=_model,
    )


THERMISTOR = _model(parse_address("sim:"))
