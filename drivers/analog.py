"""Analog sensors of two axes behind a converter: SCA100T, and ADXL202 with its duty cycle through an RC filter.

Both are ratiometric: offset and sensitivity are shares of the supply. Readings and coefficients are therefore in volts
*referred to a supply of 5 V*, ``5 * Vout / Vdd``, and do not depend on the present supply. The address states where it
is connected::

    ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2     measured at input 2, with each sample
    ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&vdd=4.98     stated
    mcp3208+spi:///dev/spidev0.1?x=0&y=1&vref=5.0              the converter's reference pin is the sensor's supply

An SCA100T has X at pin 11 (OUT_1) and Y at pin 5 (OUT_2); ``x`` and ``y`` name the inputs that they are wired to.

Sources: SCA100T Series data sheet, Murata doc. 8261800 Rev. B2; ADXL202/210 data sheet Rev. B and ADXL202E data sheet
Rev. A, Analog Devices; A Solid State Tilt Meter for Current Meter Attitude Determination.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers import adxl202, sca100t
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.converter import NOMINAL, FrontEnd, Supply, find_front_end, require_apart, take_input, take_supply
from tiltcal.drivers.device import Model, Reading, from_twin
from tiltcal.errors import DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

CHANNELS = ("x", "y")

ZERO = NOMINAL / 2.0
"""Nominal reading at 0 g, V referred to 5 V."""

LOWEST_SANE, HIGHEST_SANE = 0.05 * NOMINAL, 0.95 * NOMINAL
"""After a memory parity error an SCA100T holds both outputs below 0.25 V; above 95 % of the supply it is in its
self-test or its interconnection is broken. The duty cycles of an ADXL202 stay within these limits too."""


@dataclass(frozen=True)
class AnalogPart:
    """The constants of one analog sensor.

    Attributes
    ----------
    digital : Model
        The same part at its digital port, with the same tolerances.
    share_per_g : float
        Nominal sensitivity, shares of the supply per g.
    supply : tuple of float
        Lowest and highest supply, V.
    parity_signal : bool
        Whether both outputs near ground are the fault signal of the part.
    interval : float
        Time after which the noise of a sample is independent of the previous one, s.
    not_modelled : tuple of str
        What the twin does not model of this part.
    """

    title: str
    digital: Model
    share_per_g: float
    supply: tuple[float, float]
    parity_signal: bool
    interval: float
    not_modelled: tuple[str, ...]

    @property
    def name(self) -> str:
        """What the user types."""
        return f"{self.digital.name}-analog"

    @property
    def sensitivity(self) -> float:
        """Nominal, V/g referred to 5 V."""
        return NOMINAL * self.share_per_g


@dataclass(frozen=True)
class WiredAnalog:
    """The wiring of a sensor to a converter.

    Attributes
    ----------
    numbers : tuple of int
        The inputs of x and y.
    """

    front_end: FrontEnd
    numbers: tuple[int, ...]
    supply: Supply


class AnalogSensor:
    """The driver of an analog sensor behind any converter."""

    def __init__(self, part: AnalogPart, wired: WiredAnalog, link: Link, clock: Clock) -> None:
        self._part = part
        self._wired = wired
        self._converter = wired.front_end.driver(link, clock)

    def probe(self) -> Mapping[str, str]:
        """Return a sample, the supply and the converter as text; the errors are those of :meth:`read`."""
        values, supply = self._sample()
        said = {
            channel: f"{value:.4f} V, referred to {NOMINAL:g} V"
            for channel, value in zip(CHANNELS, values, strict=True)
        }
        return {**said, "supply": self._wired.supply.said(supply), "converter": self._wired.front_end.description}

    def read(self) -> Reading:
        """Take one sample: x and y in V, referred to a supply of 5 V.

        Raises
        ------
        BusError
            The converter does not answer.
        DeviceFault
            A supply outside the range of the sensor, or its fault signal.
        """
        values, _ = self._sample()
        return Reading(values)

    def discard(self) -> None:
        """Do nothing: every read is a new conversion."""

    def _sample(self) -> tuple[tuple[float, ...], float]:
        """Return both readings in V referred to 5 V, and the supply in V."""
        shares, supply = self._wired.supply.shares(self._converter, self._wired.numbers)
        values = tuple(NOMINAL * share for share in shares)
        if self._part.parity_signal and max(values) < LOWEST_SANE:
            raise DeviceFault(
                f"both outputs are below {LOWEST_SANE:g} V, the part's fault signal (memory parity error), or are not "
                "connected: check the wiring, then switch its supply off and on; if it stays, replace the part"
            )
        return values, supply


def _wire(part: AnalogPart, address: Address) -> WiredAnalog:
    """Return the wiring of an address."""
    front_end = find_front_end(address)
    numbers = {channel: take_input(address, channel, front_end, place) for place, channel in enumerate(CHANNELS)}
    supply = take_supply(address, front_end, *part.supply)
    require_apart(address, {**numbers, "supply": supply.number})
    return WiredAnalog(front_end, tuple(numbers.values()), supply)


def _model(part: AnalogPart, address: Address) -> Model:
    """Return the model of a part as it is connected at an address."""
    wired = _wire(part, address)
    front_end = wired.front_end
    return Model(
        name=part.name,
        title=part.title,
        channels=CHANNELS,
        unit="V",
        schemes=front_end.schemes,
        addresses=(
            "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2",
            "mcp3208+spi:///dev/spidev0.1?x=0&y=1&vref=5.0",
        ),
        offset=ZERO,
        sensitivity=part.sensitivity,
        offset_spread=part.digital.offset_spread,
        sensitivity_spread=part.digital.sensitivity_spread,
        cross_axis_limit=part.digital.cross_axis_limit,
        nonlinearity=part.digital.nonlinearity,
        rails=(LOWEST_SANE, HIGHEST_SANE),
        resolution=front_end.step * NOMINAL / wired.supply.volts,
        interval=part.interval,
        thermometer=False,
        driver=partial(AnalogSensor, part, wired),
        twin=from_twin("analog", "analog_twin", part.parity_signal, wired),
        not_modelled=(
            *part.not_modelled,
            "response time: a new position and a new temperature take effect at once, without ringing",
            "supply: ripple, drift, start-up time, ratiometric error",
            "converter: offset, gain error, nonlinearity, noise, charge taken from the sensor's output",
            "an input without a wire, which floats on the real part: it reads 0 V",
        ),
        default_truth=from_twin("analog", "draw_truth", part),
        spi=front_end.spi,
        options=(*CHANNELS, "supply", "vdd", *front_end.options),
        configure=partial(_model, part),
    )


def _sca100t(digital: Model, share_per_g: float) -> Model:
    part = AnalogPart(
        title=digital.title.replace("SPI", "analog outputs behind a converter"),
        digital=digital,
        share_per_g=share_per_g,
        supply=(4.75, 5.25),
        parity_signal=True,
        interval=digital.interval,
        not_modelled=(
            "long-term drift, temperature hysteresis, shock",
            "self-test pins, and its digital port, which the analog outputs do not need",
        ),
    )
    return _model(part, parse_address("sim:"))


def _adxl202(digital: Model) -> Model:
    part = AnalogPart(
        title=f"{digital.title} through an RC filter behind a converter",
        digital=digital,
        # The output of the filter is the duty cycle, as a share of the supply.
        share_per_g=digital.sensitivity,
        supply=(3.0, 5.25),
        parity_signal=False,
        interval=0.5 / BANDWIDTH,
        not_modelled=(
            "the pulses: their ripple after the RC filter, and the load of the filter",
            "offsets, cross-axis sensitivity and drift of a part are our estimates: no source states them",
            "nonlinearity",
            "the memory fault (parity) of other parts: this part has no such memory",
        ),
    )
    return _model(part, parse_address("sim:"))


BANDWIDTH = 10.0
"""Assumed bandwidth of the RC filter of an ADXL202, Hz; it sets the noise of the virtual part."""

SCA100T_D01 = _sca100t(sca100t.D01, 0.8)
SCA100T_D02 = _sca100t(sca100t.D02, 0.4)
ADXL202 = _adxl202(adxl202.ADXL202)
ADXL202E = _adxl202(adxl202.ADXL202E)
ADXL210 = _adxl202(adxl202.ADXL210)
