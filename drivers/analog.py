"""Analog sensors behind a converter: SCA100T and ADXL202 (through an RC filter), and thermistors; with virtual parts.

The sensors are ratiometric: offset and sensitivity are shares of the supply. Readings and coefficients are therefore in
volts *referred to a supply of 5 V*, ``5 * Vout / Vdd``, and do not depend on the present supply, which is measured at
an input, stated, or the converter's reference. An SCA100T has X at pin 11 (OUT_1) and Y at pin 5 (OUT_2).

A thermistor is in a divider: a thermometer for sensors without one. Its curve is that of Steinhart and Hart (K, Ω), or
that of a ``beta`` in K with ``r0`` Ω at ``t0`` °C, which is the same one with c = 0::

    1/T = a + b ln R + c (ln R)³    1/T = 1/T0 + ln(R / R0) / beta

Sources: SCA100T Series data sheet, Murata doc. 8261800 Rev. B2; ADXL202/210 data sheet Rev. B and ADXL202E data sheet
Rev. A, Analog Devices; A Solid State Tilt Meter for Current Meter Attitude Determination; Steinhart and Hart,
Calibration curves for thermistors, Deep-Sea Research 15 (1968).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import cbrt, exp, inf, log, sqrt
from typing import Any

from tiltcal.drivers import adxl202, sca100t
from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.converters import NOMINAL, Inputs, VirtualAds1115, take_inputs
from tiltcal.drivers.model import Model, Reading, Sensor, in_words
from tiltcal.drivers.virtual import JIG, TIME_CONSTANT, HeldPose, Truth, uniform
from tiltcal.errors import DeviceFault

CHANNELS = ("x", "y")
ZERO = NOMINAL / 2.0  # nominal reading at 0 g, V referred to 5 V
LOWEST_SANE, HIGHEST_SANE = 0.05 * NOMINAL, 0.95 * NOMINAL
"""After a memory parity error an SCA100T holds both outputs below 0.25 V; above 95 % of the supply it is in its
self-test or its interconnection is broken. The duty cycles of an ADXL202 stay within these limits too."""

BANDWIDTH = 10.0  # assumed bandwidth of the RC filter of an ADXL202, Hz; it sets the noise of the virtual part


class AnalogSensor(Sensor):
    """The driver of an analog sensor or thermistor at some inputs of a converter."""

    def __init__(self, part: TiltPart | Divider, inputs: Inputs, link: Link, clock: Clock) -> None:
        self._part, self._inputs = part, inputs
        self._link, self._clock = link, clock
        self._volts = 0.0
        """Of the supply at the last sample, V."""

    def probe(self) -> Mapping[str, str]:
        """Return a sample, the supply and the converter as text; the errors are those of :meth:`read`."""
        said = in_words(self.read(), CHANNELS, f"{{:.4f}} V, referred to {NOMINAL:g} V", trimmed=True)
        return said | self._inputs.said(self._volts)

    def read(self) -> Reading:
        """Take one sample."""
        shares, self._volts = self._inputs.shares(self._link, self._clock)
        return self._part.reading(shares)


def wired(part: TiltPart | Divider, inputs: Inputs, **facts: Any) -> Model:
    """Return the model of a part at some inputs of a converter, by its further facts."""

    def twin(truth: Truth, fixture: HeldPose, clock: Clock) -> Link:
        """Return a virtual converter with the part at its inputs; an input without a wire is at ground."""

        def volts(number: int) -> float:
            if number == inputs.supply:
                return truth.supply
            if number not in inputs.numbers:
                return 0.0
            share = part.output(inputs.numbers.index(number), truth, fixture, clock)
            return min(max(share, 0.0), 1.0) * truth.supply

        return VirtualAds1115(truth, fixture, clock, volts)

    options = (*facts.pop("options"), "supply", "vdd", *inputs.converter.options)
    driver = partial(AnalogSensor, part, inputs)
    return Model(spi=inputs.converter.spi, driver=driver, twin=twin, options=options, **facts)


@dataclass(frozen=True)
class TiltPart:
    """The facts of a sensor of two axes.

    digital: the same part at its digital port, with the same tolerances.
    share_per_g: nominal sensitivity, shares of the supply per g.
    supply: lowest and highest, V.
    parity_signal: whether both outputs near ground are the fault signal of the part.
    interval: time after which the noise of a sample is independent of the previous one, s.
    """

    title: str
    digital: Model
    share_per_g: float
    supply: tuple[float, float]
    parity_signal: bool
    interval: float
    not_modelled: tuple[str, ...]

    @property
    def sensitivity(self) -> float:
        """Nominal, V/g referred to 5 V."""
        return NOMINAL * self.share_per_g

    def reading(self, shares: tuple[float, ...]) -> Reading:
        """Return x and y, V referred to a supply of 5 V."""
        values = tuple(NOMINAL * share for share in shares)
        if self.parity_signal and max(values) < LOWEST_SANE:
            raise DeviceFault(
                f"both outputs are below {LOWEST_SANE:g} V, the part's fault signal (memory parity error), or are not "
                "connected: check the wiring, then switch its supply off and on; if it stays, replace the part"
            )
        return Reading(values)

    def output(self, place: int, truth: Truth, fixture: HeldPose, clock: Clock) -> float:
        """Return a virtual output as a share of the supply."""
        now_ns = clock.now_ns()
        channel = truth.channels[place]
        if self.parity_signal and truth.fault(now_ns / SECOND).kind == "parity":
            return 0.05 * uniform(truth.seed, f"parity {channel}", now_ns)
        return truth.sample(channel, fixture, clock, now_ns) / NOMINAL

    def at(self, address: Address) -> Model:
        """Return the model of the part as it is connected at an address."""
        inputs = take_inputs(address, {"x": 0, "y": 1}, *self.supply)
        converter = inputs.converter
        return wired(
            self,
            inputs,
            name=f"{self.digital.name}-analog",
            title=self.title,
            channels=CHANNELS,
            unit="V",
            addresses=(
                "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2",
                "mcp3208+spi:///dev/spidev0.1?x=0&y=1&vref=5.0",
            ),
            offset=ZERO,
            sensitivity=self.sensitivity,
            offset_spread=self.digital.offset_spread,
            sensitivity_spread=self.digital.sensitivity_spread,
            cross_axis_limit=self.digital.cross_axis_limit,
            nonlinearity=self.digital.nonlinearity,
            rails=(LOWEST_SANE, HIGHEST_SANE),
            resolution=converter.full_scale / converter.steps * NOMINAL / inputs.volts,
            interval=self.interval,
            not_modelled=(
                *self.not_modelled,
                "converter: offset, gain error, nonlinearity, noise, charge taken from the sensor's output",
                "an input without a wire, which floats on the real part: it reads 0 V",
            ),
            memory_fault=self.parity_signal,
            default_truth=self.draw,
            options=CHANNELS,
            configure=self.at,
        )

    def draw(self, seed: int) -> Truth:
        """Draw the part of the digital port, in V referred to a supply of 5 V."""
        digital, truth = self.digital, self.digital.default_truth(seed)
        step = self.sensitivity / digital.sensitivity
        return replace(
            truth,
            offset={name: ZERO + step * (offset - digital.offset) for name, offset in truth.offset.items()},
            sensitivity={
                name: {axis: step * sensitivity for axis, sensitivity in row.items()}
                for name, row in truth.sensitivity.items()
            },
            drift={name: tuple(step * k for k in drift) for name, drift in truth.drift.items()},
            noise={name: step * noise for name, noise in truth.noise.items()},
            thermometer_error=0.0,
        )


SCA100T = tuple(
    TiltPart(
        title=digital.title.replace("SPI", "analog outputs behind a converter"),
        digital=digital,
        share_per_g=share_per_g,
        supply=(4.75, 5.25),
        parity_signal=True,
        interval=digital.interval,
        not_modelled=("long-term drift, temperature hysteresis, shock; self-test",),
    )
    for digital, share_per_g in ((sca100t.D01, 0.8), (sca100t.D02, 0.4))
)
ADXL202 = tuple(
    TiltPart(
        title=f"{digital.title} through an RC filter behind a converter",
        digital=digital,
        # The filter gives the duty cycle, as a share of the supply.
        share_per_g=digital.sensitivity,
        supply=(3.0, 5.25),
        parity_signal=False,
        interval=0.5 / BANDWIDTH,
        not_modelled=(
            "the pulses: their ripple after the RC filter, and the load of the filter",
            "tolerances of a real part, which no source states: a virtual part has ours",
        ),
    )
    for digital in adxl202.MODELS.values()
)


# --- Thermistors ---

ZERO_CELSIUS = 273.15  # K
THERMISTOR_SUPPLY = (1.0, 5.5)  # limits of the converters, V; a divider works with any supply
THERMISTOR_OPTIONS = ("beta", "r0", "t0", "a", "b", "c", "fixed", "to")
SHORTED, OPEN = 0.005, 0.995  # shares of the supply that only a broken divider reaches


@dataclass(frozen=True, slots=True)
class Curve:
    """The curve of Steinhart and Hart, 1/T = a + b ln R + c (ln R)³ in K and Ω; b is positive, c not negative."""

    a: float
    b: float
    c: float

    def celsius(self, ohms: float) -> float:
        """Return the temperature at a resistance, °C."""
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
    """A thermistor and a fixed resistor, Ω, across a supply; ``grounded`` where the thermistor is tied to ground."""

    curve: Curve
    fixed: float
    grounded: bool

    def reading(self, shares: tuple[float, ...]) -> Reading:
        """Return the temperature for an output as a share of the supply; there are no other values."""
        (share,) = shares
        if not SHORTED < share < OPEN:
            state = "shorted" if (share <= SHORTED) == self.grounded else "open, or not connected"
            raise DeviceFault(
                f"the divider output is {100 * share:.1f} % of its supply, so the thermistor is {state}: check it, "
                "its wires and the fixed resistor"
            )
        ratio = share / (1.0 - share)
        return Reading((), self.curve.celsius(self.fixed * (ratio if self.grounded else 1.0 / ratio)))

    def output(self, place: int, truth: Truth, fixture: HeldPose, clock: Clock) -> float:
        """Return the virtual output as a share of the supply."""
        stuck = truth.fault(clock.now_ns() / SECOND).kind == "stuck"
        celsius = truth.ambient if stuck else fixture.temperature()
        ohms = self.curve.ohms(celsius + truth.thermometer_error)
        return (ohms if self.grounded else self.fixed) / (ohms + self.fixed)


def _curve(address: Address) -> Curve:
    """Return the curve of an address; only a virtual thermistor has a default."""
    if any(name in address.options for name in ("a", "b", "c")):
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
    t0 = address.number("t0", 25.0, low=-100.0, high=300.0)
    return Curve(1.0 / (t0 + ZERO_CELSIUS) - log(r0) / beta, 1.0 / beta, 0.0)


def thermistor_at(address: Address) -> Model:
    """Return the thermistor as it is connected at an address."""
    grounded = address.choice("to", {"ground": True, "supply": False}, True)
    fixed = address.number("fixed", 10_000.0 if address.simulated else None, low=1.0)
    return wired(
        Divider(_curve(address), fixed, grounded),
        take_inputs(address, {"channel": 3}, *THERMISTOR_SUPPLY),
        name="thermistor",
        title="NTC thermistor in a divider behind a converter, temperature only",
        channels=(),
        unit="°C",
        addresses=(
            "ads1115+i2c:///dev/i2c-1?address=0x48&channel=3&supply=2&beta=3950&r0=10000&t0=25&fixed=10000",
            "mcp3208+spi:///dev/spidev0.1?channel=3&vref=5.0&beta=3950&r0=10000&t0=25&fixed=10000",
        ),
        # It has no channel, so these values have no effect.
        sensitivity=1.0,
        offset_spread=0.0,
        sensitivity_spread=0.0,
        rails=(-inf, inf),
        interval=0.01,
        thermometer=True,
        not_modelled=("tolerance of the curve, the resistors and the converter; lag, self-heating, noise",),
        default_truth=lambda seed: Truth((), {}, {}, seed=seed, jig=JIG, time_constant=TIME_CONSTANT),
        options=("channel", *THERMISTOR_OPTIONS),
        configure=thermistor_at,
    )


MODELS = {
    model.name: model
    for model in (at(parse_address("sim:")) for at in (*(part.at for part in (*SCA100T, *ADXL202)), thermistor_at))
}
